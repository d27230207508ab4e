"""What all commands share: types of options, and whose fault an unwritable folder is."""

from argparse import ArgumentTypeError
from pathlib import Path

import pytest

from drd.commands import number, whole, writing
from drd.config.schema import ConfigError


def test_a_number_is_finite_and_within_its_limits() -> None:
    assert number()("-1e3") == -1000.0
    assert number(0.0)("0") == 0.0
    assert number(1.0, 2.0)("2") == 2.0
    for kind, text, said in (
        (number(), "inf", "a finite number, got 'inf'"),
        (number(0.0), "-1", "a number of at least 0, got '-1'"),
        (number(0.0, above=True), "0", "a number above 0, got '0'"),
        (number(1.0, 2.0), "nan", "a number from 1 to 2, got 'nan'"),
        (number(1.0, 2.0), "two", "a number from 1 to 2, got 'two'"),
    ):
        with pytest.raises(ArgumentTypeError) as caught:
            kind(text)
        assert str(caught.value) == f"expected {said}"


@pytest.mark.parametrize("text", ["1", "-3", "2.5", "many", ""])
def test_a_whole_number_is_whole_and_large_enough(text: str) -> None:
    assert whole(2)("2") == 2
    with pytest.raises(ArgumentTypeError, match=f"expected a whole number of at least 2, got {text!r}"):
        whole(2)(text)


def test_a_folder_that_cannot_be_written_is_an_error_of_the_usage(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(ConfigError, match=r"file: .*a folder to write to, got File exists"), writing(tmp_path / "file"):
        (tmp_path / "file").mkdir()
    with pytest.raises(BrokenPipeError), writing(tmp_path):
        raise BrokenPipeError
