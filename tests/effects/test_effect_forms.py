"""Each formula, at values computed by hand; what is linear, what is nothing, and which sign is which."""

from dataclasses import fields, replace
from math import pi

import numpy as np
import pytest
from effect_motions import TREAD_M, driven, in_si, motion
from hypothesis import given, settings
from hypothesis import strategies as st

from drd.arrays import Array
from drd.effects.catalogue import catalogue
from drd.effects.effect import ActsOn, Effect, Errors
from drd.effects.motion import Motion
from drd.units import DEG_PER_RAD, RAD_PER_DEG

EFFECTS = catalogue()
EVERY = pytest.mark.parametrize("effect", EFFECTS.values(), ids=lambda effect: effect.id)
# At 100 s a left turn at 1 m/s and 0.5 rad/s, speeding up, warm; at 200 s a right one, slower, braking, cold.
TWO = Motion(
    time_s=np.array([100.0, 200.0]),
    rate_rad_s=np.array([0.5, -0.2]),
    speed_m_s=np.array([1.0, 0.5]),
    acceleration_m_s2=np.array([0.4, -1.0]),
    heading_rad=np.array([0.0, pi / 2]),
    left_m_s=np.array([0.85, 0.56]),
    right_m_s=np.array([1.15, 0.44]),
    left_wheel_rad=np.array([0.0, pi]),
    right_wheel_rad=np.array([pi / 2, 0.0]),
    temperature_c=np.array([25.0, 15.0]),
    still_c=20.0,
    tread_m=0.6,
    wheel_radius_m=0.1,
    end_s=400.0,
)
STRETCH: dict[str, float | str] = {"t0": 50.0, "t1": 150.0}
# (effect, parameters in the catalogue's units, errors at the two moments in rad/s (deg/s: DEG) and m/s)
DEG = RAD_PER_DEG
BY_HAND: list[tuple[str, dict[str, float | str], dict[str, tuple[float, float]]]] = [
    ("gyro_scale_error", {"k": 0.01}, {"gyro": (0.005, -0.002)}),
    (
        "gyro_scale_nonlinearity",
        {"a2": 1.0, "a3": 2.0, "largest_rate": 0.5 * DEG_PER_RAD},  # u is 1 and -0.4
        {"gyro": (3.0 * DEG, 0.032 * DEG)},
    ),
    ("gyro_scale_asymmetry", {"k": 0.01}, {"gyro": (0.005, 0.002)}),
    ("gyro_bias_temperature", {"b1": 0.002, "b2": 0.0001}, {"gyro": (0.0125 * DEG, -0.0075 * DEG)}),
    ("gyro_scale_temperature", {"k": 0.001, "T0": 10.0}, {"gyro": (0.0075, -0.001)}),
    ("gyro_warmup", {"b": 0.1, "tau": 100.0}, {"gyro": (0.036787944 * DEG, 0.013533528 * DEG)}),
    ("gyro_bias_step", {"b": 0.3, "t0": 150.0}, {"gyro": (0.0, 0.3 * DEG)}),
    ("gyro_deadband", {"band": 20.0}, {"gyro": (0.0, 0.2)}),
    ("gyro_saturation", {"limit": 20.0}, {"gyro": (0.349065850 - 0.5, 0.0)}),
    ("gyro_heading_dependent_bias", {"b": 0.1, "phase": pi / 2}, {"gyro": (0.0, 0.1 * DEG)}),
    ("gyro_vibration_bias", {"k": 0.02}, {"gyro": (0.02 * DEG, 0.005 * DEG)}),
    ("wheel_radius_error", {"left": 0.01, "right": -0.02}, {"left": (-0.0085, -0.0056), "right": (0.023, 0.0088)}),
    ("tread_error", {"k": 0.1}, {"left": (-0.015, 0.006), "right": (0.015, -0.006)}),
    # 0.5 rad/s of 1.5, 0.2 of 0.7.
    ("turn_scrub", {"k": 0.2}, {"left": (-0.01, 0.0034285714), "right": (0.01, -0.0034285714)}),
    ("slip_acceleration", {"k": 0.05}, {"left": (0.017, -0.028), "right": (0.023, -0.022)}),
    ("surface_slip", {**STRETCH, "left": 0.1, "right": 0.2}, {"left": (0.085, 0.0), "right": (0.23, 0.0)}),
    ("tyre_deflation", {"side": "right", "total": 0.04}, {"right": (0.0115, 0.0088)}),
    ("wheel_radius_speed", {"k": 0.02}, {"left": (-0.017, -0.0028), "right": (-0.023, -0.0022)}),
    ("wheel_eccentricity", {"side": "left", "e": 0.1, "phase": 0.0}, {"left": (0.085, -0.056)}),
    ("wheel_eccentricity", {"side": "right", "e": 0.1, "phase": 3 * pi / 2}, {"right": (0.115, 0.0)}),
    ("encoder_missed_counts", {"side": "right", "fraction": 0.1, "speed": 0.5}, {"right": (-0.115, 0.0)}),
    ("bump_counts", {"travel_per_m": 0.01}, {"left": (0.0085, 0.0056), "right": (0.0115, 0.0044)}),
    ("encoder_dropout", {**STRETCH, "side": "left"}, {"left": (-0.85, 0.0)}),
    # 2 % of 1 m/s ahead, 10 % of 0.15 m/s across.
    ("terrain_tread", {**STRETCH, "tread": 0.1, "gain": 0.02}, {"left": (0.005, 0.0), "right": (0.035, 0.0)}),
    ("lateral_slip_turning", {"k": 0.1}, {"lateral": (-0.05, 0.01)}),
    ("rotation_centre_offset", {"a": 0.2}, {"lateral": (0.1, -0.04)}),
]
# Those of no linear parameter, when they do nothing.
NOTHING: dict[str, dict[str, float | str]] = {
    "gyro_lag": {"tau": 0.0},
    "gyro_latency": {"delay": 0.0},
    "gyro_deadband": {"band": 0.0},
    "gyro_saturation": {"limit": 720.0},
    "gyro_sample_clock": {"ratio": 1.0},
    "encoder_lag": {"tau": 0.0},
    "encoder_latency": {"delay": 0.0},
    "encoder_clock_skew": {"ppm": 0.0},
    "encoder_dropout": {"side": "left", "t0": 20.0, "t1": 20.0},
}
WITH_MEMORY = {"gyro_bias_temperature_rate"} | {e.id for e in EFFECTS.values() if e.acts_on is ActsOn.TIMING}


