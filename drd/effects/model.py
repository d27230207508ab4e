"""model.yaml: the nominal robot, and the physical effects that it leaves out, with their parameters."""

import functools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, make_dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Final, Literal, NamedTuple, TypeVar

import yaml
from msgspec import Meta

from drd.config.keys import Config
from drd.config.robot import PATHS, Robot, RobotFile, robot_of
from drd.config.schema import ConfigError, Loaded, loads, made, named_by, nested, read_text
from drd.effects.catalogue import catalogue
from drd.effects.effect import Effect, Parameter
from drd.units import RAD_PER_DEG

T = TypeVar("T")


class Covariate(NamedTuple):
    """A variable on which effects depend: its unit in files, and the SI value of one unit."""

    unit: str
    si: float
    text: str


# Heading and the wheels' phase are cyclic, and a place is no number: they have no range.
COVARIATES: Final = {
    "time": Covariate("s", 1.0, "since the gyro's power-on, or the recording's start"),
    "yaw_rate": Covariate("deg/s", RAD_PER_DEG, "left positive"),
    "speed": Covariate("m/s", 1.0, "forward positive"),
    "acceleration": Covariate("m/s^2", 1.0, "forward positive"),
    "lateral_acceleration": Covariate("m/s^2", 1.0, "speed times yaw rate"),
    "curvature": Covariate("1/m", 1.0, "size of yaw rate over speed"),
    "temperature": Covariate("degC", 1.0, "of the gyro"),
    "temperature_rate": Covariate("degC/s", 1.0, "behind the effect's lag"),
}
# A value so many times larger than the largest plausible one is a typing error, and may overflow.
LARGEST_TIMES_PLAUSIBLE: Final = 100.0


class Amount(NamedTuple):
    """A parameter's value and its standard deviation (0: not known), in the catalogue's unit."""

    value: float
    std: float = 0.0


@dataclass(frozen=True)
class Term:
    """An effect with its parameters, and the covariates' ranges in which it was seen, in the files' units."""

    effect: Effect
    parameters: dict[str, Amount | str]
    seen: dict[str, tuple[float, float]] = field(default_factory=dict)
    provenance: dict[str, str] = field(default_factory=dict)

    def values(self) -> dict[str, float | str]:
        """The parameters in SI, for the effect's formulas; linear ones that are not stated are 0."""
        found: dict[str, float | str] = {}
        for q in self.effect.parameters:
            stated = self.parameters.get(q.name, Amount(0.0))
            found[q.name] = stated if isinstance(stated, str) else stated.value * q.si
        return found

    def stds(self) -> dict[str, float]:
        """Standard deviations, in SI, of the parameters that have one."""
        amounts = {q: self.parameters.get(q.name) for q in self.effect.parameters}
        return {q.name: a.std * q.si for q, a in amounts.items() if isinstance(a, Amount) and a.std > 0.0}


@dataclass(frozen=True)
class Model:
    """Content of a model file. `robot`: what it states about the nominal robot. `provenance`: free texts.

    `provenance.recording` names the recordings, separated by commas, in which the effects were found; effects that do
    not last are corrected in these only.
    """

    terms: tuple[Term, ...] = ()
    robot: Loaded[Robot] = field(default_factory=lambda: Loaded(robot_of(RobotFile()), {}))
    provenance: dict[str, str] = field(default_factory=dict)

    def stated(self) -> Iterator[tuple[str, Any]]:
        """Path and value of each key of robot.yaml that the model states."""
        for name, path in PATHS.items():
            if self.robot.origins.get(path, "default") != "default":
                yield path, getattr(self.robot.value, name)

    def changed(self, nominal: Robot) -> Robot:
        """The nominal robot with the values that the model states."""
        names = {path: name for name, path in PATHS.items()}
        return replace(nominal, **{names[path]: value for path, value in self.stated()})

    def holds_in(self, recording: str | None) -> tuple[tuple[Term, ...], list[str]]:
        """The terms that hold in a recording (None: in a future run), and sentences about limitations."""
        kept, notes = [], []
        for term in self.terms:
            effect, found_in = term.effect, (self.provenance | term.provenance).get("recording")
            is_other_run = recording is None or (found_in is not None and recording not in _names(found_in))
            if not effect.lasting and is_other_run:
                where = f" (here: {found_in})" if found_in else ""
                notes.append(f"{effect.id} is not applied: it holds only in the run in which it was found{where}")
                continue
            if not effect.lasting and found_in is None:
                notes.append(f"{effect.id} holds only in the run in which it was found: is it this one?")
            if effect.irreversible:
                notes.append(f"{effect.id} cannot be corrected: {effect.irreversible}")
            kept.append(term)
        return tuple(kept), notes


def _names(text: str) -> list[str]:
    return [name.strip() for name in text.split(",")]


def load_model(file: Path) -> Model:
    """Read a model file. Raises ConfigError with file, line, key, expected and got; nothing else escapes."""
    with named_by("model.file", file):
        text = read_text(file)
    return loads_model(text, str(file))


def loads_model(text: str, where: str = "(text)") -> Model:
    """Read a model from YAML text. Raises ConfigError; nothing else escapes."""
    loaded: Loaded[Any] = loads(text, _File, where)
    terms = [_term(node, f"effects[{i}]", where) for i, node in enumerate(loaded.value.effects or ())]
    return Model(tuple(terms), replace(loaded, value=robot_of(loaded.value)), loaded.value.provenance)


