"""Invented result folders of `drd diagnose`: a drive with a known error, and what would be found."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from drd.arrays import Array

Made = tuple[dict[str, Any], dict[str, Any]]

DURATION_S = 720.0
SPEED_M_S = 0.65


def one_finding() -> Made:
    """A scale error of the gyro, with a full reference, judged on held-out blocks."""
    rng = np.random.default_rng(1)
    time_s, rate_rad_s = _drive(rng)
    scale = 0.012
    reference = _path(time_s, rate_rad_s)
    rates = np.linspace(-30.0, 30.0, 13)
    curve = _curve(rng, rates, lambda x: scale * x, 0.03, "yaw_rate", "deg/s", "deg/s", "gyro")
    corrected = _path(time_s, (1.0 + scale / 40.0) * rate_rad_s)
    finding = _finding("gyro_scale_error", "gyro", {"k": (scale, 0.0003, "1")}, "yaw_rate", 310.2, 0.93)
    diagnosis = _diagnosis("case_001", "explained", [finding], (0.03, 0.12))
    diagnosis["classes"] = [["wheel_radius_error", "bump_counts"], ["gyro_lag", "gyro_latency"]]
    drive = {"manoeuvre": "turns on the spot, both ways", "minutes": 3.0, "nats": 83.0}
    diagnosis["next_drive"] = {**drive, "separates": [["tread_error", "turn_scrub"]]}
    series = _series(rng, [_recording("case_001", reference, _path(time_s, (1.0 + scale) * rate_rad_s), corrected)])
    series["findings"] = [{"effect": "gyro_scale_error", "curve": curve, "evidence": _evidence(rng, 310.2)}]
    series["residual"] = _residual(rng, 2.4)
    series["held_out"] = [
        _held("blocks", "position rms", "m", 1.31, 0.14),
        _held("blocks", "heading rms", "deg", 2.05, 0.31),
        _held("blocks", "gyro residual", "sigma", 2.37, 1.02),
        _held("blocks", "wheels residual", "sigma", 1.04, 1.05),
    ]
    return diagnosis, series


def two_and_unknown() -> Made:
    """Slippery ground, an ambiguous warm-up, and an error that is not in the catalogue; two recordings."""
    rng = np.random.default_rng(2)
    time_s, rate_rad_s = _drive(rng)
    reference = _path(time_s, rate_rad_s)
    sparse = {key: values[::60] for key, values in reference.items()}
    wrong = rate_rad_s + 0.004 * np.exp(-time_s / 140.0) + 0.0012 * np.sin(0.02 * time_s)
    times = np.linspace(0.0, DURATION_S, 15)
    wet = ((time_s > 300.0) & (time_s < 360.0)).astype(float)
    slip = _finding(
        "surface_slip", "wheels", {"t0": (301.2, 1.4, "s"), "t1": (358.8, 1.1, "s"), "left": (0.0512, 0.004, "1")},
        "time", 142.7, 0.46, windows=[[301.2, 358.8]], status="supported",
    )  # fmt: skip
    warmup = _finding(
        "gyro_warmup", "gyro", {"b": (0.229, 0.012, "deg/s"), "tau": (139.0, 11.0, "s")}, "time", 64.1, 0.27,
        also_fits=["gyro_bias_temperature", "gyro_bias_temperature_rate"],
    )  # fmt: skip
    unknown = _finding("unknown", "gyro", {}, "place", 21.4, 0.11, status="suspected")
    unknown["evidence"] |= {"family_wise_p": 0.031, "e_value": None}
    second = "a very long name of the second run that was made after noon, 2024-05-13"
    diagnosis = _diagnosis(f"morning_run, {second}", "partly_explained", [slip, warmup, unknown], (0.16, 0.84))
    pairs = [["gyro_warmup", name] for name in warmup["also_fits"]]
    diagnosis["next_drive"] = {
        "manoeuvre": "standing still, cooled; then a slalom", "minutes": 5.5, "nats": 7.5, "separates": pairs,
        "sentence": "30 s of standing still; then two manoeuvres.", "stand_s": 30.0, "probability": 0.89,
        "segments": [
            {"manoeuvre": "standing still, cooled", "laps": 3, "minutes": 3.0},
            {"manoeuvre": "a slalom", "laps": 1, "minutes": 2.0},
        ],
        "questions": [{"names": p, "probability": q, "nats": 7.5} for p, q in zip(pairs, (0.93, 0.96), strict=True)],
    }  # fmt: skip
    corrected = _path(time_s, rate_rad_s + 0.1 * (wrong - rate_rad_s))
    series = _series(
        rng,
        [
            _recording("morning_run", sparse, _path(time_s, wrong, SPEED_M_S * (1.0 + 0.05 * wet)), corrected),
            _recording(second, reference, _path(time_s, wrong), corrected),
        ],
    )
    both = np.concatenate([times, times])
    twice = {"time_s": both.tolist(), "nats": np.linspace(0.0, 21.4, both.size).tolist()}
    bump = lambda x: 0.08 * np.exp(-(((x - 110.0) / 25.0) ** 2))  # noqa: E731
    knots = np.linspace(0.0, 230.0, 5)
    series["findings"] = [
        {"effect": "surface_slip", "curve": None, "evidence": _evidence(rng, 142.7, 301.2, 358.8)},
        {
            "effect": "gyro_warmup",
            "curve": _curve(
                rng, times, lambda x: 0.229 * np.exp(-x / 139.0), 0.02, "time", "s", "deg/s", "gyro"
            ),
            "evidence": _evidence(rng, 64.1, 0.0, 400.0),
        },
        {
            "effect": "unknown",
            "curve": _curve(rng, np.repeat(knots, 5), bump, 0.01, "place", "m", "deg/s", "gyro")
            | {"y": np.tile(knots, 5).tolist()},
            "evidence": twice,
        },
    ]  # fmt: skip
    series["residual"] = _residual(rng, 1.9)
    series["held_out"] = [
        _held(name, quantity, unit, before, after)
        for name, gain in (("morning_run", 1.0), (second, 1.6))
        for quantity, unit, before, after in (
            ("position rms", "m", 2.2 * gain, 0.6),
            ("heading rms", "deg", 0.9, 0.95 * gain),
        )
    ]
    return diagnosis, series


def nothing_missing() -> Made:
    """A sound robot without a reference."""
    rng = np.random.default_rng(3)
    time_s, rate_rad_s = _drive(rng)
    diagnosis = _diagnosis("case_042", "nothing_missing", [], (0.0, None))
    diagnosis["next_drive"] = None
    series = _series(rng, [_recording("case_042", None, _path(time_s, rate_rad_s), None)])
    series["residual"] = _residual(rng, 1.0)
    return diagnosis, series


def only_unknown() -> Made:
    """An error that is not in the catalogue, and whose covariate is unknown."""
    rng = np.random.default_rng(4)
    diagnosis, series = one_finding()
    diagnosis |= {"verdict": "unknown", "next_drive": None, "classes": []}
    diagnosis["findings"] = [_finding("unknown", "wheels", {}, None, 44.0, None)]
    series["findings"] = [{"effect": "unknown", "curve": None, "evidence": _evidence(rng, 44.0)}]
    series["held_out"] = []
    return diagnosis, series


def write(folder: Path, made: Made) -> Path:
    """Write the two files."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, content in zip(("diagnosis.json", "series.json"), made, strict=True):
        (folder / name).write_text(json.dumps(content), encoding="utf-8")
    return folder


