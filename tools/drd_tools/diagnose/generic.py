"""Smooth curves without a name, of every driver and channel: they compete with the catalogue's names."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from drd.effects.effect import Errors
from drd_tools.diagnose.linear import Signature
from drd_tools.diagnose.problem import Claim, Problem
from drd_tools.diagnose.refine import soft_forms

Array = npt.NDArray[np.float64]

KNOTS: Final = 8
AMPLITUDES: Final = tuple(10.0**k for k in np.arange(-1.0, 7.0, 0.5))
# Units of one hat, so that amplitudes are comparable: a rate of 0.01 deg/s, 0.1 % of a wheel's speed, 1 mm/s.
GYRO_UNIT: Final = 1.745e-4
WHEEL_UNIT: Final = 1e-3
LATERAL_UNIT: Final = 1e-3


@dataclass(frozen=True)
class Curve:
    """A smooth error of one channel against one driver: at `knots` (k,), `value` and `sigma` (k,) in public units."""

    channel: str
    driver: str
    unit: str
    driver_unit: str
    knots: Array
    value: Array
    sigma: Array
    gain: float  # nats above the claims, its freedom paid


@dataclass(frozen=True)
class _Smooth:
    channel: str
    driver: str
    knots: Array
    rows: npt.NDArray[np.float32]


class Smooths:
    """All smooth curves of a problem, whitened."""

    def __init__(self, problem: Problem):
        self._problem = problem
        self._smooths: list[_Smooth] = []
        signatures: list[Signature] = []
        spans: list[tuple[str, str, Array, int]] = []
        for driver, (x, knots) in drivers(problem).items():
            for channel, made in self._channels(x, knots, driver):
                spans.append((channel, driver, knots, len(made)))
                signatures += made
        rows = problem.whiten(signatures, np.float32).astype(np.float32, copy=False)
        first = 0
        for channel, driver, knots, count in spans:
            self._smooths.append(_Smooth(channel, driver, knots, rows[:, first : first + count]))
            first += count
        self.cost = math.log(max(len(self._smooths), 1)) + problem.per_parameter

    def _channels(self, x: Array, knots: Array, driver: str) -> list[tuple[str, list[Signature]]]:
        problem, m = self._problem, self._problem.signatures.motion
        hats = [_hat(x, knots, i, driver in PERIODIC) for i in range(len(knots))]
        of = problem.signatures.of
        found = []
        if problem.evidence.gyro_rad is not None:
            found.append(("gyro", [of(Errors(gyro_rad_s=GYRO_UNIT * h)) for h in hats]))
        if not problem.evidence.has_wheels:
            return found
        gain = [of(Errors(left_m_s=WHEEL_UNIT * h * m.left_m_s, right_m_s=WHEEL_UNIT * h * m.right_m_s)) for h in hats]
        spread = [of(Errors(left_m_s=-0.5 * WHEEL_UNIT * h * m.left_m_s, right_m_s=0.5 * WHEEL_UNIT * h * m.right_m_s)) for h in hats]  # noqa: E501  # fmt: skip
        half = 0.5 * (m.right_m_s - m.left_m_s)
        tread = [of(Errors(left_m_s=-WHEEL_UNIT * h * half, right_m_s=WHEEL_UNIT * h * half)) for h in hats]
        found += [("wheels' mean", gain), ("wheels' difference", spread), ("wheels' turn", tread)]
        found.append(("body", [of(Errors(lateral_m_s=LATERAL_UNIT * h * (np.abs(m.speed_m_s) > 0.02))) for h in hats]))
        return found

    def best(
        self, claims: Sequence[Claim], beside: Claim | None = None, wanted: tuple[str, str] | None = None
    ) -> Curve | None:
        """The curve that explains most beside the claims; `beside`: instead of this one of them.

        `wanted`: channel and driver, if only one curve is asked for.
        """
        problem = self._problem
        kept = [c for c in claims if c is not beside]
        T = problem.tangents(kept)
        norms = np.linalg.norm(T, axis=0)
        T = T[:, norms > 0] / norms[norms > 0] * 1e6
        held = np.column_stack([problem.nuisance, T, *(soft_forms(problem, c) for c in kept)])
        residual = problem.data - problem.effect_rows(kept)
        A = held.T @ held + np.eye(held.shape[1])
        cleared = residual - held @ np.linalg.solve(A, held.T @ residual)
        best: Curve | None = None
        for smooth in self._smooths:
            if wanted is not None and (smooth.channel, smooth.driver) != wanted:
                continue
            S = smooth.rows.astype(float)
            C = S.T @ held
            G = S.T @ S - C @ np.linalg.solve(A, C.T)
            gain, value, sigma = _marginal(G, S.T @ cleared, smooth.driver in PERIODIC)
            gain -= self.cost
            if best is None or gain > best.gain:
                unit, factor = _UNITS[smooth.channel]
                driver_unit, si = DRIVER_UNITS[smooth.driver]
                value, sigma = value * factor, sigma * factor
                best = Curve(smooth.channel, smooth.driver, unit, driver_unit, smooth.knots * si, value, sigma, gain)
        return best

    def told(self, claim: Claim, curve: Curve) -> Array:
        """What a claim says at a curve's knots (k,), in its unit: the hats' best fit to the claim's own signature."""
        for smooth in self._smooths:
            if (smooth.channel, smooth.driver) == (curve.channel, curve.driver):
                rows = self._problem.effect_rows([claim])
                S = smooth.rows.astype(float)
                G = S.T @ S
                values = np.linalg.lstsq(G + 1e-9 * np.trace(G) * np.eye(len(G)), S.T @ rows, rcond=None)[0]
                result: Array = values * _UNITS[curve.channel][1]
                return result
        raise KeyError(curve.channel, curve.driver)


