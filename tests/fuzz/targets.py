"""What the fuzzer feeds: one function for each parser. Each may raise nothing; a false assertion is a finding too."""

import atexit
import math
import os
import shutil
import struct
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from functools import cache
from io import BytesIO
from itertools import pairwise
from pathlib import Path
from typing import Final

from fuzz.fleet_targets import labels, store
from fuzz.query_targets import query
from fuzz.web_targets import web_message, web_request
from mcap.writer import Writer

from drd.config.file import load_config
from drd.config.keys import Config, Encoders
from drd.config.schema import ConfigError, loads
from drd.effects.model import load_model
from drd.encoders.stream import EncoderStream
from drd.estimation.calibration import load_calibration
from drd.fog import make_protocol
from drd.fog.dsp17xx import BODY, HEADER, crc32_mpeg2
from drd.fog.stream import FogStream
from drd.output import forms
from drd.output.messages import Refused, decode_request
from drd.pipeline import Pipeline
from drd.ports.can_errors import problems, state_after
from drd.recording.in_force import IN_FORCE
from drd.recording.topics import CHANNELS
from drd.samples import CanFrame, GyroSample
from drd.state.saved import VERSION, decoded, encoded
from drd.state.sealed import StateError, sealed
from drd_tools.recordings.daemon_log import read_daemon_log
from drd_tools.recordings.folder import read_recording
from drd_tools.recordings.mcap_file import open_mcap
from drd_tools.replay.mcap_source import replay_mcap

ROBOT: Final = "robot: {name: fuzz, wheel_radius_m: 0.11, tread_m: 0.6}\n"
COUNTS: Final = "counts_per_revolution: 20000, "
DBC_KEYS: Final = COUNTS + "layout: dbc, dbc: {file: robot.dbc}, left: {message: W, signal: L}, "
FOGS: Final[dict[str, tuple[str, ...]]] = {
    "ecore": ("", "ecore: {status_mask: 255, status_good: 1}", "ecore: {status_byte: 0, temperature_byte: 0}"),
    "dsp3000": ("", "dsp3000: {mode: incremental}", "dsp3000: {mode: integrated}"),
    "dsp17xx": ("", "dsp17xx: {rotation: rate, angle_unit: degrees}", "axis: x, rate_hz: 1000"),
}
LAYOUTS: Final = (
    COUNTS + "cia406: {start_nodes: true}",
    COUNTS + "cia406: {byte_offset: 3, byte_length: 2}, modulus_counts: 65536",
    "layout: agilex",
    "layout: odrive",
    COUNTS + "layout: odrive, odrive: {message: counts}",
    "layout: vesc",
    DBC_KEYS + "right: {message: W, signal: R}",
    "layout: dbc, dbc: {file: robot.dbc, quantity: speed}, left: {message: W, signal: V}, "
    "right: {message: M, signal: B}",
)
DBC: Final = """VERSION ""
BU_: R
BO_ 256 W: 8 R
 SG_ L : 0|16@1+ (1,0) [0|0] "" R
 SG_ R : 16|16@1- (1,0) [0|0] "" R
 SG_ V : 39|32@0- (0.01,0) [0|0] "" R
BO_ 513 M: 8 R
 SG_ S M : 0|8@1+ (1,0) [0|0] "" R
 SG_ B m1 : 8|32@1- (1,0) [0|0] "" R
SIG_VALTYPE_ 256 V : 1;
SIG_VALTYPE_ 513 B : 1;
"""
# A frame of the fuzzer's: milliseconds after the last one, which identifier, length, data.
FRAME: Final = struct.Struct("<HBB8s")
CUT: Final = b"\n=====\n"
FOLDER_FILES: Final = ("robot.yaml", "encoders.csv", "fog.csv", "reference.csv")


@contextmanager
def _folder(**files: bytes) -> Iterator[Path]:
    """A folder with these files; a dot in a name is written as two underscores."""
    path = _scratch(os.getpid())
    made = [path / name.replace("__", ".") for name in files]
    for file, data in zip(made, files.values(), strict=True):
        file.write_bytes(data)
    try:
        yield path
    finally:
        for file in made:
            file.unlink()


@cache
def _scratch(_: int) -> Path:
    """One folder for as long as this process lasts: making one for each input takes longer than to parse it."""
    path = Path(tempfile.mkdtemp(prefix="drd-fuzz-"))
    atexit.register(shutil.rmtree, path, ignore_errors=True)
    return path


