"""P-splines of every covariate and channel: unnamed smooth curves that compete with the catalogue's effects."""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from drd.arrays import Array
from drd.effects.effect import Errors, apart, both
from drd.effects.motion import Motion
from drd.units import DEG_PER_RAD
from drd_tools.diagnose.error_model.sensitivities import SUB
from drd_tools.diagnose.observe.evidence import Evidence
from drd_tools.diagnose.regression.marginal import Marginal
from drd_tools.diagnose.regression.problem import Problem
from drd_tools.diagnose.regression.refine import nuisance_design
from drd_tools.diagnose.selected import Selected

KNOTS: Final = 8  # a curve resolves an eighth of the range: limits its freedom
TIME_KNOTS: Final = 16  # for errors that oscillate several times in a drive
CELLS: Final = 5  # in x and in y
DELAY: Final = "wheels' delay"
PLACE: Final = "place"
STANDING_M_S: Final = 0.02  # slower, counts do not show the direction of a slip
# T of (83), nats of a hat: from below noise to beyond any error, half a decade apart.
AMPLITUDES: Final = tuple(10.0**k for k in np.arange(-1.0, 7.0, 0.5))


class Channel(NamedTuple):
    """Channel of a curve. `hat`: size of one hat, SI, to make amplitudes comparable; `public`: units per SI unit."""

    acts_on: str
    unit: str
    hat: float
    public: float

    @property
    def hat_in_public(self) -> float:
        """Size of one hat in the public unit."""
        return self.hat * self.public


CHANNELS: Final = {
    "gyro": Channel("gyro", "deg/s", 1.745e-4, DEG_PER_RAD),
    "gyro's scale": Channel("gyro", "%", 1e-3, 100.0),
    "wheels' mean": Channel("wheels", "%", 1e-3, 100.0),
    "wheels' difference": Channel("wheels", "%", 1e-3, 100.0),
    "wheels' turn": Channel("wheels", "%", 1e-3, 100.0),
    DELAY: Channel("wheels", "ms", 1e-3, 1000.0),
    "body": Channel("body", "m/s", 1e-3, 1.0),
}


def errors_along(m: Motion) -> dict[str, Callable[[Array], Errors]]:
    """Functions, by channel, from a curve's values along a motion, (n,), SI, to errors of the sensors."""
    slope_l, slope_r = (np.gradient(v, m.time_s) for v in (m.left_m_s, m.right_m_s))
    moving = np.abs(m.speed_m_s) > STANDING_M_S
    return {
        "gyro": lambda x: Errors(gyro_rad_s=x),
        "gyro's scale": lambda x: Errors(gyro_rad_s=x * m.rate_rad_s),
        "wheels' mean": lambda x: both(m, x),
        "wheels' difference": lambda x: Errors(left_m_s=-0.5 * x * m.left_m_s, right_m_s=0.5 * x * m.right_m_s),
        "wheels' turn": lambda x: apart(m, x),
        DELAY: lambda x: Errors(left_m_s=-x * slope_l, right_m_s=-x * slope_r),
        "body": lambda x: Errors(lateral_m_s=x * moving),
    }


@dataclass(frozen=True)
class Curve:
    """A smooth error of a channel against a covariate: at `knots` (k,), `value` and `sigma` (k,) in public units.

    The knots of a place are (k, 2): x and y in m.
    """

    channel: str
    covariate: str
    unit: str
    covariate_unit: str
    knots: Array
    value: Array
    sigma: Array
    gain: float  # nats above the selected effects, less the cost of its freedom
    amplitude: float  # T of (83)


@dataclass(frozen=True)
class _SplineTerm:
    channel: str
    covariate: str
    knots: Array
    rows: npt.NDArray[np.float32]
    rough: Array  # (k, k): roughness penalty

    def products(self, marginal: Marginal, projected: Array) -> tuple[Array, Array]:
        """Products of the hats with each other, (k, k), and with data projected by `marginal`, (k,)."""
        S = self.rows.astype(float)
        return marginal.beside(S.T @ S, (S.T @ marginal.columns).T), S.T @ projected


