import json
import math
import random
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, NamedTuple

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from protobuf_messages import message_class
from recorded_drive import drive, recordings
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from drd.config.schema import ConfigError
from drd.recording.file import RecordingFile
from drd.recording.topics import CHANNELS, RAW_EVENTS, Message
from drd.samples import Pose
from drd_tools.recordings.mcap_file import open_mcap, parts_before

START_NS = 1_700_000_000_000_000_000
EPOCH = datetime.fromtimestamp(START_NS * 1e-9, UTC)
PERIOD_NS = 10_000_000


class Written(NamedTuple):
    """A file flushed every second: for each flush its end in the file and the messages up to there."""

    data: bytes
    flushes: list[tuple[int, int]]


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Written:
    path = tmp_path_factory.mktemp("written") / "whole.mcap"
    information = {"flush_s": "1.0", "fsync_s": "5.0", "part": "1"}
    file = RecordingFile(path, information, {"configuration-in-force.yaml": b"robot: {}\n"}, START_NS)
    random_bytes = random.Random(1)
    flushes = [(file.size, 0)]
    for i in range(1, 2001):
        data = json.dumps({"event": "tick", "noise": random_bytes.random()}).encode()
        log_ns = START_NS + i * PERIOD_NS
        file.add(Message(RAW_EVENTS, log_ns, data), i, log_ns, log_ns)
        if i % 100 == 0:
            file.flush()
            flushes.append((file.size, i))
    file.finish({"reason": "stopped", "lost": "0"})
    return Written(path.read_bytes(), flushes)


def test_a_file_cut_at_any_byte_reads_up_to_the_last_flush(written: Written, tmp_path: Path) -> None:
    file = tmp_path / "cut.mcap"
    chosen = random.Random(2)
    edges = [end + by for end, _ in written.flushes for by in (-1, 0, 1, 30)]
    cuts = [chosen.randrange(len(written.data)) for _ in range(200)] + [0, 1, 7, 8, 9, 20, *edges]
    known_losses = 0
    for cut in cuts:
        file.write_bytes(written.data[:cut])
        found = open_mcap(file)
        count = max((messages for end, messages in written.flushes if end <= cut), default=0)
        # Behind a chunk lies its index: it may be cut while the chunk is whole.
        readable = list(found.messages())
        assert len(readable) in (count, count + 100)
        assert [m.number for m in readable] == list(range(1, len(readable) + 1))
        if found.cut_chunk_s is not None:
            known_losses += 1
            assert found.cut_chunk_s == pytest.approx(1.0 if readable else 0.99)
        if readable:
            assert found.last_ns == START_NS + len(readable) * PERIOD_NS
            assert found.seconds == pytest.approx((len(readable) - 1) * 0.01)
            assert found.attachments
            assert "cut: " in found.sentence() or not found.is_cut
        if found.is_cut and found.information:
            assert found.lost_if_killed_s == 1.0
            assert found.lost_if_power_failed_s == 6.0
    assert known_losses > 100


def test_what_a_power_cut_leaves_behind_the_last_chunk_does_no_harm(written: Written, tmp_path: Path) -> None:
    file = tmp_path / "torn.mcap"
    end, count = written.flushes[10]
    chosen = random.Random(3)
    for tail in (bytes(5000), chosen.randbytes(5000), b"\x06" + bytes(8), b"\x06" + b"\xff" * 40, b"\x0f" * 100):
        file.write_bytes(written.data[:end] + tail)
        found = open_mcap(file)
        assert sum(1 for _ in found.messages()) == count
        assert found.is_cut
        assert found.sentence().startswith(f"cut: {found.seconds:.1f} s can be read, until ")
    file.write_bytes(bytes(4096))
    assert open_mcap(file).sentence().startswith("cut: no message can be read")


def test_a_chunk_with_a_wrong_bit_ends_what_is_believed(written: Written, tmp_path: Path) -> None:
    file = tmp_path / "bit.mcap"
    begin, count = written.flushes[4]
    damaged = bytearray(written.data)
    damaged[begin + 200] ^= 0x10
    file.write_bytes(damaged)
    found = open_mcap(file)
    assert sum(1 for _ in found.messages()) == count
    assert found.is_cut


@settings(deadline=None, max_examples=60)
@given(changes=st.lists(st.tuples(st.floats(0, 1), st.integers(0, 255)), max_size=5), part=st.floats(0, 1))
def test_no_damage_makes_it_raise(
    written: Written, tmp_path_factory: pytest.TempPathFactory, changes: list[tuple[float, int]], part: float
) -> None:
    file = tmp_path_factory.getbasetemp() / "damaged.mcap"
    damaged = bytearray(written.data)
    for place, value in changes:
        damaged[8 + int(place * (len(damaged) - 9))] = value
    file.write_bytes(damaged[: int(part * len(damaged))])
    found = open_mcap(file)
    assert [m.number for m in found.messages()] == list(range(1, round(found.seconds * 100) + 1 + bool(found.last_ns)))
    assert found.sentence()


def test_a_whole_file_says_so(written: Written, tmp_path: Path) -> None:
    file = tmp_path / "whole.mcap"
    file.write_bytes(written.data)
    found = open_mcap(file)
    assert not found.is_cut
    assert found.lost_if_killed_s == found.lost_if_power_failed_s == 0.0
    assert found.sentence() == f"complete: 20.0 s can be read, until {EPOCH:%Y-%m-%d %H:%M}:40 UTC"


def test_what_is_no_recording_is_refused_with_its_name(tmp_path: Path) -> None:
    file = tmp_path / "notes.mcap"
    file.write_text("time_s,x_m\n")
    with pytest.raises(ConfigError, match=r"notes\.mcap.*expected an MCAP file"):
        open_mcap(file)
    with pytest.raises(ConfigError, match="No such file"):
        open_mcap(tmp_path / "absent.mcap")


