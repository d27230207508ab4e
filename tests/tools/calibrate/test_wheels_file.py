"""The numbers of wheels.yaml."""

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from drd_tools.calibrate.wheels.file import plain


@given(size=st.floats(-20.0, 20.0), sign=st.sampled_from([-1.0, 1.0]))
def test_a_number_reads_back_as_the_same_number(size: float, sign: float) -> None:
    number = sign * 10.0**size
    read = yaml.safe_load(plain(number))
    assert isinstance(read, float)
    assert read == pytest.approx(number, rel=1e-9, abs=0.0)


def test_numbers_are_plain() -> None:
    assert [plain(x) for x in (1e6, 1e-13, 5e-5, 1.0, "skid")] == [
        "1000000.0", "0.0000000000001", "0.00005", "1.0", "skid",
    ]  # fmt: skip