def channels(errors: Errors, m: Motion) -> Array:
    """As an array of shape (4, n)."""
    return np.array([np.broadcast_to(e, m.time_s.shape) for e in errors])


@pytest.mark.parametrize(("name", "values", "expected"), BY_HAND, ids=[name for name, _, _ in BY_HAND])
def test_the_formula_gives_what_was_computed_by_hand(
    name: str, values: dict[str, float | str], expected: dict[str, tuple[float, float]]
) -> None:
    found = channels(EFFECTS[name].error(TWO, in_si(EFFECTS[name], values)), TWO)
    wanted = [expected.get(channel, (0.0, 0.0)) for channel in ("gyro", "left", "right", "lateral")]
    np.testing.assert_allclose(found, wanted, rtol=1e-7, atol=1e-12)


def test_all_formulas_are_tested_at_values_by_hand_or_on_a_steady_change() -> None:
    assert {name for name, _, _ in BY_HAND} | WITH_MEMORY == set(EFFECTS)


# ---- effects with memory: all rates and speeds grow steadily ---------------------------------------------------


def steady() -> Motion:
    time_s = np.arange(1, 1201) / 20.0
    return driven(time_s, 0.1 * time_s, 0.02 * time_s, 20.0 + 0.05 * time_s)


@pytest.mark.parametrize(
    ("name", "values", "gyro_late_s", "wheels_late_s"),
    [
        ("gyro_latency", {"delay": 0.2}, 0.2, 0.0),
        ("gyro_lag", {"tau": 0.2}, 0.2, 0.0),
        ("gyro_sample_clock", {"ratio": 1.01}, 0.2970297, 0.0),  # at 30 s: 30 - 30/1.01
        ("encoder_lag", {"tau": 0.2}, 0.0, 0.2),
        ("encoder_latency", {"delay": 0.2}, 0.0, 0.2),
        ("encoder_clock_skew", {"ppm": -1000.0}, 0.0, 0.03),  # at 30 s
    ],
)
def test_what_is_late_reads_less_while_the_rate_grows(
    name: str, values: dict[str, float | str], gyro_late_s: float, wheels_late_s: float
) -> None:
    m, effect = steady(), EFFECTS[name]
    p, at = in_si(effect, values), 599  # 30 s
    found = channels(effect.error(m, p), m)[:, at]
    slopes = np.array([0.02, 0.1 - 0.5 * TREAD_M * 0.02, 0.1 + 0.5 * TREAD_M * 0.02, 0.0])
    wanted = -slopes * [gyro_late_s, wheels_late_s, wheels_late_s, 0.0]
    if name == "encoder_clock_skew":  # counts that are stamped 0.1 % too slowly come 0.1 % faster, and reverse
        wanted = wanted * 0.999 - 0.001 * 30.0 * slopes * [0.0, 1.0, 1.0, 0.0]
    np.testing.assert_allclose(found, wanted, rtol=1e-6, atol=1e-12)
    assert effect.delays(30.0, p) == pytest.approx((gyro_late_s, wheels_late_s), rel=1e-6)
    assert effect.correction(m, p) == Errors()  # the stamps are corrected instead


