"""Real CAN frames of a car through the DBC layout, against the wheel speeds that were decoded beside them."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from drd.config.keys import Dbc, Encoders, Left, Right, Robot
from drd.encoders import make_layout
from drd.encoders.stream import EncoderStream
from drd.samples import CanFrame, Side, WheelReading, WheelSample
from drd.units import NS_PER_S

pytestmark = pytest.mark.recordings

# comma2k19 (MIT licence), segment 40 of a Toyota RAV4: one minute of all frames of its bus 0.
RECORDING = Path(__file__).resolve().parents[2].parent / "shared/recordings/raw/comma2k19/segment40.npz"
WHEEL_SPEEDS_ID = 0xAA
WHEEL_SPEEDS_BYTES = 8
TEXT = """VERSION ""
BU_: CAR
BO_ 170 WHEEL_SPEEDS: 8 CAR
 SG_ FRONT_RIGHT : 7|16@0+ (0.01,-67.67) [0|250] "km/h" CAR
 SG_ FRONT_LEFT : 23|16@0+ (0.01,-67.67) [0|250] "km/h" CAR
 SG_ REAR_RIGHT : 39|16@0+ (0.01,-67.67) [0|250] "km/h" CAR
 SG_ REAR_LEFT : 55|16@0+ (0.01,-67.67) [0|250] "km/h" CAR
"""
# Columns of the decoded speeds.
COLUMNS = {"FRONT_LEFT": 0, "FRONT_RIGHT": 1, "REAR_LEFT": 2, "REAR_RIGHT": 3}
ROBOT = Robot(wheel_radius_m=0.35, tread_m=1.57, max_speed_m_s=60)
ENCODERS = Encoders(
    layout="dbc",
    rate_hz=83,
    dbc=Dbc(file="car.dbc", quantity="speed", speed_unit_m_s=1 / 3.6),
    left=Left(message="WHEEL_SPEEDS", signal="REAR_LEFT"),
    right=Right(message="WHEEL_SPEEDS", signal="REAR_RIGHT"),
)
FRONT = replace(
    ENCODERS,
    left=Left(message="WHEEL_SPEEDS", signal="FRONT_LEFT"),
    right=Right(message="WHEEL_SPEEDS", signal="FRONT_RIGHT"),
)


@pytest.fixture(scope="module")
def frames() -> list[CanFrame]:
    """Every frame of the bus, whatever its identifier."""
    if not RECORDING.exists():
        pytest.skip(f"the recording {RECORDING.name} is not here")
    with np.load(RECORDING) as recording:
        t_s, bus, can_id, data = (recording[f"CAN__raw_can__{key}"] for key in ("t", "src", "address", "data"))
    taken = []
    for k in np.flatnonzero(bus == 0):
        # numpy's S8 drops the trailing zero bytes of a frame, so a wheel speed's length has to be put back.
        length = WHEEL_SPEEDS_BYTES if can_id[k] == WHEEL_SPEEDS_ID else 0
        taken.append(CanFrame(round(t_s[k] * NS_PER_S), int(can_id[k]), False, data[k].ljust(length, b"\0")))
    return taken


@pytest.fixture(scope="module")
def speeds() -> tuple[np.ndarray, np.ndarray]:
    """Times in s and decoded speeds in m/s, columns as in COLUMNS."""
    if not RECORDING.exists():
        pytest.skip(f"the recording {RECORDING.name} is not here")
    with np.load(RECORDING) as recording:
        return recording["CAN__wheel_speed__t"], recording["CAN__wheel_speed__value"]


@pytest.fixture
def base(tmp_path: Path) -> Path:
    (tmp_path / "car.dbc").write_text(TEXT)
    return tmp_path


@pytest.mark.parametrize("encoders", [ENCODERS, FRONT])
def test_every_frame_decodes_to_the_published_speeds(
    encoders: Encoders, frames: list[CanFrame], speeds: tuple[np.ndarray, np.ndarray], base: Path
) -> None:
    layout = make_layout(encoders, base)
    pairs = [pair for frame in frames if (pair := layout.decode(frame))]
    decoded = np.array([[r.value for r in pair if isinstance(r, WheelReading)] for pair in pairs])
    columns = [COLUMNS[str(wheel.signal)] for wheel in (encoders.left, encoders.right)]
    assert decoded.shape == (4974, 2)
    np.testing.assert_allclose(decoded, speeds[1][:, columns], atol=1e-9)


def test_a_minute_of_the_bus_becomes_one_sample_per_frame_with_the_speeds_integral(
    frames: list[CanFrame], speeds: tuple[np.ndarray, np.ndarray], base: Path
) -> None:
    stream = EncoderStream(ENCODERS, ROBOT, base)
    samples: list[WheelSample] = [sample for frame in frames for sample in stream.feed(frame)]
    t_s, values = speeds
    # The first frame is the baseline. Frames follow each other within 0.2 to 26 ms, none of which is a jump.
    assert len(samples) == 4974 - 1
    assert [s.t_ns for s in samples] == [round(t * NS_PER_S) for t in t_s[1:]]
    for side, told_m in (
        (Side.LEFT, np.array([s.left_m for s in samples])),
        (Side.RIGHT, np.array([s.right_m for s in samples])),
    ):
        speed_m_s = values[:, COLUMNS[f"REAR_{side.name}"]]
        expected_m = np.diff(t_s) * 0.5 * (speed_m_s[1:] + speed_m_s[:-1])
        np.testing.assert_allclose(told_m, expected_m, atol=1e-7)
    assert sum(s.lost_s for s in samples) == 0.0
    counters = stream.counters
    assert counters["frames"] == len(frames)
    assert counters["foreign"] == len(frames) - 4974
    assert {key for key, count in counters.items() if count} == {"frames", "foreign", "samples"}