@dataclass(frozen=True, kw_only=True)
class _File(RobotFile):  # type: ignore[misc]  # made of the robot's fields
    """model.yaml."""

    effects: Annotated[tuple[yaml.Node, ...], "effects"] | None = None
    provenance: dict[str, str] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class _Row:
    """An effect in a file."""

    effect: Annotated[str, "name of an effect"]
    parameters: yaml.Node | None = None
    seen: yaml.Node | None = None
    provenance: dict[str, str] = field(default_factory=dict)


_Seen: Final[type[Any]] = make_dataclass("_Seen", [
    (name, Annotated[tuple[float, float], f"a low and a higher number in {covariate.unit}"], None)
    for name, covariate in COVARIATES.items()
])  # fmt: skip


@functools.cache
def _form(effect: Effect, may_lack: bool) -> type[Any]:
    """Class of an effect's parameters in a file. `may_lack`: linear ones may be missing."""
    found: list[Any] = []
    for q in effect.parameters:
        low, high = _limits(q)
        number: Any = Annotated[float, q.unit, Meta(ge=low, le=high)]
        std: Any = Annotated[float, Meta(ge=0, le=high)] | None
        amount: list[Any] = [("value", number), ("std", std, None), ("unit", Literal[q.unit], q.unit)]
        hint: Any = Literal[q.choices] if q.choices else number | make_dataclass("Stated", amount)
        found.append((q.name, hint, None) if may_lack and q.linear and not q.choices else (q.name, hint))
    return make_dataclass("Parameters", found, kw_only=True)


def _term(node: yaml.Node, path: str, where: str) -> Term:
    loaded = made(node, _Row, where, path)
    row, effect = loaded.value, catalogue().get(loaded.value.effect)
    if effect is None:
        here = f"{path}.effect"
        raise ConfigError(loaded.place(here), here, f"one of {', '.join(catalogue())}", repr(row.effect))
    given = row.parameters or yaml.MappingNode("", [], node.start_mark)
    stated = vars(made(given, _form(effect, bool(given.value)), where, f"{path}.parameters").value)
    parameters = {name: _amount(p) for name, p in stated.items() if p is not None}
    ranges = made(row.seen, _Seen, where, f"{path}.seen")
    seen = {covariate: ends for covariate, ends in vars(ranges.value).items() if ends is not None}
    for covariate, (low, high) in seen.items():
        if low >= high:
            here, expected = f"{path}.seen.{covariate}", f"a low and a higher number in {COVARIATES[covariate].unit}"
            raise ConfigError(ranges.place(here), here, expected, f"{low:g} and {high:g}")
    return Term(effect, parameters, seen, row.provenance)


def _amount(p: Any) -> Amount | str:
    return p if isinstance(p, str) else Amount(p) if isinstance(p, float) else Amount(p.value, p.std or 0.0)


def _limits(q: Parameter) -> tuple[float, float]:
    """Permitted range of a value, far wider than the plausible one. Delays and time constants must be positive."""
    high = LARGEST_TIMES_PLAUSIBLE * max(abs(q.low), abs(q.high))
    positive = not (q.signed or q.linear) and q.low > 0.0
    return (q.low / LARGEST_TIMES_PLAUSIBLE if positive else -high), high


def check_geometry(model: Model, config: Config) -> None:
    """Check that the model states the configuration's robot: its effects hold for no other.

    Raises ConfigError.
    """
    robot, counts = config.robot, config.encoders.counts_per_revolution
    mine = {
        "wheel.radius_m": ("robot.wheel_radius_m", robot.wheel_radius_m),
        "wheel.counts_per_revolution": ("encoders.counts_per_revolution", counts),
        "tread_m": ("robot.tread_m", robot.tread_m),
    }
    for path, value in model.stated():
        name, expected = mine.get(path, ("", None))
        if expected is not None and value is not None and not math.isclose(value, expected, rel_tol=1e-6):
            text = f"{expected:.12g}, the configuration's {name}: effects hold for the robot with which they were found"
            raise ConfigError(model.robot.place(path), path, text, f"{value:.12g}")


def save_model(file: Path, model: Model, comment: str = "") -> None:
    """Write a model file that `load_model` reads as the same model. `comment`: its header. Raises OSError."""
    content = nested(dict(model.stated()))
    content["effects"] = [_plain(term) for term in model.terms]
    if model.provenance:
        content["provenance"] = dict(model.provenance)
    head = "".join(f"# {line}\n" for line in comment.splitlines())
    text = yaml.safe_dump(content, sort_keys=False, allow_unicode=True, width=100)
    file.write_text(head + text, encoding="utf-8")


def _plain(term: Term) -> dict[str, Any]:
    units = {q.name: q.unit for q in term.effect.parameters}
    parameters: dict[str, Any] = {}
    for name, p in term.parameters.items():
        parameters[name] = p if isinstance(p, str) else {"value": p.value, "std": p.std, "unit": units[name]}
    found: dict[str, Any] = {"effect": term.effect.id, "parameters": parameters}
    if term.seen:
        found["seen"] = {covariate: list(ends) for covariate, ends in term.seen.items()}
    if term.provenance:
        found["provenance"] = dict(term.provenance)
    return found


def make_model(
    effects: Sequence[Mapping[str, Any]], robot: Mapping[str, Any] | None = None, **provenance: str
) -> Model:
    """Make a model from plain values as in a file (`diagnosis.json` has the same form). Raises ConfigError."""
    content = {**(robot or {}), "effects": [dict(effect) for effect in effects], "provenance": provenance}
    return loads_model(yaml.safe_dump(content, sort_keys=False), "(model)")