class SplineTerms:
    """All smooth curves of a problem, whitened."""

    def __init__(self, problem: Problem):
        self._problem = problem
        self._splines: list[_SplineTerm] = []
        readings, of = problem.readings, problem.sensitivities.of
        errors = errors_along(readings.motion)
        for covariate, hats, knots in self._hats():
            for name in CHANNELS:
                if not _is_shown(problem.evidence, name, covariate):
                    continue
                made = [of(errors[name](CHANNELS[name].hat * h)) for h in hats]
                if name != DELAY:
                    made = [readings.delayed(one) for one in made]
                rows = problem.whiten(made, np.float32).astype(np.float32, copy=False)
                self._splines.append(_SplineTerm(name, covariate, knots, rows, _roughness(covariate, len(made))))
        self.cost = math.log(max(len(self._splines), 1)) + problem.per_parameter

    def _hats(self) -> Iterator[tuple[str, list[Array], Array]]:
        """Each covariate, its hats on the fine grid, and their knots."""
        for name, (x, knots) in covariates(self._problem).items():
            yield name, [_hat(x, knots, i, name in PERIODIC) for i in range(len(knots))], knots
        e = self._problem.evidence
        if e.has_wheels and len(e.fix):
            fine = np.linspace(0.0, len(e.time_s), SUB * len(e.time_s), endpoint=False)
            x, y = (np.interp(fine, np.arange(len(e.time_s) + 1), self._problem.path.pose[:, i]) for i in (0, 1))
            yield PLACE, *_cells(x, y)

    def best(
        self, selection: Sequence[Selected], beside: Selected | None = None, wanted: tuple[str, str] | None = None
    ) -> Curve | None:
        """The curve that explains most beside the selected effects; `beside`: the one of them that it replaces.

        `wanted`: channel and covariate of the only curve to try.
        """
        marginal, cleared = self._cleared([c for c in selection if c is not beside])
        best: Curve | None = None
        for smooth in self._splines:
            if wanted is not None and (smooth.channel, smooth.covariate) != wanted:
                continue
            gain, value, sigma, amplitude = _evidence(*smooth.products(marginal, cleared), smooth.rough)
            gain -= self.cost
            if best is None or gain > best.gain:
                channel = CHANNELS[smooth.channel]
                covariate_unit, si = COVARIATE_UNITS[smooth.covariate]
                value, sigma = value * channel.hat_in_public, sigma * channel.hat_in_public
                knots = smooth.knots * si
                best = Curve(
                    smooth.channel, smooth.covariate, channel.unit, covariate_unit, knots, value, sigma, gain, amplitude
                )
        return best

    def nats_of_name(self, selection: Sequence[Selected], selected: Selected) -> float:
        """Gain of one of the selected effects, as it is, where `best` has the gain of the curve that replaces it."""
        marginal, cleared = self._cleared([c for c in selection if c is not selected])
        own = self._problem.effect_rows([selected])
        norm = max(float(own @ marginal.projected(own)), 1e-300)  # 0 if nothing shows it
        return 0.5 * float(own @ cleared) ** 2 / norm

    def reported(self, selected: Selected, others: Sequence[Selected], curve: Curve) -> Array:
        """Curve (k,), in its unit, estimated from the rows of an effect alone, beside others, with the same prior. (83)

        It is comparable with the curve of the mismatch: in both, the prior alone determines values at standstill.
        """
        smooth, marginal = self._of(curve), Marginal(nuisance_design(self._problem, others))
        G, b = smooth.products(marginal, marginal.projected(self._problem.effect_rows([selected])))
        value = np.linalg.solve(G + smooth.rough / curve.amplitude, b)
        return np.asarray(value * CHANNELS[curve.channel].hat_in_public, float)

    def rows(self, curve: Curve) -> Array:
        """The whitened data that a curve explains, (r,)."""
        result: Array = self._of(curve).rows @ (curve.value / CHANNELS[curve.channel].hat_in_public)
        return result

    def columns(self, curve: Curve) -> Array:
        """Whitened basis of a curve, (r, k), scaled so that each coefficient has the prior 1."""
        smooth = self._of(curve)
        root = np.linalg.cholesky(smooth.rough / curve.amplitude)
        return np.asarray(np.linalg.solve(root, smooth.rows.T.astype(float)).T)

    def _cleared(self, kept: Sequence[Selected]) -> tuple[Marginal, Array]:
        """Marginal of the nuisances and the effects that are kept, and the data without them, projected by it, (r,)."""
        marginal = Marginal(nuisance_design(self._problem, kept))
        return marginal, marginal.projected(self._problem.data - self._problem.effect_rows(kept))

    def _of(self, curve: Curve) -> _SplineTerm:
        return next(s for s in self._splines if (s.channel, s.covariate) == (curve.channel, curve.covariate))


def _roughness(covariate: str, k: int) -> Array:
    """Penalty on second differences (on a ring for phases; in x and y for places), and slightly on the size. (83)"""
    if covariate == PLACE:
        second, one = np.diff(np.eye(CELLS), 2, axis=0), np.eye(CELLS)
        return np.kron(second.T @ second, one) + np.kron(one, second.T @ second) + 0.05 * np.eye(k)
    second = np.diff(np.eye(k), 2, axis=0)
    if covariate in PERIODIC:
        second = np.eye(k) - 0.5 * (np.roll(np.eye(k), 1, 0) + np.roll(np.eye(k), -1, 0))
    rough: Array = second.T @ second + 0.05 * np.eye(k)
    return rough


