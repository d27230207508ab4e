"""`drd calibrate noise` as a user runs it."""

import gzip
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from gyro_noise_data import DEG_H, DEG_H_ROOT_H, DEG_ROOT_H, static_log, write_log

from drd.cli import main as drd
from drd.config.keys import Config, Noise
from drd.config.schema import loads
from drd.samples import GyroSample
from drd.units import NS_PER_S, RAD_PER_DEG
from drd_tools.calibrate.fog_recorder import Progress, RecordingError
from drd_tools.calibrate.noise import command as noise_command
from drd_tools.calibrate.noise.allan import N, Q, allan_curve, fit, shapes
from drd_tools.calibrate.noise.analysis import Origin, analyse, filter_noise
from drd_tools.calibrate.noise.command import Drift
from drd_tools.calibrate.noise.intervals import Interval
from drd_tools.calibrate.noise.static_log import StaticLog, motion, rounding_rad_s
from drd_tools.calibrate.noise.text import duration, sentences, snippet

ROBOT: dict[str, Any] = {
    "robot": {"wheel_radius_m": 0.11, "tread_m": 0.6},
    "estimation": {"gate_sigma": 4.0, "noise": {"timing_s": 0.001}},
}
CONFIG = """\
robot: {wheel_radius_m: 0.11, tread_m: 0.6}
fog: {protocol: ecore, port: /dev/null}
encoders: {layout: agilex}
"""
KVH = Path(__file__).resolve().parents[3].parent / "shared/recordings/raw/kvh1750"


def merged(text: str) -> Config:
    """A robot's configuration with the snippet in it, through drd's own loader."""
    made = yaml.safe_load(text)["estimation"]
    estimation = {**ROBOT["estimation"], "initial": made["initial"]}
    estimation["noise"] = {**estimation["noise"], **made["noise"]}
    return loads(yaml.safe_dump({**ROBOT, "estimation": estimation}), Config).value


def quick(log: StaticLog, skip_s: float | None = None) -> Any:
    return analyse(log, skip_s, simulations=60)


