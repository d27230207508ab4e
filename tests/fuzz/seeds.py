"""Writes the corpus's seeds: `python tests/fuzz/seeds.py`. Findings stand beside them."""

import json
import struct
import sys
import tempfile
from datetime import UTC, datetime
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from mcap.writer import CompressionType, Writer

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent))

from fuzz.fleet_targets import FILES  # noqa: E402
from fuzz.query_targets import FORMS, POSE  # noqa: E402
from fuzz.targets import COUNTS, CUT, DBC, DBC_KEYS, FOGS, FRAME, LAYOUTS, ROBOT, _config, _dbc_folder  # noqa: E402
from fuzz.web_targets import PAUSE, TOKEN  # noqa: E402

from drd.encoders.stream import EncoderStream  # noqa: E402
from drd.estimation.basis import basis_of  # noqa: E402
from drd.estimation.estimate import Estimate  # noqa: E402
from drd.estimation.state import N, Nominal  # noqa: E402
from drd.output.messages import pose_json  # noqa: E402
from drd.recording.in_force import IN_FORCE  # noqa: E402
from drd.state.saved import Moment, Saved, encoded  # noqa: E402
from drd_tools.emulate import encoder_frames, fog_packets  # noqa: E402
from drd_tools.fleet.schema import FINDINGS, RECORDINGS  # noqa: E402
from drd_tools.fleet.store import Store  # noqa: E402
from drd_tools.replay.mcap_source import SET_POSE  # noqa: E402

MARCH = datetime(2026, 3, 12, 8, 15, tzinfo=UTC)

CALIBRATION = """\
format: drd-gyro-calibration/1
error_deg_s: {a0: [0.1, 0.002, 0], a1: [3e-3, 0, 0], a2: [0, 0, 0], a3: [1.0e-7, 0, 0]}
rate_range_deg_s: [-90, 90]
temperature_range_c: [-10, 50]
residual_deg_s: 0.003
provenance: {who: a test}
"""
MODEL = """\
wheel: {radius_m: 0.11}
effects:
  - effect: gyro_scale_error
    parameters: {k: {value: 0.01, std: 0.001, unit: "1"}}
    seen: {yaw_rate: [-40, 40]}
  - {effect: turn_scrub, parameters: {k: 0.05}}
provenance: {recording: "a, b"}
"""
NOMINAL = """\
name: fuzz
wheel: {radius_m: 0.11, counts_per_revolution: 4096}
tread_m: 0.6
fog: {rate_hz: 10, range_deg_s: 100}
"""
ENCODERS = "time_s,left_counts,right_counts\n0,0,0\n0.05,10,12\n0.1,20,-3\n"
GYRO = "# gyro\ntime_s,rate_deg_s,temperature_c\n0.1,1.5,20\n0.2,-1.5e1,20.5\n"
REFERENCE = "time_s,x_m,y_m,heading_deg\n0,0,0,0\n0.1,0.01,0,1\n"
MESSAGES = (
    (0, {"monotonic_ns": 1000, "data": "gAAAAAAAAAA="}),
    (1, {"frames": [{"monotonic_ns": 2000, "can_id": 385, "extended": False, "data": "AAAAAA=="}]}),
    (2, {"event": "tick", "monotonic_ns": 3000}),
    (2, {"event": "port_state", "monotonic_ns": 4000, "source": "fog.port", "text": None}),
    (2, {"event": "set_pose", "monotonic_ns": 5000, **dict.fromkeys(SET_POSE, 1)}),
    (3, {"monotonic_ns": 6000, "interval_s": 0.1, "rate_rad_s": 0.1, "temperature_c": None}),
    (4, {"monotonic_ns": 7000, "interval_s": 0.05, "left_m": 0.1, "right_m": 0.1, "lost_s": 0.0}),
)  # fmt: skip


def fogs() -> dict[str, bytes]:
    found = {}
    for protocol, variants in FOGS.items():
        for number, keys in enumerate(variants):
            config = _config(f"fog: {{protocol: {protocol}, {keys}}}")
            encoder = fog_packets.make_encoder(config.fog)
            packets = b"".join(encoder.encode(rate, 0.1, 21.0, valid) for rate, valid in ((0.1, True), (-0.2, False)))
            found[f"fog_{protocol}/variant{number}"] = bytes((number, 8, 100)) + packets
    return found