def test_the_parts_before_a_part_are_found(tmp_path: Path) -> None:
    for part in (1, 3, 4):
        path = tmp_path / f"bot-20260101T000000Z-00000000-{part:04}.mcap"
        RecordingFile(path, {"part": str(part)}, {}, START_NS).finish({})
    paths, missing = parts_before(open_mcap(tmp_path / "bot-20260101T000000Z-00000000-0004.mcap"))
    assert [path.stem[-4:] for path in paths] == ["0001", "0003"]
    assert missing == [2]


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Any:
    folder = tmp_path_factory.mktemp("recorded")
    d = drive(folder)
    recorder = d.start()
    d.run(10.0)
    assert recorder.close(5.0)
    return d, recordings(folder)[0]


def test_the_index_serves_mcaps_own_reader(recorded: Any) -> None:
    d, path = recorded
    with path.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        summary = reader.get_summary()
        assert summary is not None
        assert {channel.topic for channel in summary.channels.values()} == {c.topic for c in CHANNELS}
        assert summary.statistics is not None
        counts = summary.statistics.channel_message_counts
        numbers = {channel.topic: number for number, channel in summary.channels.items()}
    assert counts[numbers["/drd/pose"]] == len(d.poses)


def test_a_decoder_that_knows_only_the_files_own_schemas_reads_what_viewers_draw(recorded: Any) -> None:
    d, path = recorded
    found: dict[str, list[Any]] = {"/pose": [], "/tf": [], "/scene": []}
    with path.open("rb") as stream:
        for schema, channel, message in make_reader(stream).iter_messages(topics=list(found)):
            assert schema is not None
            assert (schema.encoding, channel.message_encoding) == ("protobuf", "protobuf")
            found[channel.topic].append(message_class(schema.data, schema.name).FromString(message.data))
    assert {name: type(rows[0]).DESCRIPTOR.full_name for name, rows in found.items()} == {
        "/pose": "foxglove.PoseInFrame",
        "/tf": "foxglove.FrameTransform",
        "/scene": "foxglove.SceneUpdate",
    }
    for in_frame, transform, pose in zip(found["/pose"], found["/tf"], d.poses, strict=True):
        assert in_frame.frame_id == transform.parent_frame_id == "odom"
        assert transform.child_frame_id == "base_link"
        assert in_frame.timestamp.ToNanoseconds() == transform.timestamp.ToNanoseconds() == pose.t_ns + START_NS
        for place, turn in (
            (in_frame.pose.position, in_frame.pose.orientation),
            (transform.translation, transform.rotation),
        ):
            assert (place.x, place.y, place.z) == (pose.x_m, pose.y_m, 0.0)
            heading = 2.0 * math.atan2(turn.z, turn.w)
            assert math.remainder(heading - pose.heading_rad, 2.0 * math.pi) == pytest.approx(0.0, abs=1e-12)
    assert [len(update.entities) for update in found["/scene"]] == [2] * len(found["/scene"])


def test_every_json_message_has_what_its_schema_names(recorded: Any) -> None:
    _, path = recorded
    schemas = {c.topic: json.loads(c.schema) for c in CHANNELS if c.encoding == "json"}
    for message in open_mcap(path).messages(*schemas):
        value, schema = message.value(), schemas[message.topic]
        assert schema["properties"].keys() <= value.keys()
        for name, part in schema["properties"].items():
            kinds: dict[str, Any] = {"integer": int, "string": str, "number": (int, float), "array": list}
            assert isinstance(value[name], kinds.get(part["type"], object)), (message.topic, name)


def test_an_independent_reader_opens_it_and_decodes_the_odometry_by_the_files_own_schema(recorded: Any) -> None:
    """pybag has an MCAP reader and a CDR decoder of its own, and no line of drd's or of the mcap package's."""
    pybag = pytest.importorskip("pybag.mcap_reader")
    d, path = recorded
    with pybag.McapFileReader.from_file(path, enable_crc_check=True) as reader:
        assert set(reader.get_topics()) == {channel.topic for channel in CHANNELS}
        assert reader.get_message_count("/pose") == len(d.poses)
        messages = [message.data for message in reader.messages("/odom")]
    # It takes an attachment's sum over its data; the format's is over the whole record, as the mcap package has it.
    with pybag.McapFileReader.from_file(path) as reader:
        assert {a.name for a in reader.get_attachments()} >= {"configuration.yaml", "calibration.yaml"}
    assert_odometry(messages, d.poses)


def test_the_odometrys_schema_is_one_that_rosbags_decodes_it_by(recorded: Any) -> None:
    d, path = recorded
    store = get_typestore(Stores.EMPTY)
    (schema,) = (c.schema.decode() for c in CHANNELS if c.topic == "/odom")
    store.register(get_types_from_msg(schema, "nav_msgs/msg/Odometry"))
    messages = [store.deserialize_cdr(m.data, "nav_msgs/msg/Odometry") for m in open_mcap(path).messages("/odom")]
    assert_odometry(messages, d.poses)


def assert_odometry(messages: Sequence[Any], poses: Sequence[Pose]) -> None:
    assert len(messages) == len(poses)
    for odometry, pose in zip(messages, poses, strict=True):
        assert (odometry.pose.pose.position.x, odometry.pose.pose.position.y) == (pose.x_m, pose.y_m)
        assert odometry.header.stamp.sec * 10**9 + odometry.header.stamp.nanosec == pose.t_ns + START_NS
        assert odometry.pose.covariance[0] == pose.covariance[0]
        assert odometry.twist.twist.angular.z == pose.rate_rad_s