def _evidence(G: Array, b: Array, R: Array) -> tuple[float, Array, Array, float]:
    """Evidence of a smooth curve, maximised over its prior's amplitude; curve, deviation, that amplitude. (83)"""
    k = len(b)
    best = (-math.inf, np.zeros(k), np.zeros(k), AMPLITUDES[0])
    _, logdet_R = np.linalg.slogdet(R)
    for t in AMPLITUDES:
        M = G + R / t
        sign, logdet = np.linalg.slogdet(M)
        if sign <= 0:
            continue
        x = np.linalg.solve(M, b)
        gain = 0.5 * float(b @ x) - 0.5 * (logdet - logdet_R + k * math.log(t))
        if gain > best[0]:
            best = (gain, x, np.sqrt(np.maximum(np.diag(np.linalg.inv(M)), 0.0)), t)
    return best


def _cells(x: Array, y: Array) -> tuple[list[Array], Array]:
    """Bilinear hats on a grid of CELLS by CELLS knots over the places, and the knots, (k, 2)."""
    knots = [np.linspace(v.min(), v.max() + 1e-9, CELLS) for v in (x, y)]
    along, across = ([_hat(v, at, i, False) for i in range(CELLS)] for v, at in zip((x, y), knots, strict=True))
    return [a * b for a in along for b in across], np.array([(a, b) for a in knots[0] for b in knots[1]])


def _hat(x: Array, knots: Array, i: int, periodic: bool) -> Array:
    values = np.zeros(len(knots))
    values[i] = 1.0
    if periodic:
        knots, values = np.append(knots, knots[0] + 2 * np.pi), np.append(values, values[0])
    return np.asarray(np.interp(x, knots, values), float)


PERIODIC: Final = ("heading", "left_wheel_phase", "right_wheel_phase")
COVARIATE_UNITS: Final = {
    "yaw_rate": ("deg/s", DEG_PER_RAD),
    "speed": ("m/s", 1.0),
    "acceleration": ("m/s^2", 1.0),
    "temperature": ("degC", 1.0),
    "temperature_rate": ("degC/min", 60.0),
    "time": ("s", 1.0),
    "heading": ("deg", DEG_PER_RAD),
    "left_wheel_phase": ("deg", DEG_PER_RAD),
    "right_wheel_phase": ("deg", DEG_PER_RAD),
    "lateral_acceleration": ("m/s^2", 1.0),
    PLACE: ("m", 1.0),
}


# A delay comes from electronics: an error that grows with the change of the motion and depends on the motion is slip.
# The gyro's scale as a function of the rate is the same as the gyro's error as a function of the rate.
COVARIATES_OF: Final = {
    DELAY: ("time", "temperature", "temperature_rate"),
    "gyro's scale": tuple(d for d in COVARIATE_UNITS if d != "yaw_rate"),
}


def _is_shown(e: Evidence, channel: str, covariate: str) -> bool:
    """Whether a recording shows a curve of this channel and covariate."""
    if CHANNELS[channel].acts_on not in e.channels or covariate not in COVARIATES_OF.get(channel, (covariate,)):
        return False
    # Without a gyro a delay that varies may equally be the reference's.
    return (channel, covariate) != (DELAY, "time") or e.gyro_rad is not None


def covariates(problem: Problem) -> dict[str, tuple[Array, Array]]:
    """Each variable that an error may depend on: its values on the fine grid, and knots over its range."""
    m = problem.sensitivities.motion
    found: dict[str, tuple[Array, Array]] = {}
    moving = np.abs(m.speed_m_s) > STANDING_M_S
    plain = {
        "yaw_rate": m.rate_rad_s,
        "speed": m.speed_m_s,
        "acceleration": m.acceleration_m_s2,
        "lateral_acceleration": m.speed_m_s * m.rate_rad_s,
        "time": m.time_s,
    }
    if np.isfinite(m.temperature_c).all():
        plain["temperature"] = m.temperature_c
        plain["temperature_rate"] = m.temperature_rate_c_s(30.0)
    for name, x in plain.items():
        low, high = np.quantile(x[moving] if name != "time" and moving.any() else x, (0.005, 0.995))
        if high - low > 1e-6 * max(abs(high), abs(low), 1e-9):
            found[name] = (x, np.linspace(low, high, TIME_KNOTS if name == "time" else KNOTS))
    for name, x in (
        ("heading", m.heading_rad),
        ("left_wheel_phase", m.left_wheel_rad),
        ("right_wheel_phase", m.right_wheel_rad),
    ):
        if np.ptp(x) > 2 * np.pi and (name == "heading" or problem.evidence.has_wheels):
            found[name] = (np.mod(x, 2 * np.pi), np.linspace(0.0, 2 * np.pi, KNOTS, endpoint=False))
    return found
