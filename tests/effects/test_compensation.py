"""What the daemon takes off is what the simulator adds, sample by sample and without the future."""

import gc
import math
import tracemalloc
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
from effect_motions import RADIUS_M, TREAD_M, driven
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from drd.arrays import Array
from drd.config.keys import Robot
from drd.effects.catalogue import catalogue
from drd.effects.chain import add
from drd.effects.compensation import Compensation, LiveTerm
from drd.effects.effect import Effect, Parameter
from drd.effects.live import Clip, LiveMotion
from drd.effects.model import COVARIATES, Amount, Term, make_model
from drd.effects.motion import Motion
from drd.samples import CalibratedRate, WheelSample
from drd.units import RAD_PER_DEG

ROBOT = Robot(wheel_radius_m=RADIUS_M, tread_m=TREAD_M)
TRUTH_HZ, GYRO_S, WHEEL_S = 500.0, 0.1, 0.05
SECONDS, LONGER_S, STAND_S = 60.0, 6.0, 2.0
ZERO_NS = 1_000_000_000_000
S = 1_000_000_000
REVERSIBLE = [effect for effect in catalogue().values() if not effect.irreversible]
IRREVERSIBLE = [effect for effect in catalogue().values() if effect.irreversible]
# A share of nothing says nothing: errors of an angle or of a way below this are rounding.
NOTHING = 1e-7


def lively(seed: int) -> Motion:
    """Turns that begin within half a second, speeds within two, after a standstill; warming and cooling."""
    rng = np.random.default_rng(seed)
    time_s = np.arange(round((SECONDS + LONGER_S) * TRUTH_HZ)) / TRUTH_HZ

    def steps(low: float, high: float, within_s: float) -> Array:
        width = round(within_s * TRUTH_HZ)
        soft = np.hanning(width + 2)[1:-1] / np.hanning(width + 2).sum()
        held = np.repeat(rng.uniform(low, high, 64), round(1.7 * TRUTH_HZ))[: len(time_s)]
        held[time_s < STAND_S] = 0.0
        return np.convolve(np.pad(held, width, mode="edge"), soft, mode="same")[width:-width]

    speed, rate = steps(-0.3, 1.5, 1.8), steps(-1.2, 1.2, 0.5)
    temperature_c = 20.0 + 4.0 * np.sin(np.pi * time_s / (SECONDS + LONGER_S))
    return replace(driven(time_s, speed, rate, temperature_c), end_s=SECONDS)


MOTIONS = {seed: lively(seed) for seed in range(4)}


@dataclass
class Left:
    """Cumulative errors, of angle (rad) or of the way of left wheel, right wheel and body to its left (m)."""

    before: Array
    after: Array

    def share(self) -> float:
        """What the removal leaves, of the effect; rms over the run, of the sum of all channels."""
        before, after = float(np.sqrt(np.mean(self.before**2))), float(np.sqrt(np.mean(self.after**2)))
        return after / before if before > NOTHING else 0.0


def cumulative(rate: Array) -> Array:
    return np.concatenate([[0.0], np.cumsum(rate[:-1])]) / TRUTH_HZ


def at(times_s: Array, truth: Motion, total: Array) -> Array:
    return np.interp(times_s, truth.time_s, total)