def _drive(rng: np.random.Generator) -> tuple[Array, Array]:
    """Straight lines and corners; times in s, yaw rates in rad/s."""
    time_s = np.arange(0.0, DURATION_S, 0.5)
    rate = np.zeros(time_s.size)
    for start_s in np.arange(20.0, DURATION_S - 10.0, 36.0):
        turn = (time_s >= start_s) & (time_s < start_s + 5.0)
        rate[turn] = 0.5 * np.pi / 5.0 * rng.choice((1.0, 1.0, 1.0, -1.0))
    return time_s, rate


def _path(time_s: Array, rate_rad_s: Array, speed_m_s: Array | float = SPEED_M_S) -> dict[str, list[float]]:
    heading = np.cumsum(rate_rad_s) * 0.5
    x = np.cumsum(speed_m_s * np.cos(heading)) * 0.5
    y = np.cumsum(speed_m_s * np.sin(heading)) * 0.5
    return {"time_s": time_s.tolist(), "x_m": x.tolist(), "y_m": y.tolist()}


def _recording(name: str, reference: Any, nominal: Any, corrected: Any) -> dict[str, Any]:
    path = {"reference": reference, "nominal": nominal, "corrected": corrected}
    return {"name": name, "duration_s": DURATION_S, "path_m": DURATION_S * SPEED_M_S, "path": path}


def _curve(  # one argument per drawn item
    rng: np.random.Generator, x: Array, form: Any, sigma: float, driver: str, unit: str, error_unit: str, channel: str
) -> dict[str, Any]:
    sigmas = sigma * rng.uniform(0.7, 1.8, x.size)
    mismatch: list[float | None] = (form(x) + sigmas * rng.normal(size=x.size)).tolist()
    mismatch[1] = None  # an empty bin
    fit_x = np.linspace(x[0], x[-1], 60)
    fit = form(fit_x)
    half = 0.1 * np.abs(fit) + 0.25 * sigma
    return {
        "driver": driver, "driver_unit": unit, "error_unit": error_unit, "channel": channel,
        "x": x.tolist(), "mismatch": mismatch, "sigma": sigmas.tolist(),
        "fit_x": fit_x.tolist(), "fit": fit.tolist(), "low": (fit - half).tolist(), "high": (fit + half).tolist(),
    }  # fmt: skip


