import pytest
from hypothesis import given
from hypothesis import strategies as st

from drd.ports.can_errors import COUNTERS, problems, state_after


@pytest.mark.parametrize(
    ("can_id", "data", "names", "state"),
    [
        (0x001, "0000000000000000", {"tx_timeout"}, "transmit timeout"),
        (0x002, "0000000000000000", {"lost_arbitration"}, None),
        (0x004, "0001000000000000", {"rx_overflow"}, None),
        (0x004, "0002000000000000", {"tx_overflow"}, None),
        (0x004, "0004000000000000", {"error_warning"}, "error-warning"),
        (0x004, "0008000000000000", {"error_warning"}, "error-warning"),
        (0x204, "0010000000008700", {"error_passive"}, "error-passive"),
        (0x204, "0030000000008787", {"error_passive"}, "error-passive"),
        (0x020, "0000000000000000", {"no_acknowledgement"}, "no node acknowledges"),
        (0x040, "0000000000000000", {"bus_off"}, "bus-off"),
        (0x044, "0020000000000000", {"bus_off", "error_passive"}, "bus-off"),
        (0x088, "0000040000000000", {"protocol_violation", "bus_error"}, None),
        (0x010, "0000000010000000", {"transceiver_error"}, None),
    ],
)
def test_each_error_class_has_its_counter_and_state(can_id: int, data: str, names: set[str], state: str | None) -> None:
    assert problems(can_id, bytes.fromhex(data)) == names
    assert state_after(names, None) == state


@pytest.mark.parametrize("frame", [(0x100, bytes(8)), (0x004, b"\0\x40" + bytes(6))])
def test_a_restart_and_a_return_to_error_active_end_the_trouble(frame: tuple[int, bytes]) -> None:
    assert state_after(problems(*frame), "bus-off") is None


def test_an_error_without_a_state_of_its_own_leaves_the_state() -> None:
    assert state_after(problems(0x080, bytes(8)), "error-passive") == "error-passive"


@given(st.integers(0, 0x7FF), st.binary(max_size=8), st.sampled_from([None, "bus-off"]))
def test_any_error_frame_is_decoded_into_known_counters(can_id: int, data: bytes, state: str | None) -> None:
    names = problems(can_id, data)
    assert names <= set(COUNTERS)
    state_after(names, state)