def test_the_shupe_effect_of_a_steady_rise_is_its_rate() -> None:
    m, effect = steady(), EFFECTS["gyro_bias_temperature_rate"]
    found = channels(effect.error(m, in_si(effect, {"b": 2.0, "coil_lag_s": 4.0})), m)[0]
    assert found[0] == 0.0
    assert found[-1] == pytest.approx(0.1 * DEG, rel=1e-5)  # 2 deg/s per degC/s at 0.05 degC/s
    assert found[80] == pytest.approx(0.1 * DEG * (1.0 - np.exp(-1.0)), rel=1e-6)  # after one time constant


def test_a_clock_s_error_leaves_the_travel_of_the_whole_way() -> None:
    m, effect = motion(seconds=600.0), EFFECTS["encoder_clock_skew"]
    late = effect.error(m, {"ppm": -1e-3})
    step_s, n = m.time_s[1] - m.time_s[0], len(m.time_s)
    read_m = np.cumsum(m.left_m_s + late.left_m_s) * step_s
    true_m = np.interp(m.time_s * (1.0 - 1e-3), m.time_s, np.cumsum(m.left_m_s) * step_s)
    assert np.max(np.abs(read_m - true_m)[n // 2 :]) < 1e-3  # without, 0.6 m


# ---- what all have in common -------------------------------------------------------------------------------------


def some_values(effect: Effect, m: Motion, rng: np.random.Generator) -> dict[str, float | str]:
    """Any variant, with any linear values in the plausible range."""
    variants = effect.variants(m)
    values = dict(variants[rng.integers(len(variants))])
    for q in effect.parameters:
        if q.name in effect.linear():
            size = np.exp(rng.uniform(np.log(q.low), np.log(q.high))) * q.si
            values[q.name] = float(size * (rng.choice([-1.0, 1.0]) if q.signed else 1.0))
    return values


@EVERY
@settings(deadline=None, max_examples=10)
@given(seed=st.integers(0, 2**32 - 1), scale=st.floats(-3.0, 3.0))
def test_linear_parameters_are_linear(effect: Effect, seed: int, scale: float) -> None:
    rng, m = np.random.default_rng(seed), motion(10.0, 30.0, seed)
    one = some_values(effect, m, rng)
    two = one | {name: some_values(effect, m, rng)[name] for name in effect.linear()}
    both = one | {name: scale * float(one[name]) + float(two[name]) for name in effect.linear()}
    if effect.linear():
        e_one, e_two, e_both = (channels(effect.error(m, p), m) for p in (one, two, both))
        largest = np.max(np.abs([scale * e_one, e_two]))
        np.testing.assert_allclose(e_both, scale * e_one + e_two, rtol=0.0, atol=1e-12 * largest + 1e-300)
    else:
        assert effect.id in NOTHING


@EVERY
def test_nothing_is_added_at_zero(effect: Effect) -> None:
    m = motion()
    p = NOTHING.get(effect.id) or {**effect.variants(m)[0], **dict.fromkeys(effect.linear(), 0.0)}
    np.testing.assert_allclose(channels(effect.error(m, in_si(effect, p)), m), 0.0, atol=1e-12)
    assert effect.delays(100.0, p) == (0.0, 0.0)


@EVERY
@settings(deadline=None, max_examples=10)
@given(seed=st.integers(0, 2**32 - 1))
def test_one_sample_alone_gives_the_same(effect: Effect, seed: int) -> None:
    rng, m = np.random.default_rng(seed), motion(10.0, 30.0, seed)
    p, i = some_values(effect, m, rng), int(rng.integers(len(m.time_s)))
    arrays = {f.name: getattr(m, f.name)[i : i + 1] for f in fields(m) if isinstance(getattr(m, f.name), np.ndarray)}
    alone = replace(m, **arrays)
    for method in (effect.error, effect.correction):
        found = channels(method(alone, p), alone)
        assert np.all(np.isfinite(found))
        if effect.id not in WITH_MEMORY:
            np.testing.assert_allclose(found[:, 0], channels(method(m, p), m)[:, i], rtol=1e-12, atol=1e-15)


@EVERY
def test_an_effect_does_not_write_to_the_motion(effect: Effect) -> None:
    m, same = motion(), motion()
    for variant in effect.variants(m):
        effect.error(m, variant | dict.fromkeys(effect.linear(), 0.01))
    effect.other_shapes(m)
    assert all(np.array_equal(getattr(m, f.name), getattr(same, f.name)) for f in fields(m))


def test_an_unknown_temperature_adds_nothing() -> None:
    m = motion()
    m.temperature_c[:] = np.nan
    m.still_c = float("nan")
    for name in ("gyro_bias_temperature", "gyro_bias_temperature_rate", "gyro_scale_temperature"):
        effect = EFFECTS[name]
        found = channels(effect.error(m, effect.variants(m)[0] | dict.fromkeys(effect.linear(), 0.01)), m)
        assert np.all(found == 0.0)


# ---- signs -------------------------------------------------------------------------------------------------------


def test_signs_are_those_of_rep_103() -> None:
    ones = np.ones(3)
    m = driven(np.arange(1.0, 4.0), ones, 0.5 * ones, 20.0 * ones)  # ahead, to the left

    def sign(name: str, **values: float | str) -> list[float]:
        return [float(x) for x in np.sign(channels(EFFECTS[name].error(m, values), m)[:, 1])]

    assert sign("gyro_scale_error", k=0.1) == [1.0, 0.0, 0.0, 0.0]
    assert sign("bump_counts", travel_per_m=0.1) == [0.0, 1.0, 1.0, 0.0]
    assert sign("wheel_radius_error", left=0.1, right=-0.1) == [0.0, -1.0, 1.0, 0.0]  # of a larger wheel too few turns
    assert sign("tyre_deflation", side="left", total=0.1) == [0.0, 1.0, 0.0, 0.0]  # of a smaller one too many
    assert sign("tread_error", k=0.1) == [0.0, -1.0, 1.0, 0.0]  # wheels further apart travel further for a turn
    assert sign("lateral_slip_turning", k=0.1) == [0.0, 0.0, 0.0, -1.0]  # outward is to the right
    assert sign("rotation_centre_offset", a=0.1) == [0.0, 0.0, 0.0, 1.0]  # the nose goes to the left


def test_backwards_too_drive_slips_ahead_of_the_ground_and_bumps_add() -> None:
    time_s = np.arange(1.0, 4.0)
    m = driven(time_s, -0.1 * time_s, 0.0 * time_s, 20.0 + 0.0 * time_s)  # faster and faster backwards
    for name, values in (("slip_acceleration", {"k": 0.1}), ("bump_counts", {"travel_per_m": 0.1})):
        assert np.all(channels(EFFECTS[name].error(m, values), m)[1:3] < 0.0)


# ---- corrections that are not the error itself ---------------------------------------------------------------------


@pytest.mark.parametrize("side", ["left", "right"])
def test_a_counter_that_stands_still_is_replaced_by_the_other_one_and_the_gyro(side: str) -> None:
    m, effect = motion(), EFFECTS["encoder_dropout"]
    p: dict[str, float | str] = {"side": side, "t0": 30.0, "t1": 40.0}
    error = effect.error(m, p)
    reading = replace(m, left_m_s=m.left_m_s + error.left_m_s, right_m_s=m.right_m_s + error.right_m_s)
    assert not np.array_equal(channels(error, m), np.zeros((4, len(m.time_s))))
    np.testing.assert_allclose(channels(effect.correction(reading, p), m), channels(error, m), atol=1e-12)


@pytest.mark.parametrize("side", ["left", "right"])
def test_counts_are_missed_where_the_other_wheel_and_the_gyro_say_so(side: str) -> None:
    m, effect = motion(), EFFECTS["encoder_missed_counts"]
    p: dict[str, float | str] = {"side": side, "fraction": 0.2, "speed": 0.6}
    error = channels(effect.error(m, p), m)
    found, reading = np.zeros_like(error), m
    for _ in range(20):  # as the compensation iterates; what is lost is a fifth, so it converges
        reading = replace(m, left_m_s=(m.left_m_s + error[1]) - found[1], right_m_s=(m.right_m_s + error[2]) - found[2])
        found = channels(effect.correction(reading, p), m)
    np.testing.assert_allclose(found, error, atol=1e-9)


@EVERY
def test_other_corrections_are_the_error_or_nothing(effect: Effect) -> None:
    m = motion()
    p = some_values(effect, m, np.random.default_rng(5))
    found, error = channels(effect.correction(m, p), m), channels(effect.error(m, p), m)
    if effect.acts_on is ActsOn.TIMING or effect.remainder >= 1.0:
        assert np.all(found == 0.0)
    else:
        np.testing.assert_allclose(found, error, atol=1e-12)


# ---- other shapes ------------------------------------------------------------------------------------------------


@EVERY
def test_other_shapes_are_few_and_differ_from_the_form_and_from_each_other(effect: Effect) -> None:
    m = motion(5.0, 900.0)
    variants = effect.variants(m)
    for variant in (variants[0], variants[len(variants) // 2], variants[-1]):
        p = variant | dict.fromkeys(effect.linear(), 0.01)
        shapes = [channels(e, m).ravel() for e in effect.other_shapes(m, p)]
        assert len(shapes) <= 4
        assert shapes or effect.id == "encoder_dropout"  # an event of logic: it has no form
        form = channels(effect.error(m, p), m).ravel()
        unit = [x / max(float(np.linalg.norm(x)), 1e-300) for x in (form, *shapes)]
        assert all(np.all(np.isfinite(x)) for x in unit)
        gram = np.abs(np.array(unit) @ np.array(unit).T)
        assert np.max(np.triu(gram, 1)) < 0.9999, variant


@EVERY
def test_other_shapes_are_by_default_those_of_the_middle_variant(effect: Effect) -> None:
    m = motion()
    variants = effect.variants(m)
    default, middle = effect.other_shapes(m), effect.other_shapes(m, variants[len(variants) // 2])
    assert len(default) == len(middle)
    for a, b in zip(default, middle, strict=True):
        assert np.array_equal(channels(a, m), channels(b, m))


@pytest.mark.parametrize("effect", [e for e in EFFECTS.values() if e.proportional], ids=lambda effect: effect.id)
@given(seed=st.integers(0, 2**32 - 1), scale=st.floats(-3.0, 3.0))
def test_what_is_proportional_holds_at_any_speed_and_for_turns_either_way(
    effect: Effect, seed: int, scale: float
) -> None:
    rng, m = np.random.default_rng(seed), motion(10.0, 30.0, seed)
    speeds = ("rate_rad_s", "speed_m_s", "left_m_s", "right_m_s")
    scaled = replace(m, **{name: scale * getattr(m, name) for name in speeds})
    p = some_values(effect, m, rng)
    found, wanted = channels(effect.error(scaled, p), m), scale * channels(effect.error(m, p), m)
    np.testing.assert_allclose(found, wanted, rtol=0.0, atol=1e-12 * np.max(np.abs(wanted)) + 1e-300)
