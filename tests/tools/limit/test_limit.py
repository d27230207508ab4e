"""The bound against closed forms, a dense Gaussian and the errors of a filter that knows all; and in the commands."""

import html
import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from replay_folders import STANDING, write_perfect

from drd.arrays import Array
from drd.batch.logs import EncoderLog
from drd.cli import main
from drd.estimation.filter import Filter
from drd.estimation.noise import NoiseProfile
from drd.estimation.state import GYRO_BIAS, GYRO_HEADING, HEADING, N, Sigmas, X, Y
from drd.units import RAD_PER_DEG
from drd.units import RAD_PER_SQRT_S_PER_DEG_PER_SQRT_H as PER_SQRT_H
from drd_tools.evaluate.results import Evaluation
from drd_tools.limit.causes import CAUSES
from drd_tools.limit.drive import Block, Drive, blocks_of, replayed_drive
from drd_tools.limit.known import FINEST_RAD2, Known, known_of, slip_factor
from drd_tools.limit.limit import Limit, limit_of, limit_on, start_covariance
from drd_tools.limit.recursion import Case, ErrorModel, spreads, standing
from drd_tools.recordings.folder import Recording, ReferenceLog
from drd_tools.replay.nominal import configuration
from drd_tools.simulate.missions import make_drive
from drd_tools.simulate.robot import DEFAULT
from drd_tools.simulate.simulator import simulate
from drd_tools.simulate.truth import make_truth

