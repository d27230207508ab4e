import struct
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pytest

from drd_tools.report.path import ErrorSeries, path_picture

ANGLE = np.linspace(0.0, 6.0, 50)
CIRCLE = np.column_stack((np.cos(ANGLE), np.sin(ANGLE)))
ERROR = 0.01 * ANGLE


def size_of(file: Path) -> tuple[int, int]:
    data = file.read_bytes()
    assert data.startswith(b"\x89PNG\r\n\x1a\n")
    width, height = struct.unpack(">II", data[16:24])
    return width, height


def test_a_picture_of_all_there_is_to_draw_is_a_png(tmp_path: Path) -> None:
    file, style = tmp_path / "run.png", dict(mpl.rcParams)
    path_picture(
        file,
        CIRCLE,
        1.01 * CIRCLE,
        1.1 * CIRCLE,
        errors=ErrorSeries(ANGLE, ERROR, bound_m=3 * ERROR, valid=ANGLE < 5.0),
        title="a title",
        caption="a caption of many words " * 20,
    )
    assert size_of(file) == (1500, 870)
    assert dict(mpl.rcParams) == style


@pytest.mark.parametrize("size_m", [0.0, 1e-3, 1e4])
def test_paths_of_any_size_can_be_drawn_without_the_optional_parts(tmp_path: Path, size_m: float) -> None:
    file = tmp_path / "run.png"
    path_picture(file, size_m * CIRCLE, size_m * CIRCLE, errors=ErrorSeries(ANGLE, size_m * ERROR))
    assert size_of(file) == (1500, 870)


def test_a_run_of_one_pose_can_be_drawn(tmp_path: Path) -> None:
    one, file = np.zeros((1, 2)), tmp_path / "run.png"
    path_picture(file, one, one, one, errors=ErrorSeries(np.zeros(1), np.zeros(1), np.zeros(1)))
    assert size_of(file) == (1500, 870)


def test_a_bound_makes_a_different_picture(tmp_path: Path) -> None:
    without, bounded = tmp_path / "without.png", tmp_path / "bounded.png"
    path_picture(without, CIRCLE, CIRCLE, errors=ErrorSeries(ANGLE, ERROR))
    path_picture(bounded, CIRCLE, CIRCLE, errors=ErrorSeries(ANGLE, ERROR, bound_m=2 * ERROR))
    assert without.read_bytes() != bounded.read_bytes()


def test_a_file_that_cannot_be_written_is_an_os_error(tmp_path: Path) -> None:
    with pytest.raises(OSError, match="absent"):
        path_picture(tmp_path / "absent/run.png", CIRCLE, CIRCLE, errors=ErrorSeries(ANGLE, ERROR))