def remove(truth: Motion, terms: list[Term]) -> tuple[Left, Left]:
    """Cumulative errors of the gyro's angle and of the ways, before and after removal by a compensation."""
    read, lateral = add(truth, [(term.effect, term.values()) for term in terms])
    angle, heading = cumulative(read.rate_rad_s), truth.heading_rad
    ways = [cumulative(x) for x in (read.left_m_s, read.right_m_s)]
    true_ways = [cumulative(x) for x in (truth.left_m_s, truth.right_m_s, lateral)]
    model = Compensation(terms, ROBOT, True, ZERO_NS, SECONDS)
    gyro, wheels = [], []
    for k in range(1, round(SECONDS / WHEEL_S) + 1):
        end_s = k * WHEEL_S
        if k % 2 == 0:
            rate = float(np.diff(at(np.array([end_s - GYRO_S, end_s]), truth, angle))[0]) / GYRO_S
            sample = CalibratedRate(ZERO_NS + round(end_s * S), GYRO_S, rate, 0.0)
            middle = float(at(np.array([end_s - 0.5 * GYRO_S]), truth, heading)[0])
            found = model.gyro(sample, float(at(np.array([end_s]), truth, truth.temperature_c)[0]), middle, False)
            gyro.append((end_s, (found.t_ns - ZERO_NS) / S, found.rate_rad_s * found.interval_s))
        left, right = (float(np.diff(at(np.array([end_s - WHEEL_S, end_s]), truth, way))[0]) for way in ways)
        was = model.wheels(WheelSample(ZERO_NS + round(end_s * S), WHEEL_S, left, right, 0.0), 0.0)
        own_m = model.lateral_m_s * was.interval_s
        wheels.append((end_s, (was.t_ns - ZERO_NS) / S, was.left_m, was.right_m, own_m))
    g, w = np.array(gyro).T, np.array(wheels).T
    true_angle = cumulative(truth.rate_rad_s)
    of_gyro = Left(at(g[0], truth, angle) - at(g[0], truth, true_angle), np.cumsum(g[2]) - at(g[1], truth, true_angle))
    raw = [*ways, np.zeros_like(angle)]  # no sensor tells the body's own
    before = [at(w[0], truth, a) - at(w[0], truth, b) for a, b in zip(raw, true_ways, strict=True)]
    after = [np.cumsum(w[2 + i]) - at(w[1], truth, b) for i, b in enumerate(true_ways)]
    return of_gyro, Left(np.array(before), np.array(after))


# A twentieth of each drive is faster than 1.2 m/s; of a threshold that is passed for a moment all is edge.
WITHIN = {
    "t0": (5.0, 20.0),
    "t1": (35.0, 55.0),
    "T0": (15.0, 25.0),
    "largest_rate": (75.0, 100.0),
    "speed": (0.05, 1.2),
}


def sizes(q: Parameter, sign: float) -> st.SearchStrategy[float]:
    """Over the plausible range, small ones as often as large ones."""
    if q.name in WITHIN:
        return st.floats(*WITHIN[q.name])
    # Half of the way lost at 2 m/s^2 is a skid; no removal holds there.
    high = min(q.high, 0.2) if q.unit == "s^2/m" else q.high
    if q.low > 0.0:
        return st.floats(math.log(q.low), math.log(high)).map(lambda x: math.exp(x) * (sign if q.signed else 1.0))
    return st.floats(q.low, high)


@st.composite
def terms(draw: st.DrawFn, effect: Effect) -> Term:
    """With plausible parameters, all of one sign: of what two of them leave of each other no share is small."""
    sign = draw(st.sampled_from((1.0, -1.0)))
    found: dict[str, Amount | str] = {}
    for q in effect.parameters:
        found[q.name] = draw(st.sampled_from(q.choices)) if q.choices else Amount(draw(sizes(q, sign)))
    return Term(effect, found)


@pytest.mark.parametrize("effect", REVERSIBLE, ids=lambda effect: effect.id)
@settings(deadline=None, max_examples=4, suppress_health_check=[HealthCheck.too_slow])
@given(data=st.data(), seed=st.sampled_from(sorted(MOTIONS)))
def test_remove_after_add_gives_the_truth_within_the_bound(effect: Effect, data: st.DataObject, seed: int) -> None:
    term = data.draw(terms(effect))
    gyro, ways = remove(MOTIONS[seed], [term])
    assert gyro.share() <= effect.remainder, term
    assert ways.share() <= effect.remainder, term


@pytest.mark.parametrize(("k", "seed"), [(0.1969117, 1), (0.1969117, 3), (0.195, 3), (0.2, 1)])
def test_slip_that_takes_many_passes_is_removed_all_the_same(k: float, seed: int) -> None:
    """What twelve of them leave of a sample, the next ones amplify."""
    slip = catalogue()["slip_acceleration"]
    _, ways = remove(MOTIONS[seed], [Term(slip, {"k": Amount(k)})])
    assert ways.share() <= slip.remainder


LOOKS = 12.0  # at slip in a sample: 17 where each sample begins anew