def frames() -> dict[str, bytes]:
    found = {}
    for number, keys in enumerate(LAYOUTS[:-1]):
        config = _config(f"encoders: {{{keys}}}")
        encoder = encoder_frames.WheelFrameEncoder(config.encoders, config.robot, _dbc_folder())
        ids = [can_id for can_id, _ in EncoderStream(config.encoders, config.robot, _dbc_folder()).can_ids]
        data = bytes([number])
        for travel_m in (0.1, 0.15):
            for message in encoder.encode(travel_m, travel_m, 1.0, 1.0):
                data += FRAME.pack(50, ids.index(message.arbitration_id), len(message.data), bytes(message.data))
        found[f"can/layout{number}"] = data
    # A multiplexed message, which the emulator does not send.
    pair = FRAME.pack(50, 0, 8, bytes(8)) + FRAME.pack(0, 1, 8, b"\1\0\0\x80\x3f\0\0\0")
    found["can/multiplexed"] = bytes([len(LAYOUTS) - 1]) + 2 * pair
    return found


def mcaps() -> dict[str, bytes]:
    config = f"{ROBOT}encoders: {{{COUNTS}}}\n".encode()
    lines = [bytes([topic]) + json.dumps(value).encode() for topic, value in MESSAGES]
    found = {"mcap_messages/all": CUT + b"\n".join(lines)}
    for name, compression in (("plain", CompressionType.NONE), ("zstd", CompressionType.ZSTD)):
        stream = BytesIO()
        writer = Writer(stream, compression=compression, use_statistics=False, repeat_channels=False)
        writer.start()
        writer.add_attachment(0, 0, IN_FORCE, "text/plain", config)
        writer.add_metadata("drd", {"flush_s": "1", "part": "2"})
        channel = writer.register_channel("/fog", "json", writer.register_schema("a", "jsonschema", b"{}"))
        writer.add_message(channel, 9, lines[5][1:], 9, 0)
        writer.finish()  # type: ignore[no-untyped-call]
        found[f"mcap/{name}"] = stream.getvalue()
    return found


def states() -> dict[str, bytes]:
    config = _config(f"encoders: {{{COUNTS}}}")
    estimate = Estimate(Nominal(tread_m=0.6), np.eye(N), at_rest=True, lost=False, speed_m_s=0.0, rate_rad_s=0.0)
    return {"state/whole": encoded(Saved(estimate, Moment(1, 2, ""), basis_of(config, None, None, True), "fuzz"))}


def queries() -> dict[str, bytes]:
    pose = b'{"x_m": 1, "y_m": -2.5, "heading_rad": 0, "sigma_m": 1e-3}'
    found = {f"query/{form.name}{number}": bytes([number]) + b"{}" for number, form in enumerate(FORMS)}
    found["query/set_pose"] = bytes([4]) + pose
    found["query/wildcard"] = b"\x85"
    found["query/trigger"] = bytes([0x58]) + bytes(33)
    found["query/service"] = bytes([0x61 | 0x10]) + bytes(33) + unit_pose()
    return found


def requests() -> dict[str, bytes]:
    token = f"?token={TOKEN}"
    upgrade = "Upgrade: websocket\nConnection: Upgrade\nSec-WebSocket-Version: 13\n"
    upgrade += "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\n"
    bearer = f"Host: localhost:8080\nAuthorization: Bearer {TOKEN}\n"
    texts = {
        "page": f"GET /{token} HTTP/1.1\nHost: robot7.local\n\n",
        "script": f"GET /page/page.js HTTP/1.1\nHost: [::1]:8080\nCookie: drd_token_8080={TOKEN}\n\n",
        "metrics": f"GET /metrics HTTP/1.0\n{bearer}Origin: http://localhost:8080\n\n",
        "history": f"GET /history{token} HTTP/1.1\nHost: localhost\n\nGET /none HTTP/1.1\r\n\r\n",
        "command": f"POST /command/set_pose HTTP/1.1\n{bearer}X-Drd: 1\nContent-Length: 2\n\n{{}}",
        "chunks": f"POST /command/reset HTTP/1.1\n{bearer}X-Drd: 1\nTransfer-Encoding: chunked\n\n2\r\n{{}}\r\n0\r\n"
        "\r\n",
        "stream": f"GET /stream{token} HTTP/1.1\nHost: 127.0.0.1\n{upgrade}\n",
    }
    found = {f"web_request/{name}": text.encode() for name, text in texts.items()}
    frames = b"\x81\x82\0\0\0\0hi" + PAUSE + b"\x89\x80\0\0\0\0" + PAUSE + b"\x88\x82\0\0\0\0\x03\xe8"
    found["web_request/stream"] += PAUSE + frames
    return found


