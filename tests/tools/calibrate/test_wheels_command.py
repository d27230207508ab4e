"""`drd calibrate wheels` as a user runs it: what it prints, what it writes, and its errors."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from replay_folders import write_perfect
from wheel_recordings import RADIUS_M, SPIN, STRAIGHT, TOUR, TREAD_M, Truth, write_drive

from drd.cli import main
from drd.config.file import load_config
from drd.config.keys import Config
from drd.config.schema import load
from drd.estimation.estimate import MEASURED_TREAD, WHEEL_SCALE
from drd_tools.calibrate.wheels.umbmark import predict_m

ROOT = Path(__file__).resolve().parents[3]
SHARED = ROOT.parent / "shared/recordings"
TRUTH = Truth(
    left=1.006, right=0.995, tread=1.04, slip_m_per_sqrt_m=0.001, position_sigma_m=0.003, heading_sigma_rad=0.002
)


def run(capsys: pytest.CaptureFixture[str], *arguments: object) -> tuple[int, str, str]:
    code = main(["calibrate", "wheels", *map(str, arguments)])
    out, err = capsys.readouterr()
    return code, " ".join(out.split()), " ".join(err.split())


def returns_file(path: Path, alpha_rad: float, beta_rad: float, runs: int = 5, sigma_m: float = 0.005) -> Path:
    noise = np.random.default_rng(1).normal(0.0, sigma_m, (runs, 2, 2))
    rows = predict_m(alpha_rad, beta_rad, 4.0) + noise
    text = "".join(f"{way},{x:.4f},{y:.4f}\n" for run in rows for way, (x, y) in zip(("cw", "ccw"), run, strict=True))
    path.write_text("direction,x_m,y_m\n" + text)
    return path


def merged(config: Any, snippet: Any) -> Any:
    if not isinstance(snippet, dict):
        return snippet
    config = config or {}  # a section may be empty
    return {**config, **{name: merged(config.get(name), value) for name, value in snippet.items()}}


def loaded_with(snippet: Path, tmp_path: Path) -> Config:
    """A shipped configuration with the snippet merged in, through the daemon's own loader."""
    base = yaml.safe_load((ROOT / "config/canopen.yaml").read_text())
    file = tmp_path / "merged.yaml"
    file.write_text(yaml.safe_dump(merged(base, yaml.safe_load(snippet.read_text()))))
    return load(file, Config).value


def test_recordings_give_values_figures_files(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    fitted = [write_drive(tmp_path / f"fit{k}", TOUR, TRUTH, k) for k in range(2)]
    held_out = write_drive(tmp_path / "test", TOUR, TRUTH, 7)
    output = tmp_path / "out/wheels"
    code, out, _ = run(capsys, *fitted, "--held-out", held_out, "--output", output)
    assert code == 0
    assert "left radius" in out
    assert "Held-out figures: recordings that were not fitted." in out
    assert "written: " in out
    config = loaded_with(output / "wheels.yaml", tmp_path)
    assert config.robot.wheel_radius_m == RADIUS_M
    assert config.robot.left_scale == pytest.approx(1.006, abs=0.003)
    assert config.robot.right_scale == pytest.approx(0.995, abs=0.003)
    assert config.robot.tread_m == pytest.approx(1.04 * TREAD_M, rel=0.005)
    assert 0.0 < (config.estimation.initial.wheel_scale or 0.0) < 0.003
    assert 0.0 < (config.estimation.initial.tread or 0.0) < 0.01
    text = (output / "wheels.yaml").read_text()
    assert "fit0: robot.yaml " in text
    assert "drd " in text
    html = (output / "report.html").read_text()
    assert html.count("data:image/png") == 2
    assert "test" in html


@pytest.mark.parametrize("as_speeds", [True, False])
def test_lag_and_gyro_noise_are_told_and_run_as_written(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], as_speeds: bool
) -> None:
    folders = [late_drive(tmp_path / f"fit{k}", 0.27, k, as_speeds) for k in range(2)]
    output = tmp_path / "out"
    code, out, _ = run(capsys, *folders, "--output", output)
    assert code == 0
    assert "lag of the wheels behind the gyro" in out
    assert "gyro noise at rest" in out
    html = (output / "report.html").read_text()
    assert "lag of the wheels behind the gyro" in html
    assert "gyro noise at rest" in html
    file = output / "wheels.yaml"
    text = file.read_text()
    assert "latency_s: 0.2" in text
    assert "# against the gyro; sigma 0.0" in text
    config = loaded_with(file, tmp_path)
    assert config.encoders.latency_s == pytest.approx(0.27, abs=0.01)
    assert config.estimation.noise.gyro_deg_per_sqrt_h == pytest.approx(2.0, rel=0.4)
    assert config.estimation.noise.timing_s < 0.02
    assert load_config(tmp_path / "merged.yaml")  # as `drd run` reads it, with silences that are longer than the lag
    late_s = replayed_rms_m(folders[0], None, capsys)
    assert replayed_rms_m(folders[0], file, capsys) < 0.5 * late_s


