"""Effects planted in the raw data of recorded drives."""

import importlib.util
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from diagnosis_drives import recorded, selected
from trial_records import amount, finding

from drd.arrays import Array
from drd.cli import main
from drd.effects.catalogue import catalogue
from drd_tools.diagnose.analysis import analyse
from drd_tools.diagnose.observe.evidence import gather
from drd_tools.diagnose.regression.problem import Problem
from drd_tools.diagnose.results import Finding
from drd_tools.recordings.folder import Recording, read_recording
from drd_tools.simulate.conditions import PERFECT, Conditions
from drd_tools.simulate.files import write_folder
from drd_tools.simulate.missions import make_drive
from drd_tools.simulate.robot import DEFAULT
from drd_tools.simulate.simulator import simulate
from drd_tools.simulate.truth import make_truth
from drd_tools.trial import plant
from drd_tools.trial.overlay import planted
from drd_tools.trial.planted import Judged, composed, judged, not_visible, planted_table
from drd_tools.trial.results import Planted, Store, TrueEffect, Untouched, si
from drd_tools.trial.size import Whitener

SHARED = Path(__file__).resolve().parents[3].parent / "shared"
SCRIPT = SHARED / "trials/plant.py"
DRIVES = ("warthog_grass_2024_7_29_14h4s53", "optiodom_square_231220200029_run-01")
EFFECTS = (
    "wheel_radius_error", "tread_error", "tyre_deflation", "surface_slip", "encoder_dropout", "encoder_latency",
    "encoder_clock_skew", "gyro_scale_error", "gyro_bias_step", "gyro_latency", "gyro_scale_asymmetry",
    "gyro_saturation", "gyro_warmup", "gyro_vibration_bias",
)  # fmt: skip


def small(folder: Path, name: str) -> Path:
    truth = make_truth(make_drive("square-cw", 60.0))
    write_folder(simulate(truth, DEFAULT, (), Conditions(), 3), folder / name, {})
    return folder / name


def others_script() -> Any:
    if not SCRIPT.exists():
        pytest.skip("the shared recordings and their planting script are not here")
    spec = importlib.util.spec_from_file_location("others_script", SCRIPT)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def angles(recording: Recording) -> list[Array]:
    """Angles of the wheels and, where there is one, of the gyro, rad."""
    turned, fog = list(recording.wheel_angles_rad()), recording.fog
    return turned if fog is None else [*turned, np.cumsum(fog.rate_rad_s[1:] * np.diff(fog.time_s))]


@pytest.mark.recordings
@pytest.mark.parametrize(
    ("name", "drive"), [(e, d) for e in EFFECTS for d in DRIVES if d.startswith("warthog") or not e.startswith("gyro")]
)
def test_raw_data_are_those_of_an_independent_script(name: str, drive: str, tmp_path: Path) -> None:
    script, before = others_script(), read_recording(SHARED / "recordings" / drive)
    theirs = script.read(SHARED / "recordings" / drive)
    parameters = script.plant(theirs, name, np.random.default_rng(3))
    script.write(tmp_path, theirs)
    true = TrueEffect(effect=name, parameters=parameters)
    ours = planted(before, catalogue()[name], si(true))
    changed = 0.0
    for was, mine, other in zip(angles(before), angles(ours), angles(read_recording(tmp_path)), strict=True):
        change = float(np.sqrt(np.mean((other - was) ** 2)))
        # Six decimals in their files, a whole count, and the row in which a window begins.
        assert float(np.sqrt(np.mean((mine - other) ** 2))) <= 0.03 * change + 1e-3
        changed = max(changed, change)
    assert changed > 5e-3


@pytest.mark.parametrize(
    "name", ["gyro_scale_error", "wheel_radius_error", "gyro_lag", "encoder_latency", "turn_scrub"]
)
def test_what_is_planted_is_what_the_simulator_makes(name: str) -> None:
    truth, effect = make_truth(make_drive("square-cw", 90.0)), catalogue()[name]
    values = {q.name: 0.05 for q in effect.parameters}
    plain, made = (simulate(truth, DEFAULT, effects, PERFECT, 3).recording for effects in ((), [(effect, values)]))
    ours = planted(plain, effect, values)
    for was, mine, other in zip(angles(plain), angles(ours), angles(made), strict=True):
        assert np.sqrt(np.mean((mine - other) ** 2)) <= 0.1 * np.sqrt(np.mean((other - was) ** 2)) + 2e-3


