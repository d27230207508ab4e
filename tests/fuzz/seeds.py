"""Writes the corpus's seeds: `python tests/fuzz/seeds.py`. Findings stand beside them."""

import json
import struct
import sys
from io import BytesIO
from pathlib import Path

import numpy as np
from mcap.writer import CompressionType, Writer

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent))

from fuzz.targets import COUNTS, CUT, DBC, DBC_KEYS, FOGS, FRAME, LAYOUTS, ROBOT, _config, _dbc_folder  # noqa: E402

from drd.encoders.stream import EncoderStream  # noqa: E402
from drd.estimation.basis import basis_of  # noqa: E402
from drd.estimation.estimate import Estimate  # noqa: E402
from drd.estimation.filter import N, Nominal  # noqa: E402
from drd.recording.in_force import IN_FORCE  # noqa: E402
from drd.state.saved import Moment, Saved, encoded  # noqa: E402
from drd_tools.emulate import encoder_frames, fog_packets  # noqa: E402
from drd_tools.replay.mcap_source import SET_POSE  # noqa: E402

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
        encoder = encoder_frames.make_encoder(config.encoders, config.robot, _dbc_folder())
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


def main() -> None:
    found = fogs() | frames() | mcaps() | states()
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
    # A stamp, the frame odom, and a pose with quaternion 0, 0, 0, 1.
    numbers = struct.pack("<43d", *[0.0] * 6, *[1.0] * 37)
    found["pose_request/unit"] = b"\0\1\0\0" + struct.pack("<iII12s", 1, 2, 5, b"odom") + numbers
    for name, data in found.items():
        file = HERE / "corpus" / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(data)


if __name__ == "__main__":
    main()