def _marginal(G: Array, b: Array, periodic: bool) -> tuple[float, Array, Array]:
    """Evidence of a smooth curve, its size integrated over its best prior; the curve and its deviation."""
    k = len(b)
    D = (
        np.diff(np.eye(k), 2, axis=0)
        if not periodic
        else np.eye(k) - 0.5 * (np.roll(np.eye(k), 1, 0) + np.roll(np.eye(k), -1, 0))
    )
    R = D.T @ D + 0.05 * np.eye(k)
    best = (-math.inf, np.zeros(k), np.zeros(k))
    _, logdet_R = np.linalg.slogdet(R)
    for t in AMPLITUDES:
        M = G + R / t
        sign, logdet = np.linalg.slogdet(M)
        if sign <= 0:
            continue
        x = np.linalg.solve(M, b)
        gain = 0.5 * float(b @ x) - 0.5 * (logdet - logdet_R + k * math.log(t))
        if gain > best[0]:
            best = (gain, x, np.sqrt(np.maximum(np.diag(np.linalg.inv(M)), 0.0)))
    return best


def _hat(x: Array, knots: Array, i: int, periodic: bool) -> Array:
    values = np.zeros(len(knots))
    values[i] = 1.0
    if periodic:
        knots, values = np.append(knots, knots[0] + 2 * np.pi), np.append(values, values[0])
    return np.asarray(np.interp(x, knots, values), float)


PERIODIC: Final = ("heading", "left_wheel_phase", "right_wheel_phase")
DRIVER_UNITS: Final = {
    "yaw_rate": ("deg/s", 180.0 / np.pi),
    "speed": ("m/s", 1.0),
    "acceleration": ("m/s^2", 1.0),
    "temperature": ("degC", 1.0),
    "temperature_rate": ("degC/min", 60.0),
    "time": ("s", 1.0),
    "heading": ("deg", 180.0 / np.pi),
    "left_wheel_phase": ("deg", 180.0 / np.pi),
    "right_wheel_phase": ("deg", 180.0 / np.pi),
}
_UNITS: Final = {
    "gyro": ("deg/s", GYRO_UNIT * 180.0 / np.pi),
    "wheels' mean": ("%", 100.0 * WHEEL_UNIT),
    "wheels' difference": ("%", 100.0 * WHEEL_UNIT),
    "wheels' turn": ("%", 100.0 * WHEEL_UNIT),
    "body": ("m/s", LATERAL_UNIT),
}


def drivers(problem: Problem) -> dict[str, tuple[Array, Array]]:
    """Each variable that an error may depend on: its values on the fine grid, and knots over its range."""
    m = problem.signatures.motion
    found: dict[str, tuple[Array, Array]] = {}
    moving = np.abs(m.speed_m_s) > 0.02
    plain = {
        "yaw_rate": m.rate_rad_s,
        "speed": m.speed_m_s,
        "acceleration": m.acceleration_m_s2,
        "time": m.time_s,
    }
    if np.isfinite(m.temperature_c).all():
        plain["temperature"] = m.temperature_c
        plain["temperature_rate"] = m.temperature_rate_c_s(30.0)
    for name, x in plain.items():
        low, high = np.quantile(x[moving] if name != "time" and moving.any() else x, (0.005, 0.995))
        if high - low > 1e-6 * max(abs(high), abs(low), 1e-9):
            found[name] = (x, np.linspace(low, high, KNOTS))
    for name, x in (
        ("heading", m.heading_rad),
        ("left_wheel_phase", m.left_wheel_rad),
        ("right_wheel_phase", m.right_wheel_rad),
    ):
        if np.ptp(x) > 2 * np.pi and (name == "heading" or problem.evidence.has_wheels):
            found[name] = (np.mod(x, 2 * np.pi), np.linspace(0.0, 2 * np.pi, KNOTS, endpoint=False))
    return found