def test_an_effect_of_the_body_moves_the_reference() -> None:
    truth, effect = make_truth(make_drive("square-cw", 90.0)), catalogue()["rotation_centre_offset"]
    plain, made = (simulate(truth, DEFAULT, e, PERFECT, 3).recording for e in ((), [(effect, {"a": 0.2})]))
    ours = planted(plain, effect, {"a": 0.2})
    assert ours.reference is not None
    assert made.reference is not None
    np.testing.assert_allclose(ours.reference.x_m, made.reference.x_m, atol=0.01)
    np.testing.assert_allclose(ours.reference.y_m, made.reference.y_m, atol=0.01)
    np.testing.assert_array_equal(ours.wheel_angles_rad(), plain.wheel_angles_rad())


def test_a_late_reference_shows_an_effect_of_the_body_late() -> None:
    effect, values = catalogue()["rotation_centre_offset"], {"a": 0.2}
    plain = simulate(make_truth(make_drive("square-cw", 90.0)), DEFAULT, (), PERFECT, 3).recording
    moved = [planted(plain, effect, values, lag_s).reference for lag_s in (0.0, 0.5)]
    was = plain.reference
    assert was is not None
    in_time, late = (r.x_m - was.x_m for r in moved if r is not None)
    np.testing.assert_allclose(np.interp(was.time_s - 0.5, was.time_s, in_time), late, atol=1e-3)
    assert np.abs(late - in_time).max() > 0.02


@pytest.mark.parametrize(
    ("effect", "parameter", "before", "added", "together"),
    [
        ("tread_error", "k", 0.5, 0.1, 0.65),
        ("wheel_radius_error", "left", 0.1, 0.1, 0.19),
        ("gyro_sample_clock", "ratio", 1.01, 1.02, 1.0302),
        ("gyro_saturation", "limit", 40.0, 30.0, 30.0),
        ("encoder_latency", "delay", 0.1, 0.05, 0.15),
        ("gyro_bias_step", "t0", 10.0, 50.0, 50.0),
        ("gyro_warmup", "tau", 10.0, 50.0, 50.0),
        ("gyro_warmup", "b", 0.1, 0.2, 0.3),
    ],
)
def test_two_of_the_same_effect_make_one(
    effect: str, parameter: str, before: float, added: float, together: float
) -> None:
    assert composed(effect, parameter, before, added) == pytest.approx(together)


def score(true: TrueEffect, findings: list[Finding], before: list[Finding]) -> Judged:
    drive = Untouched(
        case="a", kind="untouched", effects=[], verdict="", findings=tuple(before), plantings={}, not_visible=[]
    )
    case = Planted(case="a.x.d12", kind="planted d12", effects=[true], verdict="", findings=tuple(findings), base="a")
    return judged(case, drive)


def test_a_size_is_judged_upon_that_of_the_untouched_drive() -> None:
    true, before = TrueEffect(effect="tread_error", parameters={"k": 0.1}), finding("tread_error", k=amount(0.5, 0.03))
    right = score(true, [finding("tread_error", k=amount(0.66, 0.04))], [before])
    assert (right.first, right.in_class, right.sized) == (True, True, True)
    (interval,) = right.intervals
    assert interval.true == pytest.approx(0.65)
    assert interval.std == pytest.approx(0.05)
    assert not score(true, [finding("tread_error", k=amount(0.45, 0.04))], [before]).sized
    assert score(true, [finding("tread_error", k=amount(0.1, 0.04))], []).sized


def test_a_size_is_judged_upon_what_the_drive_has_of_it_untold() -> None:
    true = TrueEffect(effect="gyro_vibration_bias", parameters={"k": 0.2}, own={"k": amount(0.04, 0.03)})
    found = score(true, [finding("gyro_vibration_bias", k=amount(0.25, 0.04))], [])
    assert found.sized
    (interval,) = found.intervals
    assert interval.true == pytest.approx(0.24)
    assert interval.std == pytest.approx(0.05)


def test_an_estimate_without_a_deviation_is_within_a_tenth() -> None:
    true = TrueEffect(effect="gyro_saturation", parameters={"limit": 30.0})
    near, far = (score(true, [finding("gyro_saturation", limit=amount(v, 0.0))], []) for v in (31.0, 34.0))
    assert (near.sized, far.sized) == (True, False)
    assert near.intervals == ()


def test_what_the_untouched_drive_has_already_is_neither_first_nor_extra() -> None:
    true, lag = TrueEffect(effect="gyro_scale_error", parameters={"k": 0.01}), finding("gyro_lag")
    own = finding("gyro_scale_error", k=amount(0.01, 0.001))
    assert score(true, [lag, own], [lag]).first
    second = score(true, [lag, own], [])
    assert (second.first, second.in_class, second.extra) == (False, True, ("gyro_lag",))
    near = score(true, [finding("tread_error", also_fits=("gyro_scale_error",)), finding("unknown")], [])
    assert (near.first, near.in_class, near.sized, near.extra) == (False, True, False, ())
    assert score(true, [finding("unknown", also_fits=("gyro_scale_error",))], []).in_class is False