N_01 = 0.1 * PER_SQRT_H  # the table's gyro
TREAD_M = 0.5
DEAF = 1e9  # variance of comparisons that say nothing
PERFECT = Sigmas(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


def straight(speed_m_s: float, distance_m: float = 1000.0, step_s: float = 1.0) -> Drive:
    step_m = speed_m_s * step_s
    blocks = [Block(step_s, step_m, step_m, 0.0)] * round(distance_m / step_m)
    return Drive(blocks, TREAD_M, 10.0, NoiseProfile(comparison_rad2=DEAF), 0.0)


def mean_over_lengths(limit: Limit) -> float:
    return float(np.mean(limit.by_length_percent))


@pytest.mark.parametrize(("speed_m_s", "percent"), [(1.0, 0.034), (10.0, 0.011)])
def test_angle_random_walk_alone_is_that_of_the_closed_form(speed_m_s: float, percent: float) -> None:
    """N sqrt(L / (3 v)) of the way, (64); the table's figure is its mean over 100 to 800 m."""
    noise = NoiseProfile(gyro_rad2_per_s=N_01**2, comparison_rad2=DEAF)
    limit = limit_on(straight(speed_m_s, step_s=1.0 / speed_m_s), Known(noise, PERFECT, ""))
    lengths_m = np.arange(100.0, 801.0, 100.0)
    expected = 100.0 * N_01 * np.sqrt(lengths_m / (3.0 * speed_m_s))
    assert limit.by_length_percent == pytest.approx(expected, rel=0.01)
    assert mean_over_lengths(limit) == pytest.approx(percent, abs=0.0006)


@pytest.mark.parametrize(
    ("speed_m_s", "rest_s", "percent"),
    [(1.0, 10.0, 0.207), (1.0, 120.0, 0.060), (1.0, 600.0, 0.027), (10.0, 10.0, 0.021), (10.0, 120.0, 0.006)],
)
def test_a_bias_from_rest_is_that_of_the_closed_form(speed_m_s: float, rest_s: float, percent: float) -> None:
    """b L / (2 v) of the way with b = N / sqrt(T), (28), (64)."""
    known = Known(NoiseProfile(comparison_rad2=DEAF), replace(PERFECT, gyro_bias_rad_s=N_01 / math.sqrt(rest_s)), "")
    limit = limit_on(straight(speed_m_s, step_s=1.0 / speed_m_s), known)
    assert mean_over_lengths(limit) == pytest.approx(percent, abs=0.0006)


def test_longer_standing_is_the_advice_where_the_bias_is_most() -> None:
    """10 s of rest, then straight on: the bias of 10 s is 0.21 % of the way, that of 70 s 1 / sqrt(7) of it."""
    rest = [Block(1.0, 0.0, 0.0, 0.0)] * 10
    noise = NoiseProfile(gyro_rad2_per_s=N_01**2, wheel_m2_per_m=1e-12, turn_rad2_per_s=0.0, comparison_rad2=1e-12)
    # Wheels whose way is exact and whose difference says nothing: a tread of a thousandth of a millimetre.
    drive = replace(straight(1.0), tread_m=1e-6)
    drive = replace(drive, blocks=[*rest, *drive.blocks])
    limit = limit_on(drive, Known(noise, replace(PERFECT, gyro_bias_rad_s=0.02 * RAD_PER_DEG), ""))
    lengths_m = np.arange(100.0, 801.0, 100.0)

    def percent(rest_s: float) -> Array:
        variance = lengths_m / 3.0 + lengths_m**2 / (4.0 * rest_s)
        result: Array = 100.0 * N_01 * np.sqrt(variance)
        return result

    assert limit.by_length_percent == pytest.approx(percent(10.0), rel=0.02)
    assert limit.changes[0].what == "60 s more standing before the start"
    assert limit.advice.startswith("60 s more standing before the start would lower it most: the drift from 0.1")
    ratio = limit.changes[0].drift_percent / limit.drift_percent
    assert percent(70.0)[-1] / percent(10.0)[-1] < ratio < percent(70.0)[0] / percent(10.0)[0]


def test_standing_brings_the_bias_to_the_random_walk_over_the_root_of_time() -> None:
    noise = NoiseProfile(gyro_rad2_per_s=N_01**2, comparison_rad2=FINEST_RAD2)
    sigmas = replace(PERFECT, gyro_bias_rad_s=1.0, heading_rad=0.3)
    case = Case(np.ones(len(CAUSES)), start_covariance(sigmas))
    model = ErrorModel(straight(1.0), noise, sigmas)
    P = standing(model, case, 10.0, 60)
    assert math.sqrt(P[GYRO_BIAS, GYRO_BIAS]) == pytest.approx(N_01 / math.sqrt(60.0), rel=1e-3)
    assert P[HEADING, GYRO_HEADING] == P[HEADING, HEADING] == pytest.approx(0.09)
    assert not P[GYRO_BIAS, [X, Y, HEADING, GYRO_HEADING]].any()


NOISE = NoiseProfile(
    wheel_m2_per_m=0.002**2,
    turn_rad2_per_rad=0.01**2,
    lateral_m2_per_m=0.001**2,
    gyro_rad2_per_s=(0.5 * PER_SQRT_H) ** 2,
    gyro_bias_rad2_s2_per_s=1e-12,
    comparison_rad2=1e-6,
)
SIGMAS = Sigmas(0.0, 0.0, 0.003, 0.01, 0.004, 3e-4)


def winding(count: int, step_s: float = 0.2) -> Drive:
    """A rest, then a winding way."""
    blocks = [Block(step_s, 0.0, 0.0, 0.0)] * (count // 4)
    for k in range(count - len(blocks)):
        turn = 0.08 * math.sin(0.3 * k)
        way, half = 0.8 * step_s, 0.5 * TREAD_M * turn
        blocks.append(Block(step_s, way - half, way + half, turn))
    return Drive(blocks, TREAD_M, 1.0 / step_s, NOISE, 0.0)


def test_cases_and_shares_are_those_of_a_dense_gaussian() -> None:
    """All sources in one large Gaussian, conditioned on all comparisons at once."""
    drive = winding(16)
    model = ErrorModel(drive, NOISE, SIGMAS)
    case = Case(np.ones(len(CAUSES)), start_covariance(SIGMAS))
    found, _ = spreads(model, drive, [case], [])
    model = ErrorModel(drive, NOISE, SIGMAS)
    root = np.sqrt(start_covariance(SIGMAS))
    columns, rows = [root], []
    x = np.hstack([root])
    H = np.zeros(N)
    H[HEADING], H[GYRO_HEADING] = 1.0, -1.0
    for block in drive.blocks:
        model.step(block)
        values, vectors = np.linalg.eigh(model.Q_causes.sum(axis=0))
        Q_root = vectors * np.sqrt(np.maximum(values, 0.0))
        x = np.hstack([model._F @ x, Q_root])
        columns.append(Q_root)
        rows.append((H @ x, float(model.comparison(block).sum())))
    Z = np.array([np.pad(z, (0, x.shape[1] - len(z))) for z, _ in rows])
    S = Z @ Z.T + np.diag([R for _, R in rows])
    pose = x[[X, Y, GYRO_HEADING]]
    expected = pose @ pose.T - pose @ Z.T @ np.linalg.solve(S, Z @ pose.T)
    np.testing.assert_allclose(found.end[0], expected, rtol=1e-6, atol=1e-16)


def test_a_filter_that_knows_the_noise_reaches_the_bound() -> None:
    """Over 60 drives the filter's errors at the end spread as the bound says."""
    drive, random = winding(400, 0.1), np.random.default_rng(3)
    sigmas = replace(SIGMAS, wheel_scale=0.0, tread_m=0.0, gyro_scale=0.0)
    limit = limit_on(drive, Known(NOISE, sigmas, ""))
    errors = []
    for _ in range(60):
        kf = Filter(TREAD_M, sigmas, NOISE, gate_sigma=100.0)
        bias = sigmas.gyro_bias_rad_s * random.normal()
        x = y = heading = 0.0
        for b in drive.blocks:
            way, middle = 0.5 * (b.left_m + b.right_m), heading + 0.5 * b.turn_rad
            side = math.sqrt(NOISE.lateral_m2_per_m * way) * random.normal()
            x += way * math.cos(middle) - side * math.sin(middle)
            y += way * math.sin(middle) + side * math.cos(middle)
            heading += b.turn_rad
            skid = 0.5 * TREAD_M * math.sqrt(NOISE.turn_rad2_per_rad * abs(b.turn_rad)) * random.normal()
            left, right = (
                travel + sign * skid + math.sqrt(NOISE.wheel_m2_per_m * abs(travel)) * random.normal()
                for travel, sign in ((b.left_m, -1.0), (b.right_m, 1.0))
            )
            white = math.sqrt(NOISE.gyro_rad2_per_s / b.dt_s) * random.normal()
            bias += math.sqrt(NOISE.gyro_bias_rad2_s2_per_s * b.dt_s) * random.normal()
            kf.predict(b.dt_s, left, right, b.turn_rad / b.dt_s + white + bias)
            kf.update(b.turn_rad / b.dt_s)
        n = kf.nominal
        errors.append(((n.x_m - x) ** 2 + (n.y_m - y) ** 2, (kf.heading_rad - heading) ** 2))
    place, turn = np.mean(errors, axis=0)
    # The standard deviation of a mean of 60 squares is sqrt(2/60) = 0.18 of it: 3 below and 4 above.
    assert 0.45 < turn / (limit.end_deg * RAD_PER_DEG) ** 2 < 1.75
    assert 0.45 < place / limit.end_m**2 < 1.75


def test_blocks_add_up_and_hold_either_rest_or_motion() -> None:
    still, slow = Block(0.05, 0.0, 0.0, 1e-3), Block(0.05, 0.02, 0.03, 0.02)
    blocks = blocks_of([still] * 30 + [slow] * 7 + [still])
    assert [block.is_rest for block in blocks] == [True, True, False, False, True]
    assert sum(b.dt_s for b in blocks) == pytest.approx(38 * 0.05)
    assert sum(b.right_m for b in blocks) == pytest.approx(7 * 0.03)
    assert sum(b.turn_rad for b in blocks) == pytest.approx(7 * 0.02)  # at rest the gyro's is none


def simulated(walk_deg_per_sqrt_h: float = 0.0833, seed: int = 1) -> Recording:
    nominal = replace(DEFAULT, gyro_angle_random_walk_deg_per_sqrt_h=walk_deg_per_sqrt_h)
    return simulate(make_truth(make_drive("warehouse", 120.0)), nominal, seed=seed).recording


def test_a_simulated_recording_has_the_noise_of_its_datasheets() -> None:
    recording = simulated()
    config = configuration(recording)
    known = known_of(recording, config, replayed_drive(recording, config))
    assert math.sqrt(known.noise.wheel_m2_per_m) == pytest.approx(0.002)
    # Its last digit, 0.004 deg/s at 10 Hz, is noise, too.
    last_digit = 60.0 * 0.004 / math.sqrt(12.0) * math.sqrt(0.1)  # deg/sqrt(h)
    assert math.sqrt(known.noise.gyro_rad2_per_s) / PER_SQRT_H == pytest.approx(math.hypot(0.0833, last_digit))
    assert known.noise.turn_rad2_per_rad == known.noise.lateral_m2_per_m == 0.0
    assert known.sigmas == replace(PERFECT, gyro_bias_rad_s=0.02 * RAD_PER_DEG)


def test_a_better_gyro_lowers_the_bound_as_foretold() -> None:
    worse = limit_of(simulated(1.0))
    better = limit_of(simulated(0.5))
    foretold = next(c for c in worse.changes if c.what == "a gyro with half the noise")
    assert better.drift_percent == pytest.approx(foretold.drift_percent, rel=0.02)
    assert better.drift_percent < 0.8 * worse.drift_percent
    whole = math.hypot(*(share.position_rms_m for share in worse.by_cause))
    assert whole == pytest.approx(worse.position_rms_m, rel=1e-6)
    assert math.hypot(*(share.end_deg for share in worse.by_cause)) == pytest.approx(worse.end_deg, rel=1e-6)


@pytest.mark.parametrize("factor", [0.25, 4.0])
def test_a_reference_shows_the_wheels_noise(factor: float) -> None:
    random, rows = np.random.default_rng(8), 4000
    way = np.full(rows, 0.05)
    turn = 0.02 * np.sin(0.01 * np.arange(rows))
    noise = NoiseProfile(wheel_m2_per_m=0.002**2, comparison_rad2=0.0)
    radius_m, tread_m = 0.1, 0.5
    sides = [
        1.003 * (way + sign * 0.5 * tread_m * turn)
        + math.sqrt(factor * noise.wheel_m2_per_m * 0.05) * random.normal(size=rows)
        for sign in (-1.0, 1.0)
    ]
    time_s: Array = np.linspace(0.0, 0.05 * (rows - 1), rows)
    left, right = (np.round(np.cumsum(side) / (2.0 * math.pi * radius_m) * 1e6) for side in sides)
    robot = replace(DEFAULT, wheel_radius_m=radius_m, counts_per_revolution=1e6, reference_heading_sigma_deg=0.0)
    zeros = np.zeros(rows)
    recording = Recording(
        Path("none"),
        robot,
        EncoderLog(time_s, left, right, None, None),
        None,
        ReferenceLog(time_s, zeros, zeros, np.cumsum(turn)),
        {},
    )
    found = slip_factor(recording, Drive([], tread_m, 0.0, noise, 0.0), noise)
    assert found == pytest.approx(factor, rel=0.5)  # 80 windows' median


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("limit") / "drive"
    return write_perfect(made, gyro=True, legs=(*STANDING[:5], (0.0, 0.0, 2.0)))


def test_evaluate_sets_the_bound_beside_the_errors(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    poses = tmp_path / "poses.csv"
    assert main(["replay", str(folder), "--output", str(poses)]) == 0
    (tmp_path / "reference.csv").write_bytes((folder / "reference.csv").read_bytes())
    for number, given in enumerate(([str(folder)], [str(poses), "--reference", str(tmp_path / "reference.csv")])):
        output = tmp_path / str(number)
        assert main(["evaluate", *given, "--output", str(output)]) == 0
        told = capsys.readouterr().out
        limit = Evaluation.load(output).runs[0].limit
        assert limit is not None
        assert limit.drift_percent > 0.0
        assert told.count("(limit ") == 5
        assert "Limit (smallest error that any estimator could achieve" in told
        assert limit.advice in told
        assert limit.advice in html.unescape((output / "report.html").read_text())
    poses.with_suffix(".json").unlink()
    assert main(["evaluate", *given, "--output", str(tmp_path / "2")]) == 0
    assert "limit" not in capsys.readouterr().out


def test_results_of_before_there_was_a_bound_are_read(folder: Path, tmp_path: Path) -> None:
    assert main(["evaluate", str(folder), "--output", str(tmp_path)]) == 0
    file = tmp_path / "results.json"
    content = json.loads(file.read_text())
    del content["runs"][0]["limit"]
    file.write_text(json.dumps(content))
    assert Evaluation.load(tmp_path).runs[0].limit is None


def test_explain_ends_with_the_bound(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["explain", str(folder), "--output", str(tmp_path)]) == 0
    told = capsys.readouterr().out
    limit = json.loads((tmp_path / "results.json").read_text())["limit"]
    assert limit["advice"] in told
    assert main(["explain", "--draw", str(tmp_path)]) == 0
    assert capsys.readouterr().out == told
    assert "Smallest error that any estimator could achieve here" in (tmp_path / "report.html").read_text()