def _evidence(
    rng: np.random.Generator, nats: float, start_s: float = 0.0, end_s: float = DURATION_S
) -> dict[str, list[float]]:
    time_s = np.arange(10.0, DURATION_S + 1.0, 20.0)
    steps = np.where((time_s >= start_s) & (time_s <= end_s), rng.gamma(0.8, 1.0, time_s.size), 0.0)
    walk = 0.15 * rng.normal(size=time_s.size)
    gain = np.cumsum(steps) * nats / steps.sum() + np.cumsum(walk)
    return {"time_s": time_s.tolist(), "nats": gain.tolist()}


def _residual(rng: np.random.Generator, size: float) -> dict[str, list[float]]:
    time_s = np.arange(10.0, DURATION_S, 20.0)
    after = 1.0 + 0.07 * rng.normal(size=time_s.size)
    before = np.sqrt(after**2 + (size**2 - 1.0) * rng.gamma(1.0, 1.0, time_s.size))
    return {"time_s": time_s.tolist(), "before": before.tolist(), "after": after.tolist()}


def _held(name: str, quantity: str, unit: str, before: float, after: float) -> dict[str, Any]:
    return {"name": name, "quantity": quantity, "unit": unit, "before": before, "after": after}


def _finding(
    effect: str, acts_on: str, parameters: dict[str, tuple[float, float, str]], driver: str | None, nats: float,
    explains: float | None, *, windows: Sequence[Sequence[float]] = ((0.0, DURATION_S),),
    also_fits: Sequence[str] = (), status: str = "confirmed",
) -> dict[str, Any]:  # fmt: skip
    return {
        "effect": effect, "status": status, "also_fits": list(also_fits), "acts_on": acts_on,
        "parameters": {name: dict(zip(("value", "std", "unit"), p, strict=True)) for name, p in parameters.items()},
        "windows": [list(window) for window in windows], "driver": driver,
        "evidence": {"gain_nats": nats, "family_wise_p": 0.001, "e_value": float(np.exp(min(0.3 * nats, 600.0)))},
        "explains": explains, "sentence": f"The {acts_on} shows {effect}.",
    }  # fmt: skip


def _diagnosis(
    recording: str, verdict: str, findings: list[dict[str, Any]], unexplained: tuple[float, float | None]
) -> dict[str, Any]:
    ruled_out = {
        "encoder_dropout": "no counter stood still while the other turned",
        "gyro_saturation": "the largest rate, 33 deg/s, is far below the sensor's range",
        "tread_error": "k = 0.0002 ± 0.0003; 0.4 nats",
        "gyro_scale_asymmetry": "k = 0.0001 ± 0.0002; 0.2 nats",
        "gyro_bias_step": "no step above 0.004 deg/s at any time; 1.1 nats",
        "slip_acceleration": "worse by 12 nats than what was found",
    }
    smallest = {
        "gyro_scale_error": (0.0002, "1"), "gyro_bias_step": (0.0041, "deg/s"), "tread_error": (0.0009, "1"),
        "gyro_latency": (0.004, "s"), "gyro_saturation": (None, "deg/s"), "wheel_eccentricity": (0.4, "1"),
        "lateral_slip_turning": (0.0031, "s"), "encoder_clock_skew": (88.0, "ppm"),
    }  # fmt: skip
    return {
        "schema": 1, "recording": recording, "verdict": verdict, "findings": findings,
        "unexplained": {"share_of_residual": unexplained[0], "end_error_m": unexplained[1]},
        "ruled_out": [{"effect": effect, "because": because} for effect, because in ruled_out.items()],
        "detectable": {effect: {"smallest": size, "unit": unit} for effect, (size, unit) in smallest.items()},
        "classes": [],
        "fit": {
            "train": {"before": {"position_rms_m": 1.22}, "after": {"position_rms_m": 0.11}},
            "held_out": {"before": {"position_rms_m": 1.31}, "after": {"position_rms_m": 0.14}},
        },
        "next_drive": None,
    }  # fmt: skip


def _series(rng: np.random.Generator, recordings: list[dict[str, Any]]) -> dict[str, Any]:
    noise = {name: float(rng.normal(1.0, 0.03)) for name in ("slip", "position", "heading")}
    return {"format": "drd-diagnosis-series/1", "recordings": recordings, "findings": [], "residual": {},
            "held_out": [], "noise": noise}  # fmt: skip