def test_a_log_becomes_a_configuration_pictures_and_a_page(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = write_log(tmp_path / "fog.csv", static_log(1200.0, 5.0))
    assert drd(["calibrate", "noise", str(log), "--output", str(tmp_path / "out")]) == 0
    said = capsys.readouterr().out
    assert "angle random walk" in said
    assert "Rate random walk is not visible in 20 min: at most" in said
    assert sorted(f.name for f in (tmp_path / "out").iterdir()) == [
        "allan.png",
        "noise.yaml",
        "report.html",
        "warmup.png",
    ]
    assert (tmp_path / "out/allan.png").read_bytes().startswith(b"\x89PNG")
    assert "data:image/png;base64" in (tmp_path / "out/report.html").read_text()
    text = (tmp_path / "out/noise.yaml").read_text()
    config = merged(text)
    assert config.estimation.noise.gyro_deg_per_sqrt_h == pytest.approx(0.083, rel=0.05)
    assert config.estimation.initial.gyro_bias_deg_s == pytest.approx(20 / 3600, rel=0.1)
    assert config.estimation.gate_sigma == 4.0
    assert loads(text + "robot: {wheel_radius_m: 0.1, tread_m: 0.5}\n", Config).value
    for provenance in ("sha256: ", "Made by `drd calibrate noise` of drd", "90 % interval", str(log)):
        assert provenance in text


def test_the_same_log_gives_the_same_numbers() -> None:
    first, second = (quick(static_log(600.0)) for _ in range(2))
    assert first.intervals == second.intervals
    assert first.filter == second.filter


def test_warm_up_is_left_out_and_the_wait_is_said() -> None:
    log = static_log(5400.0, 5.0, K=2 * DEG_H_ROOT_H)
    log.rate_rad_s[:] += 40 * DEG_H * np.exp(-log.time_s / 300.0)
    result = quick(log)
    assert 900.0 < result.left_out_s < 2700.0
    assert result.warm_up.time_constant_s == pytest.approx(300.0, rel=0.2)
    assert result.bias_rad_s / DEG_H == pytest.approx(20.0, abs=3.0)
    assert result.start_sigma_rad_s / DEG_H == pytest.approx(60.0, abs=8.0)
    text = " ".join(sentences(result))
    assert "were left out, as warm-up" in text
    assert f"Wait {duration(result.wait_s)} after the log's start" in text
    assert "at the log's start +0.01" in snippet(result)


def test_skip_takes_the_place_of_the_warm_up() -> None:
    result = quick(static_log(600.0), 120.0)
    assert result.left_out_s == pytest.approx(120.0)
    assert "as requested with --skip" in " ".join(sentences(result))


@pytest.mark.parametrize(
    ("walk", "value", "origin"),
    [
        (Interval(5.0, 4.0, 6.0), 5.0, Origin.MEASURED),
        (Interval(0.0, 0.0, 1.5), 1.5, Origin.BOUND),
        (Interval(2.0, 0.0, 9.0), Noise.gyro_bias_deg_h_per_sqrt_h, Origin.DEFAULT),
    ],
)
def test_what_the_filter_gets_for_its_random_walk(walk: Interval, value: float, origin: Origin) -> None:
    scaled = Interval(walk.value * DEG_H_ROOT_H, walk.low * DEG_H_ROOT_H, walk.high * DEG_H_ROOT_H)
    chosen = filter_noise(Interval(1e-5, 0.9e-5, 1.1e-5), scaled)
    assert chosen.rate_random_walk / DEG_H_ROOT_H == pytest.approx(value)
    assert chosen.origin is origin
    assert chosen.angle_random_walk == 1e-5


def test_flicker_is_covered_by_the_filters_random_walk() -> None:
    result = quick(static_log(3600.0, 5.0, B=5 * DEG_H))
    assert result.filter.origin is Origin.MEASURED
    curve, n, k = result.curve, result.filter.angle_random_walk, result.filter.rate_random_walk
    profile = np.sqrt(n**2 / curve.tau_s + k**2 * curve.tau_s / 3)
    assert (profile > 0.6 * np.sqrt(result.fit.variance)).all()
    assert profile[-1] > np.sqrt(result.fit.variance[-1])


def test_doubtful_logs_are_told() -> None:
    coarse = static_log(600.0)
    coarse.rate_rad_s[:] = np.round(coarse.rate_rad_s / (0.2 * RAD_PER_DEG)) * 0.2 * RAD_PER_DEG
    assert "too coarse for the noise" in " ".join(sentences(quick(coarse)))
    radians = static_log(600.0)
    radians.rate_rad_s[:] *= RAD_PER_DEG
    assert "is the rate in rad/s" in " ".join(sentences(quick(radians)))
    humming = static_log(600.0)
    humming.rate_rad_s[:] += 0.02 * RAD_PER_DEG * np.sin(2 * np.pi * 0.1 * humming.time_s)
    assert "The model misses the curve" in " ".join(sentences(quick(humming)))


def test_too_little_left_and_motion_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = static_log(200.0)
    file = write_log(tmp_path / "log.csv", log)
    arguments = ["calibrate", "noise", str(file), "--output", str(tmp_path / "out")]
    assert drd([*arguments, "--skip", "150"]) == 2
    assert "expected at least 100 s, got 50 s after the first 150 s are left out" in capsys.readouterr().err
    log.rate_rad_s[1000:1100] += 5 * RAD_PER_DEG
    write_log(file, log)
    assert drd(arguments) == 2
    assert "a standstill throughout, got a rate of 5 deg/s at 100 s" in capsys.readouterr().err


@pytest.mark.parametrize(
    "arguments", [[], ["x.csv", "--live", "y.yaml"], ["x.csv", "--skip", "-1"], ["--seconds", "5"]]
)
def test_bad_usage(arguments: list[str]) -> None:
    with pytest.raises(SystemExit) as caught:
        noise_command.main(arguments)
    assert caught.value.code == 2


def fake_gyro(trouble: BaseException | None = None, fails_at_s: float = np.inf) -> Callable[..., Progress]:
    """In place of the recorder: the same calls, without the time."""

    def record(_: Config, seconds: float, on_sample: Any, on_progress: Any) -> Progress:
        log, progress = static_log(seconds, 5.0), Progress()
        for time_s, rate_rad_s in zip(log.time_s, log.rate_rad_s, strict=True):
            if time_s >= fails_at_s and trouble is not None:
                raise trouble
            sample = GyroSample(round(time_s * NS_PER_S), 0.2, rate_rad_s, 25.0)
            on_sample(progress.add(sample), sample)
            on_progress(progress)
        return progress

    return record


@pytest.mark.parametrize("trouble", [None, KeyboardInterrupt(), RecordingError("lost /dev/fog")])
def test_a_live_recording_is_analysed_even_if_cut_short(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], trouble: BaseException | None
) -> None:
    (tmp_path / "robot.yaml").write_text(CONFIG)
    monkeypatch.setattr(noise_command, "record", fake_gyro(trouble, 300.0))
    out = tmp_path / "out"
    arguments = ["--live", str(tmp_path / "robot.yaml"), "--seconds", "600", "--output", str(out)]
    assert noise_command.main(arguments) == 0
    said = capsys.readouterr()
    expected = 600.0 if trouble is None else 300.0
    assert len((out / "fog.csv").read_text().splitlines()) == expected * 5 + 1
    assert f"{duration(expected)} at 5 Hz" in said.out
    assert ("that were recorded are analysed" in said.err) == (trouble is not None)
    assert drd(["calibrate", "noise", *arguments]) == 2  # the recording is not overwritten
    assert "a new file for the recording" in capsys.readouterr().err