def test_effects_that_depend_on_each_other_are_taken_off_in_few_looks_at_each(monkeypatch: pytest.MonkeyPatch) -> None:
    """A skid-steer robot's model."""
    sizes = {"tread_error": {"k": 0.65}, "wheel_radius_error": {"left": -0.05, "right": -0.03}}
    sizes |= {"slip_acceleration": {"k": 0.09}, "encoder_latency": {"delay": 0.0}}
    looks, look = [], LiveTerm.wheels

    def counted(term: LiveTerm) -> tuple[float, ...]:
        looks.append(term.effect.id)
        return look(term)

    monkeypatch.setattr(LiveTerm, "wheels", counted)
    remove(MOTIONS[1], [Term(catalogue()[name], {q: Amount(v) for q, v in p.items()}) for name, p in sizes.items()])
    samples = SECONDS / WHEEL_S
    assert samples < looks.count("slip_acceleration") < LOOKS * samples
    assert len(looks) - looks.count("slip_acceleration") <= 4  # geometry is inverted once; a delay acts on the stamps


@pytest.mark.parametrize("effect", IRREVERSIBLE, ids=lambda effect: effect.id)
@settings(deadline=None, max_examples=3, suppress_health_check=[HealthCheck.too_slow])
@given(data=st.data())
def test_what_cannot_be_taken_off_is_not_made_worse(effect: Effect, data: st.DataObject) -> None:
    term = data.draw(terms(effect))
    gyro, ways = remove(MOTIONS[0], [term])
    assert max(gyro.share(), ways.share()) <= effect.remainder + 1e-6, term


def test_several_effects_one_behind_the_other_come_off_in_the_reverse_order() -> None:
    model = make_model(
        [
            {"effect": "gyro_latency", "parameters": {"delay": 0.08}},
            {"effect": "gyro_scale_error", "parameters": {"k": 0.03}},
            {"effect": "gyro_scale_nonlinearity", "parameters": {"a2": 0.5, "a3": 0.4, "largest_rate": 80}},
            {"effect": "gyro_bias_temperature", "parameters": {"b1": 0.01}},
            {"effect": "tread_error", "parameters": {"k": 0.3}},
            {"effect": "wheel_radius_error", "parameters": {"left": 0.05, "right": -0.05}},
            {"effect": "wheel_radius_speed", "parameters": {"k": 0.01}},
            {"effect": "rotation_centre_offset", "parameters": {"a": 0.2}},
        ]
    )
    gyro, ways = remove(MOTIONS[1], list(model.terms))
    assert gyro.share() < 0.01
    assert ways.share() < 0.01


@pytest.mark.parametrize(
    "effect",
    [
        {"effect": "surface_slip", "parameters": {"t0": 5.0, "t1": 55.0, "left": 0.2, "right": 0.0}},
        {"effect": "tyre_deflation", "parameters": {"side": "left", "total": 0.1}},
        {"effect": "encoder_missed_counts", "parameters": {"side": "right", "fraction": 0.1, "speed": 0.05}},
    ],
    ids=lambda node: node["effect"],
)
def test_what_acts_on_one_wheel_comes_off_before_a_skid_steer_robots_tread(effect: dict[str, Any]) -> None:
    tread = {"effect": "tread_error", "parameters": {"k": 0.65}}
    _, ways = remove(MOTIONS[1], list(make_model([tread, effect]).terms))
    assert ways.share() < 0.01


# ---- one sample at a time --------------------------------------------------------------------------------------


def compensation(*effects: dict[str, Any], has_gyro: bool = True) -> Compensation:
    return Compensation(make_model(effects).terms, ROBOT, has_gyro)