@cache
def _config(text: str) -> Config:
    return loads(ROBOT + text, Config).value


@cache
def _dbc_folder() -> Path:
    """Lasts as long as the process: reading the file again for each input would take all the time."""
    path = Path(tempfile.mkdtemp(prefix="drd-fuzz-"))
    (path / "robot.dbc").write_text(DBC)
    return path


def _fog(protocol: str, data: bytes) -> None:
    """Bytes 0 to 2: the configuration, how many bytes come at once, and how much later each time."""
    if len(data) < 3:
        return
    keys = FOGS[protocol][data[0] % len(FOGS[protocol])]
    config = _config(f"fog: {{protocol: {protocol}, {keys}}}")
    step, later_ns, data = 1 + data[1] % 64, data[2] * 1_000_000, data[3:]
    parser, whole = make_protocol(config.fog), make_protocol(config.fog)
    stream = FogStream(config.fog, math.radians(config.robot.max_acceleration_deg_s2))
    samples: list[GyroSample] = []
    parts = [data[i : i + step] for i in range(0, len(data), step)]
    readings = [reading for part in parts for reading in parser.feed(part)]
    # repr: a temperature may be NaN.
    assert repr(readings) == repr(whole.feed(data))
    assert parser.counters == whole.counters
    for number, part in enumerate(parts, 1):
        samples += stream.feed(part, 1_000_000_000 + number * later_ns)
    _check(samples)
    assert all(count >= 0 for count in stream.counters.values())
    assert stream.counters["samples"] == len(samples)
    stream.restart()


def _check(samples: list[GyroSample]) -> None:
    assert all(math.isfinite(s.rate_rad_s) and s.interval_s > 0.0 for s in samples)
    assert all(a.t_ns < b.t_ns for a, b in pairwise(samples))


def fog_ecore(data: bytes) -> None:
    """KVH E-Core, 8 bytes of 7 bits."""
    _fog("ecore", data)


def fog_dsp3000(data: bytes) -> None:
    """KVH DSP-3000, lines of text."""
    _fog("dsp3000", data)


def fog_dsp17xx(data: bytes) -> None:
    """KVH DSP-17xx; the second half of the configurations gets packets whose CRC the fuzzer need not guess."""
    if data[:1] >= b"\x80":
        size = BODY.size - len(HEADER)
        bodies = [HEADER + data[i : i + size] for i in range(3, len(data) - size + 1, size)]
        data = data[:3] + b"".join(body + crc32_mpeg2(body) for body in bodies)
    _fog("dsp17xx", data)