def test_a_live_recording_that_is_too_short_fails(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "robot.yaml").write_text(CONFIG)
    monkeypatch.setattr(noise_command, "record", fake_gyro(RecordingError("cannot open /dev/fog"), 0.0))
    assert noise_command.main(["--live", str(tmp_path / "robot.yaml"), "--output", str(tmp_path)]) == 1
    assert "cannot open /dev/fog" in capsys.readouterr().err
    assert not (tmp_path / "fog.csv").exists()


def test_the_live_display_tells_a_warm_up_from_a_steady_bias() -> None:
    for change, words in ((0.0, "steady"), (0.02, "still warming up: ")):
        drift, progress, said = Drift(10.0), Progress(), ""
        for i, noise in enumerate(np.random.default_rng(1).normal(0.0, 0.01, 400)):
            rate_rad_s = (noise + change * np.exp(-i / 200)) * RAD_PER_DEG
            progress.add(GyroSample(i * NS_PER_S // 10, 0.1, rate_rad_s, 25.0))
            said = drift.feed(progress)
            if i < 150:
                assert said.startswith("drift: known after")
        assert said.startswith(words)


@pytest.mark.parametrize("bias_deg_h", [44.0, 86.0, 108.0])
def test_a_bias_within_a_step_of_the_readings_is_as_unsure_as_the_step(bias_deg_h: float) -> None:
    step = 180.0 * DEG_H
    exact = static_log(bias_deg_h=bias_deg_h)
    for coarse in (step, 0.25 * step):  # of the gyro's noise 11 and 3 times
        found = analyse(replace(exact, rate_rad_s=coarse * np.round(exact.rate_rad_s / coarse)), 0.0, simulations=20)
        assert abs(found.bias_rad_s - bias_deg_h * DEG_H) < 3.0 * found.bias_sigma_rad_s
        assert found.start_sigma_rad_s > 0.2 * coarse
    # Noise of half a step and more averages the rounding out.
    fine = replace(exact, rate_rad_s=0.04 * step * np.round(exact.rate_rad_s / step / 0.04))
    assert rounding_rad_s(fine) < 1e-3 * 0.04 * step


@pytest.mark.recordings
@pytest.mark.skipif(not KVH.is_dir(), reason="no shared recordings")
def test_the_real_bench_log_of_a_kvh_1750_is_no_standstill() -> None:
    # A person turns the gyro by hand after 2.5 s; before, the table's motion is far above the gyro's 0.012 deg/sqrt(h).
    lines = gzip.decompress((KVH / "kvh_direct_imu_delta.log.gz").read_bytes()).decode().splitlines()
    increments_rad = np.array([line.split()[6] for line in lines if "unknown" not in line], float)
    log = StaticLog("kvh", "", 1e-3, increments_rad / 1e-3, None, 0.0)
    found = motion(log)
    assert found is not None
    assert found[0] == pytest.approx(2.5, abs=1.0)
    curve = allan_curve(log.rate_rad_s[:2400], 1e-3)
    short = curve.tau_s < 0.02  # the table swings in 0.1 s
    squares = fit(shapes(curve.tau_s[short]), curve.deviation[short] ** 2, curve.edf[short], (Q, N)).squares
    assert 0.1 < np.sqrt(squares[N]) / DEG_ROOT_H < 1.0
