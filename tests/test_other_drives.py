"""Mirrored and cut recordings are readable, turn the other way, and are as long as they should be."""

from pathlib import Path

import numpy as np
import pytest
from other_drives import write_others

from drd_tools.recordings.folder import read_recording
from drd_tools.simulate.conditions import Conditions
from drd_tools.simulate.files import write_folder
from drd_tools.simulate.missions import make_drive
from drd_tools.simulate.robot import DEFAULT
from drd_tools.simulate.simulator import simulate
from drd_tools.simulate.truth import make_truth


def test_a_mirror_image_turns_the_other_way_and_parts_have_their_length(tmp_path: Path) -> None:
    drive = simulate(make_truth(make_drive("warehouse", 60.0)), DEFAULT, (), Conditions(), 1)
    write_folder(drive, tmp_path / "run", {})
    (tmp_path / "run" / "truth.csv").unlink()
    write_others(tmp_path / "run", tmp_path / "out")
    run, image, first, last = (
        read_recording(folder) for folder in (tmp_path / "run", *(tmp_path / "out" / f"run_{k}" for k in "maz"))
    )
    left, right = run.wheel_angles_rad()
    assert np.allclose(image.wheel_angles_rad(), (right, left))
    assert run.reference is not None
    assert image.reference is not None
    assert np.allclose(image.reference.y_m, -run.reference.y_m)
    whole_s = run.encoders.time_s[-1]
    for part in (first, last):
        assert part.encoders.time_s[-1] - part.encoders.time_s[0] == pytest.approx(0.65 * whole_s, abs=0.1)