def late_drive(folder: Path, lag_s: float, seed: int, as_speeds: bool) -> Path:
    """A tour after half a minute of standstill; the wheels' rows are late, the gyro has a noise of 2 deg/sqrt(h)."""
    write_perfect(folder, gyro=True, as_speeds=as_speeds, legs=((0.0, 0.0, 40.0 + seed), *TOUR))
    for name, shift_s, noise in (("encoders", lag_s, 0.0), ("fog", 0.0, 2.0 / 60.0 / np.sqrt(0.1))):
        lines = (folder / f"{name}.csv").read_text().splitlines()
        rows = np.array([[float(cell) for cell in line.split(",")] for line in lines[1:]])
        rows[:, 0] += shift_s
        rows[:, 1] += np.random.default_rng(seed).normal(0.0, 1.0, len(rows)) * noise
        np.savetxt(folder / f"{name}.csv", rows, "%.12g", ",", header=lines[0], comments="")
    return folder


def replayed_rms_m(folder: Path, config: Path | None, capsys: pytest.CaptureFixture[str]) -> float:
    """Root mean square distance of the replayed poses from the reference, m."""
    output = folder.parent / "poses.csv"
    options = ["--config", str(config)] if config is not None else []
    assert main(["replay", str(folder), *options, "--start", "reference", "--output", str(output)]) == 0
    capsys.readouterr()
    poses, reference = (np.loadtxt(f, delimiter=",", skiprows=1) for f in (output, folder / "reference.csv"))
    off_m = [np.interp(reference[:, 0], poses[:, 0], poses[:, k]) - reference[:, k] for k in (1, 2)]
    return float(np.sqrt(np.mean(np.square(off_m)) * 2.0))


