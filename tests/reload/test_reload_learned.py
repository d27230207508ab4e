"""What was learned while the configuration said otherwise: a reload keeps only what still applies."""

import math
from collections.abc import Iterator
from pathlib import Path

import pytest
from sensors import ROBOT, T0, S, Sample, drive, feed

from drd.config.keys import Config
from drd.config.schema import loads
from drd.estimation.learning import Drive
from drd.estimation.state import SCALE_L, SLIP, TREAD, WHEEL_LAG
from drd.pipeline import Pipeline
from drd.samples import GyroSample, WheelSample

DIFFERENTIAL = ROBOT.replace("0.5}", "0.5, drive: differential}")
REST = "estimation: {static_bias: {duration_s: 0}}\nencoders: {counts_per_revolution: 20000}\n"
LAG_S = 0.15
WHEELS = f"encoders: {{counts_per_revolution: 20000, latency_s: {LAG_S}}}\n"
TURNING_S = 41.2  # of the slalom, 0.4 rad/s
P99 = 2.576


def pipeline(text: str) -> Pipeline:
    return Pipeline(loads(text, Config).value, Path(), lambda *_: None)


def with_lines(lines: str) -> str:
    return DIFFERENTIAL + (REST.split("encoders", maxsplit=1)[0] if "encoders" in lines else REST) + lines


def late(start_s: float, end_s: float, wheels_s: float, gyro_s: float) -> Iterator[tuple[float, Sample]]:
    """The slalom's samples with stamps that are so late."""
    for t_s, sample in drive(end_s):
        if t_s > start_s:
            by_ns = round((gyro_s if isinstance(sample, GyroSample) else wheels_s) * S)
            yield t_s, sample._replace(t_ns=sample.t_ns + by_ns)


@pytest.mark.parametrize(
    ("then", "now", "late_then", "late_now"),
    [
        ("", WHEELS, (LAG_S, 0.0), (0.0, 0.0)),
        (WHEELS, "", (0.0, 0.0), (LAG_S, 0.0)),
        ("", "fog: {latency_s: 0.08}\n", (0.0, 0.08), (0.0, 0.0)),
    ],
    ids=["of the wheels, stated", "of the wheels, taken back", "of the gyro"],
)
def test_a_latency_is_not_corrected_twice(
    then: str, now: str, late_then: tuple[float, float], late_now: tuple[float, float]
) -> None:
    made = pipeline(with_lines(then))
    feed(made.estimator, late(0.0, TURNING_S, *late_then))
    kf = made.estimator.filter
    assert kf.nominal.wheel_lag_s == pytest.approx(late_then[0] - late_then[1], abs=0.01)
    assert kf.sigma(WHEEL_LAG) < 0.02
    (text,) = made.reload(T0 + round(TURNING_S * S), pipeline(with_lines(now)), {})
    assert text.startswith("the wheels' lag is learned again, since ")
    kf = made.estimator.filter
    assert kf.sigma(WHEEL_LAG) == pytest.approx(0.2, rel=0.01)
    poses = feed(made.estimator, late(TURNING_S, 90.0, *late_now))
    for pose in poses[10:]:
        heading_rad = 0.5 * (1.0 - math.cos(0.8 * (pose.t_ns - T0) / S))
        assert abs(pose.heading_rad - heading_rad) < P99 * math.sqrt(pose.covariance[5])
    assert kf.nominal.wheel_lag_s == pytest.approx(late_now[0], abs=P99 * kf.sigma(WHEEL_LAG))


@pytest.mark.parametrize("then", ["auto", "differential"])
def test_a_robot_that_is_said_to_skid_is_as_unsure_as_at_a_cold_start(then: str) -> None:
    made = pipeline(DIFFERENTIAL.replace("differential", then) + REST)
    feed(made.estimator, drive(60.0))
    assert made.estimator.knowledge.steering.drive is Drive.DIFFERENTIAL
    (text,) = made.reload(T0 + 60 * S, pipeline(DIFFERENTIAL.replace("differential", "skid") + REST), {})
    assert text == f"wheel scales and tread are learned again, since robot.drive changed from {then} to skid"
    kf = made.estimator.filter
    assert [kf.sigma(state) for state in (SCALE_L, TREAD, SLIP)] == pytest.approx([0.04, 0.25, 0.25])


def straight(start_s: float, end_s: float) -> Iterator[tuple[float, Sample]]:
    """Perfect sensors at 1 m/s, which do not tell how the robot steers."""
    for k in range(round(start_s * 20) + 1, round(end_s * 20) + 1):
        t_ns = T0 + k * S // 20
        yield k / 20, GyroSample(t_ns, 0.05, 0.0, math.nan)
        yield k / 20, WheelSample(t_ns, 0.05, 0.05, 0.05, 0.0)


@pytest.mark.parametrize("now", ["0.5, drive: differential", "0.51, drive: differential", "0.51"])
def test_what_is_said_of_the_wheels_does_not_make_the_path_so_far_better(now: str) -> None:
    made = pipeline(ROBOT + REST)
    before = feed(made.estimator, straight(0.0, 60.0))[-1]
    made.reload(T0 + 60 * S, pipeline(ROBOT.replace("0.5}", now + "}") + REST), {})
    after = feed(made.estimator, straight(60.0, 60.2))[-1]
    assert before.position_bound_m == pytest.approx(7.3, abs=0.1)  # 0.04 of 60 m
    assert after.position_bound_m == pytest.approx(before.position_bound_m, rel=0.01)


def test_the_slip_of_a_robot_that_is_said_not_to_slip_is_forgotten() -> None:
    made = pipeline(DIFFERENTIAL.replace("differential", "skid") + REST)
    feed(made.estimator, drive(60.0))
    made.estimator.filter.nominal.slip_s = -0.2  # as lawn does
    made.reload(T0 + 60 * S, pipeline(DIFFERENTIAL + REST), {})
    assert (made.estimator.filter.nominal.slip_s, made.estimator.filter.sigma(SLIP)) == (0.0, 0.0)


def test_a_gyro_that_is_added_finds_out_how_the_robot_steers_and_leaves_it_known() -> None:
    made = pipeline(ROBOT + REST + "fog: {protocol: none}")
    feed(made.estimator, ((t, s) for t, s in drive(20.0, tread_m=0.75) if not isinstance(s, GyroSample)))
    with_gyro = pipeline(ROBOT + REST)
    cold = with_gyro.estimator.sigmas
    assert len(made.reload(T0 + 20 * S, with_gyro, {})) == 3
    kf = made.estimator.filter
    assert [kf.sigma(TREAD), kf.sigma(WHEEL_LAG)] == pytest.approx([cold.tread_m, cold.wheel_lag_s], rel=0.01)
    assert made.estimator.knowledge.steering.drive.value == "unknown"
    feed(made.estimator, drive(40.0, tread_m=0.75, start_s=5 * math.pi / 0.4))
    assert made.estimator.knowledge.steering.drive is Drive.SKID
    tread_m, sigma_m = made.estimator.filter.nominal.tread_m, made.estimator.filter.sigma(TREAD)
    assert tread_m == pytest.approx(0.75, abs=P99 * sigma_m)
    (text,) = made.reload(T0 + 80 * S, pipeline(ROBOT + REST + "fog: {protocol: none}"), {})
    assert text.startswith("the gyro's bias")
    assert made.estimator.knowledge.steering.drive is Drive.SKID
    assert made.estimator.filter.nominal.tread_m == tread_m