def test_another_side_and_another_window_do_not_add_up() -> None:
    slip = TrueEffect(effect="surface_slip", parameters={"t0": 20.0, "t1": 40.0, "left": 0.1, "right": 0.1})
    size = amount(0.1, 0.01)
    mine, elsewhere = (finding("surface_slip", window=w, left=size, right=size) for w in ((20.0, 40.0), (70.0, 90.0)))
    s = score(slip, [elsewhere, mine], [elsewhere])
    assert (s.sized, s.overlap) == (True, 1.0)
    tyre = TrueEffect(effect="tyre_deflation", parameters={"side": "left", "total": 0.05})
    assert score(tyre, [finding("tyre_deflation", side="left", total=amount(0.05, 0.01))], []).sized
    assert not score(tyre, [finding("tyre_deflation", side="right", total=amount(0.05, 0.01))], []).sized


def test_from_the_command_and_again(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    shown = {name: catalogue()[name] for name in ("gyro_scale_error", "gyro_bias_temperature", "gyro_saturation")}
    monkeypatch.setattr(plant, "catalogue", lambda: {**shown})
    monkeypatch.setattr(plant, "DISTANCES", (25.0,))
    small(tmp_path / "drives", "one")
    out = tmp_path / "out"
    arguments = ["trial", "--plant", str(tmp_path / "drives"), "--glob", "o*", "--jobs", "1", "--output", str(out)]
    assert main([*arguments, "--only", "*.gyro_scale_error.*"]) == 0
    assert [row.case for row in Store(out).read()[1]] == ["one", "one.gyro_scale_error.d25"]
    capsys.readouterr()
    assert main(arguments) == 0
    captured = capsys.readouterr()
    assert main(arguments) == 0  # all is there
    assert capsys.readouterr().out == captured.out
    assert main(["trial", "--draw", str(out)]) == 0
    assert capsys.readouterr().out == captured.out
    head, rows = Store(out).read()
    assert (head.plant, head.glob) == (str(tmp_path / "drives"), "o*")
    untouched = next(r for r in rows if isinstance(r, Untouched))
    case = "one.gyro_scale_error.d25"
    true = untouched.plantings[case]
    assert true.detectability == pytest.approx(25.0, rel=0.03)
    (score,) = [judged(r, untouched) for r in rows if isinstance(r, Planted) and r.case == case]
    assert score.in_class
    cells = {row[0]: row for row in planted_table(rows).rows}
    assert cells["gyro_scale_error"][1] == "1"
    assert len(rows) == 1 + len(untouched.plantings)
    assert len(untouched.not_visible) == len(shown) - len(untouched.plantings)
    assert sum(row[2] == "1 of 1" for row in not_visible(rows).rows) == len(untouched.not_visible)
    assert "gyro_scale_error" in (out / "figures.md").read_text()


@pytest.mark.parametrize("arguments", [["--plant", "nowhere"], ["--plant", ".", "--glob", "no-such"]])
def test_a_folder_without_drives_is_one_clear_error(
    arguments: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["trial", *arguments, "--output", str(tmp_path / "out")]) == 2
    assert "--glob" in capsys.readouterr().err


def test_real_and_drawn_drives_do_not_mix(tmp_path: Path) -> None:
    with pytest.raises(SystemExit, match="2"):
        main(["trial", "--plant", ".", "--each", "1", "--output", str(tmp_path)])


def test_d_is_of_what_planting_does_to_readings_of_a_robot_far_off() -> None:
    """Whose counters tell a tread 65 % too large, and are late: once, not twice."""
    recording = recorded(("field", 200.0), 1, selected("tread_error", k=0.65), selected("encoder_latency", delay=0.17))
    analysis = analyse(recording)
    whitener, effect, values = Whitener.of(analysis), catalogue()["encoder_clock_skew"], {"ppm": 500e-6}
    p = whitener.problem
    rows = p.effect_rows([selected(effect.id, **values)])
    changed = gather(planted(recording, effect, values), p.evidence.robot)
    other = Problem(changed, p.path, p.noise, p.fix_inflation, inflation=p.inflation, near=p)
    # The noise is moved, too.
    assert float(rows @ (other.data - p.data) / (rows @ rows)) == pytest.approx(1.0, abs=0.15)
    # How a lag grows the calibration tells, beside how lags change by themselves: by 30 ms in a drive.
    sigma = math.hypot(analysis.measured.sigma.lag_growth, 0.03 / 200.0)
    assert whitener.detectability(effect, values) == pytest.approx(500e-6 / sigma, rel=0.01)
    assert whitener.detectability(catalogue()["gyro_sample_clock"], {"ratio": 1.0 + 500e-6}) > 0.0