def test_without_a_gyro_the_lag_is_the_references(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    early, late = (
        [write_drive(tmp_path / f"{name}{k}", TOUR, replace(TRUTH, time_s=shift_s), k) for k in range(2)]
        for name, shift_s in (("early", -0.1), ("late", 0.1))
    )
    _, out, _ = run(capsys, *late, "--output", tmp_path / "out")
    assert "lag of the wheels behind the reference" in out
    assert "whose own delay is assumed to be zero" in out
    assert loaded_with(tmp_path / "out/wheels.yaml", tmp_path).encoders.latency_s == pytest.approx(0.1, abs=0.02)
    _, out, _ = run(capsys, *early, "--output", tmp_path / "out")
    assert "or it is the reference that lags. It is not written." in out
    assert "latency_s" not in (tmp_path / "out/wheels.yaml").read_text()


def test_a_gyro_that_is_late_gets_the_latency_itself(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folders = [late_drive(tmp_path / f"fit{k}", -0.3, k, as_speeds=False) for k in range(2)]
    assert run(capsys, *folders, "--output", tmp_path / "out")[0] == 0
    config = loaded_with(tmp_path / "out/wheels.yaml", tmp_path)
    assert config.fog.latency_s == pytest.approx(0.3, abs=0.01)
    assert config.encoders.latency_s == 0.0
    assert load_config(tmp_path / "merged.yaml")  # its waiting times go with it


def test_without_held_out_each_recording_is_held_out_in_turn_and_a_single_one_is_cut(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """One recording says nothing of the next: what the filter starts with is then usual, not the fit's sigma."""
    code, out, _ = run(capsys, write_drive(tmp_path / "a", TOUR, TRUTH), "--output", tmp_path / "one")
    assert code == 0
    assert "each fifth of the recording" in out
    assert "part 5 of 5" in out
    treads = (1.0, 1.05, 1.1)
    folders = [write_drive(tmp_path / f"fit{k}", TOUR, replace(TRUTH, tread=t), k) for k, t in enumerate(treads)]
    code, out, _ = run(capsys, *folders, "--output", tmp_path / "three")
    assert code == 0
    assert "each recording with the wheels that all others give" in out
    assert "fit0 " in out
    assert "all (mean)" in out
    one, three = (
        loaded_with(tmp_path / name / "wheels.yaml", tmp_path).estimation.initial for name in ("one", "three")
    )
    assert (one.wheel_scale, one.tread) == (WHEEL_SCALE, MEASURED_TREAD)
    assert three.tread == pytest.approx(0.05 / 1.05, rel=0.4)


def test_what_is_not_determined_stays_nominal_in_the_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code, out, _ = run(capsys, write_drive(tmp_path / "a", STRAIGHT, TRUTH), "--output", tmp_path / "out")
    assert code == 0
    assert "tread: not determined, the recordings hardly turn" in out
    config = loaded_with(tmp_path / "out/wheels.yaml", tmp_path)
    assert config.robot.tread_m == TREAD_M
    assert config.estimation.initial.tread == 0.02
    assert "tread: not determined" in (tmp_path / "out/wheels.yaml").read_text()


def test_nothing_determined_writes_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    blind = replace(TRUTH, position_sigma_m=5.0, heading_sigma_rad=3.0)
    folder = write_drive(tmp_path / "a", SPIN, blind)
    code, out, _ = run(capsys, folder, "--output", tmp_path / "out")
    assert code == 1
    assert "Nothing could be determined." in out
    assert "No held-out figure" in out
    assert not (tmp_path / "out").exists()


def test_umbmark_gives_values_figure_files(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = returns_file(tmp_path / "returns.csv", -0.03, 0.02)
    code, out, _ = run(capsys, "--umbmark", file, "--side", 4, "--tread", 0.5, "--output", tmp_path / "out")
    assert code == 0
    for name in (
        "alpha",
        "beta",
        "E_b",
        "E_d",
        "c_l",
        "c_r",
        "corrected tread",
        "E_max,syst before",
        "E_max,syst after",
    ):
        assert name in out
    assert "Held-out figure: with one run of each direction left out in turn (5 pairs)" in out
    config = loaded_with(tmp_path / "out/wheels.yaml", tmp_path)
    assert config.robot.tread_m == pytest.approx(0.5 * (np.pi / 2) / (np.pi / 2 - 0.03), rel=1e-3)
    assert config.robot.left_scale < 1.0 < config.robot.right_scale
    assert (tmp_path / "out/report.html").read_text().count("data:image/png") == 1


def test_umbmark_prints_without_output(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = returns_file(tmp_path / "returns.csv", 0.0, 0.0005, runs=3, sigma_m=0.02)
    code, out, _ = run(capsys, "--umbmark", file, "--side", 4, "--tread", 0.5)
    assert code == 0
    assert "UMBmark asks for 5 runs in each direction; here are 3 cw and 3 ccw." in out
    assert "not significant: " in out
    assert "written" not in out


@pytest.mark.parametrize("way", ["cw", "ccw"])
def test_umbmark_of_one_direction_is_refused_in_words(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], way: str
) -> None:
    file = tmp_path / "returns.csv"
    file.write_text("direction,x_m,y_m\n" + f"{way},0.1,-0.1\n" * 5)
    code, out, _ = run(capsys, "--umbmark", file, "--side", 4, "--tread", 0.5, "--output", tmp_path / "out")
    assert code == 1
    assert f"E_d and E_b: not determined, all 5 squares are {way}" in out
    assert not (tmp_path / "out").exists()


def test_bad_input_gets_one_line_and_code_2(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    good = write_drive(tmp_path / "good", TOUR, TRUTH)
    other = write_drive(tmp_path / "other", TOUR, TRUTH, 1, tread_m=0.7)
    broken = write_drive(tmp_path / "broken", TOUR, TRUTH, 2)
    (broken / "reference.csv").write_text("time_s,x_m,y_m,heading_deg\n0,0,0,0\n1,0,north,0\n")
    blocked = tmp_path / "file"
    blocked.write_text("")
    out = ("--output", tmp_path / "out")
    for arguments, expected in (
        ((tmp_path / "none", *out), "none: expected a recording folder, got nothing there"),
        ((good, other, *out), "other: robot.yaml: expected the same robot as in good"),
        ((good, "--held-out", other, *out), "other: robot.yaml: expected the same robot as in good"),
        ((good, "--held-out", good, *out), "expected each recording once, got the same data as"),
        ((broken, *out), "reference.csv:3: y_m: expected a finite number, got 'north'"),
        ((good, "--output", blocked / "out"), "expected a folder to write to, got Not a directory"),
        (("--umbmark", blocked, "--side", 4, "--tread", 0.5), "expected the header direction,x_m,y_m"),
    ):
        code, _, err = run(capsys, *arguments)
        assert code == 2
        assert err.startswith("drd calibrate: ")
        assert expected in err
        assert "Traceback" not in err


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        ((), "give recordings, or --umbmark"),
        (("a",), "--output DIR is needed"),
        (("a", "--side", "4", "--output", "b"), "go with --umbmark"),
        (("--umbmark", "a", "--tread", "0.5"), "needs --side"),
        (("--umbmark", "a", "--side", "4"), "needs --tread"),
        (("--umbmark", "a", "--side", "4", "--tread", "-1"), "--tread: expected a number from 0.02 to 100"),
        (("b", "--umbmark", "a", "--side", "4", "--tread", "1"), "takes no recordings"),
    ],
)
def test_bad_usage_is_explained(capsys: pytest.CaptureFixture[str], arguments: tuple[str, ...], expected: str) -> None:
    with pytest.raises(SystemExit) as stopped:
        main(["calibrate", "wheels", *arguments])
    assert stopped.value.code == 2
    assert expected in capsys.readouterr().err


def shared(pattern: str) -> list[Path]:
    found = sorted(SHARED.glob(pattern))
    if not found:
        pytest.skip("the shared recordings are not here")
    return found


def figures_in(out: str) -> list[float]:
    """Position error at the end in cm, nominal and calibrated, of the row over all recordings."""
    words = out.split("all (mean)")[1].split()
    return [float(words[1]), float(words[3])]


@pytest.mark.recordings
def test_squares_of_the_real_robot_are_told_by_its_other_squares(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    _, out, _ = run(capsys, *shared("optiodom_square_2306*")[::2], "--output", tmp_path / "out")
    nominal_cm, calibrated_cm = figures_in(out)
    assert calibrated_cm < 0.7 * nominal_cm


@pytest.mark.recordings
def test_circles_of_the_real_robot_are_no_full_model_of_its_squares(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    circles, squares = shared("optiodom_circular_2506*"), shared("optiodom_square_2306*")
    _, out, _ = run(capsys, *circles, "--held-out", *squares, "--output", tmp_path / "out")
    assert "give a different tread" in out
    assert "on the spot" in out
    # What the filter starts with has to cover the squares' tread, 0.5 % away, not the fit's sigma.
    assert (loaded_with(tmp_path / "out/wheels.yaml", tmp_path).estimation.initial.tread or 0.0) > 0.003


@pytest.mark.recordings
def test_a_skid_steered_robot_gets_its_effective_tread(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    _, out, _ = run(capsys, *shared("warthog_grass*"), "--output", tmp_path / "out")
    nominal_cm, calibrated_cm = figures_in(out)
    assert calibrated_cm < 0.1 * nominal_cm
    assert loaded_with(tmp_path / "out/wheels.yaml", tmp_path).robot.tread_m > 1.5 * 1.08


@pytest.mark.recordings
def test_what_is_written_for_the_real_robot_improves_its_replay(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Of each recording, with a calibration by the others. Without it lag and tread are learned on the way, too, but
    nothing tells how long the way is.
    """
    folders = shared("warthog_*")
    gains, calibrated_m = [], []
    for folder in folders[:2]:
        others = [other for other in folders if other != folder]
        run(capsys, *others, "--output", tmp_path / "out")
        (tmp_path / folder.name).symlink_to(folder)
        errors_m = [replayed_rms_m(tmp_path / folder.name, c, capsys) for c in (None, tmp_path / "out/wheels.yaml")]
        gains.append(errors_m[1] / errors_m[0])
        calibrated_m.append(errors_m[1])
    assert max(gains) < 0.97
    assert max(calibrated_m) < 0.6
