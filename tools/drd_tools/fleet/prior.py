"""Prior for a robot's daemon, from the fleet's population and the robot's own history.

`expect` predicts each constant for the robot's next recording; `write_prior` writes it as model.yaml and prior.yaml.
"""

import math
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
import yaml

from drd.config.schema import ConfigError
from drd.effects.model import Model, make_model, save_model
from drd.units import RAD_PER_DEG
from drd_tools.fleet.groups import ROBOT_DAYS
from drd_tools.fleet.statistics import Fitted, Statistics

MODEL, PRIOR = "model.yaml", "prior.yaml"
# Largest standard deviations that the configuration allows (drd/config/keys.py).
WHEEL_SCALE_MOST, TREAD_MOST, GYRO_SCALE_MOST, LAG_MOST_S = 0.5, 1.0, 0.5, 1.0
HEAD: Final = "What the fleet and this robot's own history say that robot.yaml does not."


class Expected(NamedTuple):
    """A predicted constant of the next recording, SI; `recordings`: number of the robot's own in its last segment."""

    name: str
    value: float
    sigma: float
    recordings: int


def expect(found: Statistics, robot: str, day: float, place: str | None = None) -> list[Expected]:
    """Predict the constants of a recording of `robot` on `day`, in a known place or any. (108)

    An unknown robot is a draw from the population. Raises ConfigError if the store has no constants.
    """
    if not found.fitted:
        raise ConfigError("STORE", "constants", "at least one recording that tells some", "none")
    return [_expected(f, robot, day, place) for f in found.fitted.values()]


def _expected(fitted: Fitted, robot: str, day: float, place: str | None) -> Expected:
    log, p = fitted.log, fitted.population
    number = log.robots.index(robot) if robot in log.robots else None
    line = None if number is None else fitted.trends[number]
    if number is None or line is None or not len(line.level):
        value, variance, recordings = p.mean, p.spread**2, 0
    else:
        gap = max(0.0, day - float(log.day[log.rows(number)][-1]))
        changed = 1.0 - math.exp(-gap / ROBOT_DAYS)
        value, recordings = float(line.level[-1]), line.segments[-1][2] - line.segments[-1][1] + 1
        variance = float(line.sigma[-1]) ** 2 + p.walk * gap + changed * log.constant.jump**2
    season = float(np.interp(day, p.knots, p.season))
    at, floor = 0.0, p.scatter[1] ** 2 * (len(log.places) > 1)
    groups = {} if number is None else {"batch": int(log.batch_of[number])}
    if place in log.places:
        k = groups["place"] = log.places.index(place)
        at, floor = float(p.place[k]), float(p.place_sigma[k]) ** 2
    # A robot's level excludes the shared part (`Population.shared`), so the steps of its groups are added.
    steps = sum(s.size for s in p.steps if s.which == groups.get(s.kind) and s.day <= day)
    return Expected(log.name, value + season + at + steps, math.sqrt(variance + p.excess**2 + floor), recordings)


def write_prior(expected: list[Expected], robot: str, folder: Path) -> list[Path]:
    """Write model.yaml, the effects, and prior.yaml, their uncertainty, for the configuration. Raises OSError."""
    folder.mkdir(parents=True, exist_ok=True)
    files = [folder / MODEL, folder / PRIOR]
    save_model(files[0], model_of(expected, robot), HEAD)
    text = yaml.safe_dump({"estimation": {"initial": initial_of(expected)}}, sort_keys=False)
    head = f"# How sure that is: put it into the configuration of {robot}, beside model.file."
    files[1].write_text(f"{head}\n{text}", "utf-8")
    return files


def model_of(expected: list[Expected], robot: str) -> Model:
    """Model with the catalogue's effects that correspond to the constants, with their standard deviations."""
    of = {e.name: e for e in expected}

    def amount(name: str, unit: str = "1", si: float = 1.0, sign: float = 1.0) -> dict[str, Any]:
        return {"value": sign * of[name].value / si, "std": of[name].sigma / si, "unit": unit}

    effects: list[dict[str, Any]] = []
    if {"radius_left", "radius_right"} <= of.keys():
        effects.append({"effect": "wheel_radius_error",
                        "parameters": {"left": amount("radius_left"), "right": amount("radius_right")}})  # fmt: skip
    for name, effect in (("tread", "tread_error"), ("gyro_scale", "gyro_scale_error")):
        if name in of:
            effects.append({"effect": effect, "parameters": {"k": amount(name)}})
    if "lag_s" in of and abs(of["lag_s"].value) > of["lag_s"].sigma:
        late = of["lag_s"].value > 0.0
        effect = "encoder_latency" if late else "gyro_latency"
        effects.append({"effect": effect, "parameters": {"delay": amount("lag_s", "s", sign=1.0 if late else -1.0)}})
    if "bias_per_c" in of and abs(of["bias_per_c"].value) > of["bias_per_c"].sigma:
        slope = amount("bias_per_c", "deg/s/degC", RAD_PER_DEG)
        effects.append({"effect": "gyro_bias_temperature", "parameters": {"b1": slope}})
    own = max((e.recordings for e in expected), default=0)
    return make_model(effects, None, robot_id=robot, recordings=f"{own} of its own, and the fleet's")


def initial_of(expected: list[Expected]) -> dict[str, float]:
    """Keys of `estimation.initial`: standard deviations that remain after correction by the model."""
    of = {e.name: e.sigma for e in expected}
    found = {}
    if {"radius_left", "radius_right"} <= of.keys():
        found["wheel_scale"] = min(WHEEL_SCALE_MOST, max(of["radius_left"], of["radius_right"]))
    for key, name, most in (
        ("tread", "tread", TREAD_MOST),
        ("gyro_scale", "gyro_scale", GYRO_SCALE_MOST),
        ("wheel_lag_s", "lag_s", LAG_MOST_S),
    ):
        if name in of:
            found[key] = min(most, of[name])
    return {key: float(f"{value:.3g}") for key, value in found.items()}