def corrected(model: Compensation, rate_deg_s: float, temperature_c: float = math.nan, k: int = 1) -> CalibratedRate:
    sample = CalibratedRate(ZERO_NS + k * S // 10, 0.1, rate_deg_s * RAD_PER_DEG, 0.0)
    return model.gyro(sample, temperature_c, 0.0, False)


SCALE = {"effect": "gyro_scale_error", "parameters": {"k": {"value": 0.01, "std": 0.002}}}


def test_the_parameters_spread_goes_into_the_rates_sigma() -> None:
    found = corrected(compensation(SCALE), 50.5)
    assert found.rate_rad_s == pytest.approx(50.0 * RAD_PER_DEG, rel=1e-9)
    assert found.sigma_rad_s == pytest.approx(0.002 * found.rate_rad_s)


def test_spreads_of_several_parameters_and_the_calibrations_add_up_as_variances() -> None:
    model = compensation(SCALE, {"effect": "gyro_bias_temperature", "parameters": {
        "b1": {"value": 0.0, "std": 0.001}, "b2": {"value": 0.01, "std": 0.0002}}})  # fmt: skip
    corrected(model, 0.0, 20.0)
    sample = CalibratedRate(ZERO_NS + S, 0.1, 0.5, 0.004)
    found = model.gyro(sample, 30.0, 0.0, False)
    scaled = found.rate_rad_s + RAD_PER_DEG  # the scale is applied to the sum of the true rate and of 1 deg/s
    parts = (0.004, 0.002 * scaled, 0.01 * RAD_PER_DEG, 0.02 * RAD_PER_DEG)
    assert found.sigma_rad_s == pytest.approx(math.hypot(*parts))


def test_outside_the_range_seen_the_correction_stays_and_the_sigma_grows() -> None:
    model = compensation({**SCALE, "seen": {"yaw_rate": [-40, 40]}})
    inside, outside = corrected(model, 40.4, k=1), corrected(model, -60.0, k=2)
    assert inside.rate_rad_s == pytest.approx(40.0 * RAD_PER_DEG)
    assert outside.rate_rad_s == pytest.approx(-59.6 * RAD_PER_DEG)
    assert model.outside
    # 0.2 % of the 40 deg/s seen, and 1 % of the 19.6 beyond.
    assert outside.sigma_rad_s == pytest.approx(math.hypot(0.08, 0.196) * RAD_PER_DEG, rel=1e-6)
    assert corrected(model, 10.0, k=3).rate_rad_s == pytest.approx(10.0 / 1.01 * RAD_PER_DEG)
    assert not model.outside


@pytest.mark.parametrize("covariate", sorted(COVARIATES))
def test_a_covariate_outside_is_noticed_and_put_back(covariate: str) -> None:
    m = LiveMotion(TREAD_M, RADIUS_M, 100.0)
    values = {"time": 50.0, "yaw_rate": 60.0, "speed": 2.0, "acceleration": 1.0,
              "lateral_acceleration": 120.0 * RAD_PER_DEG,
              "curvature": 30.0 * RAD_PER_DEG, "temperature": 30.0}  # fmt: skip
    m.time_s[0], m.rate_rad_s[0], m.speed_m_s[0], m.acceleration_m_s2[0] = 50.0, 60.0 * RAD_PER_DEG, 2.0, 1.0
    m.left_m_s[0], m.right_m_s[0] = 2.0 - 0.3 * m.rate_rad_s[0], 2.0 + 0.3 * m.rate_rad_s[0]
    m.warm(0.0, 20.0)
    m.temperature_rate_c_s(10.0)
    m.warm(10.0, 30.0)
    values["temperature_rate"] = float(m.temperature_rate_c_s(10.0)[0])
    before = [float(x[0]) for x in (m.time_s, m.rate_rad_s, m.speed_m_s, m.left_m_s, m.right_m_s, m.temperature_c)]
    for ends, is_outside in (((0.0, 0.9 * values[covariate]), True), ((0.0, 1.1 * values[covariate]), False)):
        clip = Clip(m, make_model([{**SCALE, "seen": {covariate: list(ends)}}]).terms[0])
        found = clip.apply()
        rate = float(m.temperature_rate_c_s(10.0)[0])
        speed, turn = 0.5 * float((m.left_m_s + m.right_m_s)[0]), float((m.right_m_s - m.left_m_s)[0]) / TREAD_M
        now = {"time": m.time_s[0], "yaw_rate": turn / RAD_PER_DEG, "speed": speed,
               "acceleration": m.acceleration_m_s2[0], "lateral_acceleration": m.speed_m_s[0] * m.rate_rad_s[0],
               "curvature": abs(m.rate_rad_s[0] / m.speed_m_s[0]), "temperature": m.temperature_c[0],
               "temperature_rate": rate}  # fmt: skip
        assert now[covariate] == pytest.approx(min(values[covariate], ends[1]), rel=1e-4)
        assert (clip.undo() or found) is is_outside
        after = [float(x[0]) for x in (m.time_s, m.rate_rad_s, m.speed_m_s, m.left_m_s, m.right_m_s, m.temperature_c)]
        assert after == before


def test_an_unknown_temperature_is_outside_and_corrects_nothing() -> None:
    model = compensation(
        {"effect": "gyro_bias_temperature", "parameters": {"b1": 0.05}, "seen": {"temperature": [0, 9]}}
    )
    assert corrected(model, 7.0).rate_rad_s == 7.0 * RAD_PER_DEG
    assert model.outside


def test_the_temperature_of_the_standstill_is_its_mean() -> None:
    model = compensation({"effect": "gyro_bias_temperature", "parameters": {"b1": 0.05}})
    for k, temperature_c in enumerate((20.0, 21.0, 22.0)):
        model.gyro(CalibratedRate(ZERO_NS + k * S // 10, 0.1, 0.0, 0.0), temperature_c, 0.0, True)
    assert corrected(model, 0.0, 25.0, 9).rate_rad_s == pytest.approx(-0.05 * 4.0 * RAD_PER_DEG)
    assert corrected(model, 0.0, 21.0, 10).rate_rad_s == 0.0


def test_the_lagged_rate_of_temperature_is_the_simulators() -> None:
    truth = MOTIONS[2]
    sampled = replace(truth, time_s=truth.time_s[::50], temperature_c=truth.temperature_c[::50])
    wanted = sampled.temperature_rate_c_s(30.0)
    m, found = LiveMotion(TREAD_M, RADIUS_M, 100.0), []
    m.temperature_rate_c_s(30.0)
    for time_s, temperature_c in zip(sampled.time_s.tolist(), sampled.temperature_c.tolist(), strict=True):
        m.warm(time_s, temperature_c)
        m.warm(time_s, math.nan)
        found.append(float(m.temperature_rate_c_s(30.0)[0]))
    np.testing.assert_allclose(found, wanted, atol=1e-12)


def test_a_robot_without_gyro_takes_the_rate_from_its_wheels() -> None:
    model = compensation({"effect": "rotation_centre_offset", "parameters": {"a": 0.2}}, has_gyro=False)
    found = model.wheels(WheelSample(ZERO_NS, 0.05, 0.02, 0.05, 0.0), 0.0)
    assert (found.left_m, found.right_m) == pytest.approx((0.02, 0.05))
    assert model.lateral_m_s == pytest.approx(0.2 * 0.03 / 0.05 / TREAD_M)


def test_a_gyro_that_fell_silent_no_longer_speaks_for_the_rate() -> None:
    model = compensation({"effect": "rotation_centre_offset", "parameters": {"a": 0.2}})
    corrected(model, 30.0)
    model.wheels(WheelSample(ZERO_NS + S // 5, 0.05, 0.02, 0.02, 0.0), 0.0)
    assert model.lateral_m_s == pytest.approx(0.2 * 30.0 * RAD_PER_DEG)
    model.wheels(WheelSample(ZERO_NS + 2 * S, 0.05, 0.02, 0.02, 0.0), 0.0)
    assert model.lateral_m_s == 0.0


def test_delays_shift_the_stamps_and_a_clock_stretches_the_intervals() -> None:
    model = compensation({"effect": "gyro_latency", "parameters": {"delay": 0.07}},
                         {"effect": "encoder_latency", "parameters": {"delay": 0.03}},
                         {"effect": "gyro_sample_clock", "parameters": {"ratio": 1.02}})  # fmt: skip
    first = corrected(model, 1.0, k=0)
    assert model.gyro_delay_ns == pytest.approx(0.07 * S, rel=0.03)
    later = corrected(model, 1.0, k=1000)
    assert (later.t_ns - first.t_ns) / S == pytest.approx(100.0 / 1.02, abs=0.01)
    assert later.interval_s == pytest.approx(0.1 / 1.02)
    found = model.wheels(WheelSample(ZERO_NS + S, 0.05, 0.02, 0.02, 0.3), 0.0)
    assert found == pytest.approx(WheelSample(ZERO_NS + S - 30_000_000, 0.05, 0.02, 0.02, 0.3))


@settings(deadline=None, max_examples=60)
@given(
    st.sampled_from(list(catalogue().values())).flatmap(terms),
    st.lists(st.tuples(st.floats(-1e3, 1e3), st.floats(-100, 100), st.floats(-100, 200) | st.just(math.nan),
                       st.integers(-5, 50)), max_size=12),
)  # fmt: skip
def test_whatever_the_samples_are_the_result_is_a_number(
    term: Term, samples: list[tuple[float, float, float, int]]
) -> None:
    seen = {"yaw_rate": (-1.0, 1.0), "speed": (0.1, 1.0), "acceleration": (-1.0, 0.0), "curvature": (0.0, 1.0),
            "lateral_acceleration": (-1.0, 1.0), "time": (0.0, 1.0), "temperature_rate": (0.0, 1e-3)}  # fmt: skip
    model, t_ns = Compensation([term, replace(term, seen=seen)], ROBOT, True), ZERO_NS
    for rate, speed, temperature_c, step in samples:
        t_ns += step * S // 20
        found = model.gyro(CalibratedRate(t_ns, 0.1, rate, 0.0), temperature_c, rate, False)
        wheels = model.wheels(WheelSample(t_ns, 0.05, 0.05 * speed, 0.05 * rate / 10.0, 0.0), rate)
        numbers = (*found, *wheels, model.lateral_m_s)
        assert all(map(math.isfinite, numbers)), (term, numbers)


@pytest.mark.parametrize("a3_deg_s", [5.0, 15.0, 20.0, 30.0])
def test_the_spread_is_that_at_the_true_rate_also_where_the_secant_leaves_a_little(a3_deg_s: float) -> None:
    parameters = {"a2": 0.0, "a3": {"value": a3_deg_s, "std": 0.1}, "largest_rate": 80.0}
    found = corrected(compensation({"effect": "gyro_scale_nonlinearity", "parameters": parameters}), 75.0)
    error_rad_s = 75.0 * RAD_PER_DEG - found.rate_rad_s  # in proportion to a3
    assert found.sigma_rad_s == pytest.approx(0.1 / a3_deg_s * error_rad_s, rel=1e-3)


@pytest.mark.parametrize(
    ("effect", "parameters"),
    [
        ("terrain_tread", {"t0": 0.0, "t1": 9.0, "tread": -0.91, "gain": -1.98}),
        ("slip_acceleration", {"k": 0.58}),
        ("gyro_scale_nonlinearity", {"a2": 3.0, "a3": -4.1, "largest_rate": 8.7}),
    ],
)
def test_an_effect_that_cannot_be_undone_does_not_run_away(effect: str, parameters: dict[str, float]) -> None:
    """Each pass sets out from the last one's error: 100 of them would make 1e34 m of a metre."""
    model = compensation({"effect": effect, "parameters": parameters})
    largest, is_told = 0.0, False
    for k in range(1, 161):
        turn = 0.8 * math.sin(k / 9.0)
        speed = 0.7 + 0.4 * math.sin(k / 17.0)
        rate = corrected(model, turn / RAD_PER_DEG, k=k // 2) if k % 2 else None
        is_told |= model.outside
        left_m, right_m = (0.05 * (speed + side * 0.5 * turn * TREAD_M) for side in (-1.0, 1.0))
        found = model.wheels(WheelSample(ZERO_NS + k * S // 20, 0.05, left_m, right_m, 0.0), 0.0)
        is_told |= model.outside
        shares = (abs(found.left_m) / 0.065, abs(found.right_m) / 0.065, abs(rate.rate_rad_s) / 0.8 if rate else 0.0)
        largest = max(largest, *shares)
    assert largest < 10.0
    assert is_told


def test_no_memory_grows_with_the_samples() -> None:
    one_of_each: list[dict[str, Any]] = [
        {
            "effect": e.id,
            "parameters": {q.name: q.choices[0] if q.choices else 0.5 * (q.low + q.high) for q in e.parameters},
            "seen": {"yaw_rate": [-9, 9]},
        }
        for e in catalogue().values()
    ]
    model = compensation(*one_of_each)

    def drive(begin: int, end: int) -> None:
        for k in range(begin, end):
            corrected(model, 20.0 * math.sin(0.1 * k), 20.0 + 0.01 * k, k)
            model.wheels(WheelSample(ZERO_NS + k * S // 10, 0.1, 0.05, 0.06, 0.0), 0.0)

    drive(1, 30)
    gc.collect()
    tracemalloc.start()
    drive(30, 60)
    gc.collect()
    before = tracemalloc.get_traced_memory()[0]
    drive(60, 150)
    gc.collect()
    growth = tracemalloc.get_traced_memory()[0] - before
    tracemalloc.stop()
    assert growth < 2000
