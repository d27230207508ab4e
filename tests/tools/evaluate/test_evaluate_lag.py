"""References that show the motion later, or earlier, than the poses."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pose_files import drive, estimate_of, write_poses
from wheel_recordings import TOUR, Truth, write_drive

from drd.cli import main
from drd_tools.evaluate.judge import judge
from drd_tools.evaluate.lag import Lag, lag_of, shifted, taken_off
from drd_tools.evaluate.text import sentences
from drd_tools.evaluate.trajectory import Poses, Reference

AUTO = math.nan


def late_by(lag_s: float) -> Reference:
    return shifted(drive(60.0), -lag_s)


@pytest.mark.parametrize("lag_s", [0.3, -0.1, 0.74])
def test_a_lag_is_found_told_and_taken_off(lag_s: float) -> None:
    poses, late = estimate_of(drive(60.0)), late_by(lag_s)
    assert lag_of(poses, late).value_s == pytest.approx(lag_s, abs=0.011)
    as_it_is, without = judge(poses, late), judge(poses, late, lag_s=AUTO)
    assert as_it_is.lag_left_s is not None
    assert as_it_is.lag_taken_s == 0.0
    assert as_it_is.lag_left_s == pytest.approx(lag_s, abs=0.011)
    order = "later" if lag_s > 0.0 else "earlier"
    assert f"{abs(as_it_is.lag_left_s):.2f} s {order} than the poses" in " ".join(sentences(as_it_is))
    assert without.lag_taken_s == pytest.approx(lag_s, abs=0.011)
    assert without.lag_left_s == 0.0
    assert without.absolute.heading_rmse_deg < 0.1 * as_it_is.absolute.heading_rmse_deg
    given = judge(poses, late, lag_s=lag_s)
    assert given.absolute.heading_rmse_deg == pytest.approx(0.0, abs=1e-6)
    assert "--reference-lag" not in " ".join(sentences(given))


def test_nothing_is_taken_off_where_the_headings_do_not_show_it() -> None:
    poses, late = estimate_of(drive(60.0)), late_by(0.3)
    noise = np.random.default_rng(3).normal(0.0, 1.0, len(late.time_s))
    shaken = replace(late, pose=late.pose + np.column_stack([0.0 * noise, 0.0 * noise, noise]))
    ends = replace(late, time_s=late.time_s[[5, -5]], pose=late.pose[[5, -5]])
    apart = replace(late, time_s=late.time_s + 1e4)
    for reference, left_s in ((drive(60.0), 0.0), (shaken, 0.0), (ends, None), (apart, None)):
        assert taken_off(poses, reference, AUTO)[1:] == (0.0, left_s)
        assert taken_off(poses, reference, 0.0)[1:] == (0.0, 0.0)


@pytest.mark.parametrize("off", [slice(3), slice(-3, None)])
def test_rows_at_an_end_that_are_off_are_no_lag(off: slice) -> None:
    """Another lag would leave them out, and gain by that."""
    true = drive(60.0)
    pose = true.pose.copy()
    pose[off, 2] += 0.2
    found = lag_of(estimate_of(true), replace(true, pose=pose))
    assert abs(found.value_s) < 0.011
    assert lag_of(replace(estimate_of(true), time_s=np.zeros(0)), true).nats == 0.0


def test_where_a_recording_is_too_short_for_it_no_lag_is_taken_and_that_is_told() -> None:
    short = drive(0.9)
    judged = judge(estimate_of(short), short, lag_s=AUTO)
    assert (judged.lag_taken_s, judged.lag_left_s) == (0.0, None)
    assert "The lag of the reference is not estimated" in " ".join(sentences(judged))
    assert "No lag" not in " ".join(sentences(judge(estimate_of(short), short)))
    assert lag_of(Poses("none", np.empty(0), np.empty((0, 3))), short) == Lag(0.0, 0.0, is_sought=False)


@pytest.mark.parametrize("command", ["evaluate", "explain"])
def test_both_commands_tell_of_it_and_take_it_off(
    command: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = write_drive(tmp_path / "late", TOUR, Truth())
    rows = np.genfromtxt(folder / "reference.csv", delimiter=",", names=True)
    pose = np.column_stack([rows["x_m"], rows["y_m"], np.radians(rows["heading_deg"])])
    write_poses(folder / "reference.csv", rows["time_s"] + 0.4, pose)
    arguments = [command, str(folder), "--output", str(tmp_path / "out")]
    assert main(arguments) == 0
    assert "later than the poses" in capsys.readouterr().out
    assert main([*arguments, "--reference-lag", "auto"]) == 0
    assert "s earlier." in (out := capsys.readouterr().out)
    assert "--reference-lag" not in out
    with pytest.raises(SystemExit) as ended:
        main([*arguments, "--reference-lag", "late"])
    assert ended.value.code == 2
    assert "--reference-lag" in capsys.readouterr().err