def fleets() -> dict[str, bytes]:
    row: dict[str, Any] = dict.fromkeys(RECORDINGS.names) | {
        "recording": "a",
        "robot": "7",
        "uri": "a",
        "start_utc": MARCH,
    }
    finding = dict.fromkeys(FINDINGS.names) | {k: row[k] for k in ("recording", "robot", "start_utc")}
    finding |= {"covariance": [1.0], "value": 0.01}
    with tempfile.TemporaryDirectory() as folder:
        store = Store(folder)
        with store.writing():
            store.put({"recordings": [row], "findings": [finding]})
            store.compact()
            store.keep_maintenance([{"date": MARCH, "robot": "7", "what": "tyres"}])
        kept = {name: store.files.read(name) for name in FILES}
    found = {
        f"store/{name.split('/')[0].split('.')[0]}": bytes([number]) + (kept[name] or b"")
        for number, name in enumerate(FILES)
        if kept[name]
    }
    rows = [{"recordings": [row], "findings": [finding]}]
    for number, each in ((129, rows), (134, [row]), (130, [row]), (131, [finding])):
        found[f"store/rows{number}"] = bytes([number]) + json.dumps(each, default=str).encode()
    rule = "- recordings: ['site/*']\n  robot: 7\n  start_in_name: (?P<year>\\d{4})-(?P<month>\\d\\d)-(?P<day>\\d\\d)\n"
    found["labels/rules"] = b"\x60" + rule.encode()
    found["labels/own"] = b"\xb0robot: 7\nplace: hall\nstart: 2026-03-12T08:15:00+01:00\n"
    found["labels/maintenance"] = b'\x20date,robot,what\n2026-03-12,7,tyres\n2026-03-13T10:00Z,8,"a, b"\n'
    return found


def messages() -> dict[str, bytes]:
    health = b'{"robot": "a", "latency_mean_ms": 1.5, "learned": {"k": {"value": 1, "sigma": 2}},'
    health += b'"counters": {"fog": {"samples": 3}}}'
    return {"web_message/both": b"0" + pose_json(POSE, 10**18) + b"\n1" + health}


def unit_pose() -> bytes:
    """A stamp, the frame odom, and a pose with quaternion 0, 0, 0, 1."""
    numbers = struct.pack("<43d", *[0.0] * 6, *[1.0] * 37)
    return b"\0\1\0\0" + struct.pack("<iII12s", 1, 2, 5, b"odom") + numbers


def main() -> None:
    found = fogs() | frames() | mcaps() | states() | queries() | requests() | fleets() | messages()
    for name, text in {
        "dbc/one": DBC,
        "calibration/whole": CALIBRATION,
        "model/two": MODEL,
        "config/cia406": f"{ROBOT}encoders: {{{COUNTS}}}\nestimation: {{noise: {{timing_s: 2e-3}}}}\n",
        "config/odrive": f"{ROBOT}fog: {{protocol: none}}\nencoders:\n  layout: odrive # a comment\n",
        "config/dbc": f"{ROBOT}encoders: {{{DBC_KEYS}right: {{message: W, signal: R}}}}\n",
        "folder/counts": CUT.decode().join((NOMINAL, ENCODERS, GYRO, REFERENCE)),
        "folder/gyro": CUT.decode().join((NOMINAL, "", GYRO)),
        "request/pose": '{"x_m": 1, "sigma_m": 1e-3}',
    }.items():
        found[name] = text.encode()
    found["pose_request/unit"] = unit_pose()
    for name, data in found.items():
        file = HERE / "corpus" / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(data)


if __name__ == "__main__":
    main()