def can(data: bytes) -> None:
    """CAN frames in all layouts: byte 0 chooses, then 12 bytes a frame (see FRAME); error frames too."""
    if not data:
        return
    config = _config(f"encoders: {{{LAYOUTS[data[0] % len(LAYOUTS)]}}}")
    stream = EncoderStream(config.encoders, config.robot, _dbc_folder())
    ids = [*stream.can_ids, (0x701, False), (0x702, False), (0x7FF, False)]
    t_ns, ends_ns, state = 1, [0], None
    for later_ms, choice, length, content in FRAME.iter_unpack(
        data[1 : 1 + (len(data) - 1) // FRAME.size * FRAME.size]
    ):
        t_ns += later_ms * 1_000_000
        can_id, extended = ids[choice % len(ids)]
        frame = CanFrame(t_ns, can_id, extended, content[: length % 9])
        for sample in stream.feed(frame):
            assert all(map(math.isfinite, sample))
            assert sample.interval_s > 0.0
            assert sample.lost_s >= 0.0
            ends_ns.append(sample.t_ns)
        assert len(stream.take_replies()) <= 16
        state = state_after(problems(int.from_bytes(content[:4], "little"), frame.data), state)
    assert all(a < b for a, b in pairwise(ends_ns))
    assert all(count >= 0 for count in stream.counters.values())


def dbc(data: bytes) -> None:
    """A DBC file, and frames of the identifiers that it names."""
    encoders: Encoders = _config(f"encoders: {{{DBC_KEYS} right: {{message: W, signal: R}}}}").encoders
    robot = _config("").robot
    for quantity in ("counts", "speed"):
        wanted = replace(encoders, dbc=replace(encoders.dbc, quantity=quantity))
        with _folder(robot__dbc=data) as folder, suppress(ConfigError):
            stream = EncoderStream(wanted, robot, folder)
            for number, (can_id, extended) in enumerate(stream.can_ids * 3, 1):
                for content in (b"", b"\xff" * 8, bytes(range(number, number + 64))):
                    stream.feed(CanFrame(number * 50_000_000, can_id, extended, content))


def calibration(data: bytes) -> None:
    """A calibration file, and what it makes of rates and temperatures."""
    with _folder(c__yaml=data) as folder, suppress(ConfigError):
        found = load_calibration(folder / "c.yaml")
        for rate in (0.0, -0.3, 2.0):
            for temperature_c in (20.0, math.nan, -60.0):
                found.correct(GyroSample(1, 0.1, rate, temperature_c))


def model(data: bytes) -> None:
    """A model file, and a pipeline that takes its effects off."""
    with _folder(m__yaml=data) as folder, suppress(ConfigError):
        load_model(folder / "m.yaml").holds_in("run")
        config = _config(f"model: {{file: m.yaml}}\nencoders: {{{COUNTS}}}")
        Pipeline(config, folder, lambda *_: None, recording="run")


def config(data: bytes) -> None:
    """A configuration file, and the pipeline that it asks for unless it names further files."""
    with _folder(robot__yaml=data) as folder, suppress(ConfigError):
        found = load_config(folder / "robot.yaml").value
        if found.calibration.file is found.model.file is found.encoders.dbc.file is None:
            Pipeline(found, folder, lambda *_: None).tick(1)


def folder(data: bytes) -> None:
    """A recording folder: its four files, separated by CUT; an empty one is not there."""
    files = {name.replace(".", "__"): part for name, part in zip(FOLDER_FILES, data.split(CUT), strict=False) if part}
    with _folder(**files) as path, suppress(ConfigError):
        found = read_recording(path)
        if found.wheels is not None:
            found.wheel_angles_rad()


def _read_mcap(data: bytes) -> None:
    with _folder(run_001__mcap=data) as path:
        file = path / "run_001.mcap"
        with suppress(ConfigError):
            found = open_mcap(file)
            assert found.sentence()
            assert all(0 <= recorded.number < 1 << 32 for recorded in found.messages())
        for read in (read_daemon_log, replay_mcap):
            with suppress(ConfigError):
                read(file)


def mcap(data: bytes) -> None:
    """The bytes of an MCAP file."""
    _read_mcap(data)


def mcap_messages(data: bytes) -> None:
    """A whole MCAP file with any messages: each line a topic's number and a payload, after a configuration and CUT."""
    text, _, lines = data.partition(CUT)
    stream = BytesIO()
    writer = Writer(stream)
    writer.start()
    writer.add_attachment(0, 0, IN_FORCE, "text/plain", text or f"{ROBOT}encoders: {{{COUNTS}}}\n".encode())
    schema = writer.register_schema("any", "jsonschema", b"{}")
    channels = [writer.register_channel(c.topic, "json", schema) for c in CHANNELS]
    for number, line in enumerate(lines.splitlines()):
        writer.add_message(channels[line[0] % len(channels)] if line else channels[0], number, line[1:], number, number)
    writer.add_metadata("drd", {"part": "1"})
    writer.finish()  # type: ignore[no-untyped-call]
    _read_mcap(stream.getvalue())


def state(data: bytes) -> None:
    """A state file; then its body under a head that fits, since no fuzzer guesses a SHA-256."""
    head, _, rest = data.partition(b"\n")
    body = rest if head.startswith(b"drd-state/") else data
    for found in (data, sealed("state", VERSION, body)):
        with suppress(StateError):
            assert decoded(encoded(decoded(found))).estimate.plain() == decoded(found).estimate.plain()


def request(data: bytes) -> None:
    """The payload of a query over Zenoh."""
    with suppress(Refused):
        assert isinstance(decode_request(data), dict)


def pose_request(data: bytes) -> None:
    """The request of ROS 2's set_pose, CDR."""
    with suppress(Refused):
        made = forms.pose_request(data, "odom")
        assert made["sigma_m"] >= 0.0
        assert made["sigma_rad"] >= 0.0
        assert abs(made["heading_rad"]) <= math.pi


TARGETS: Final[dict[str, Callable[[bytes], None]]] = {
    target.__name__: target
    for target in (fog_ecore, fog_dsp3000, fog_dsp17xx, can, dbc, calibration, model, config, folder, mcap,
                   mcap_messages, state, request, pose_request, query, web_request, web_message, labels, store)
}  # fmt: skip
