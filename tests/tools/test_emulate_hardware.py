import itertools
import math
import os
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import can
import numpy as np
import pytest
import serial
from perfect_hardware import PERFECT

from drd.config.keys import Config
from drd.config.schema import ConfigError, loads
from drd.encoders.cia406 import Cia406
from drd.fog.ecore import EcoreParser
from drd.fog.stream import FogStream
from drd.samples import CanFrame, FogReading, GyroSample, Side, WheelReading
from drd.units import RAD_PER_DEG
from drd_tools.emulate.hardware import Emulator
from drd_tools.emulate.sensors import SensorErrors
from drd_tools.simulate.missions import Drive
from drd_tools.simulate.route import STEP_S, Steps

PATIENCE_S = 20.0
# 1 m/s ahead and 0.5 rad/s to the left, for 20 s.
CIRCLE = Drive(Steps(np.full(10_000, STEP_S), np.full(10_000, 0.5 * STEP_S)), 0)
RATE_LSB_RAD_S = 100 / 32768 * RAD_PER_DEG
NEXT_CHANNEL = itertools.count()


def make_config(port: Path, interface: str, channel: str, **changes: str) -> Config:
    lines = {"fog": "", "encoders": "counts_per_revolution: 1000, layout: cia406"} | changes
    return loads(
        f"""
        robot: {{wheel_radius_m: 0.1, tread_m: 0.6}}
        fog: {{port: "{port}", ecore: {{status_mask: 1}}, {lines["fog"]}}}
        encoders: {{interface: {interface}, channel: "{channel}", {lines["encoders"]}}}
        """,
        Config,
    ).value


def open_descriptors() -> int:
    return len(os.listdir("/proc/self/fd"))  # noqa: PTH208  # no Path is wanted


class Bench:
    """An emulator in simulated time and what a daemon receives from it."""

    def __init__(self, folder: Path, config: Config, drive: Drive = CIRCLE):
        self.config = config
        self.emulator = Emulator(config, folder, drive, PERFECT)
        self.parser = EcoreParser(self.config.fog)
        self.packets_read = 0
        self.bus = can.Bus(interface="virtual", channel=config.encoders.channel, ignore_config=True)
        self.emulator.plug_in()
        self.port = serial.Serial(str(folder / "fog"), 9600, timeout=0)
        self.until(0.0)
        self.booted = self.ids()

    def close(self) -> None:
        self.port.close()
        self.bus.shutdown()
        self.emulator.stop()

    def until(self, now_s: float) -> None:
        self.emulator.step(now_s + 1e-6)

    def packets(self, length: int = 8) -> bytes:
        """All that the gyro sent since; the kernel hands it over a little later than it was written."""
        expected = (self.emulator.counters["fog_packets"] - self.packets_read) * length
        self.packets_read = self.emulator.counters["fog_packets"]
        data, give_up = bytes(self.port.read(65536)), time.monotonic() + PATIENCE_S
        while len(data) < expected:
            assert time.monotonic() < give_up, "packets are missing"
            data += self.port.read(65536)
        return data

    def readings(self) -> list[FogReading]:
        return self.parser.feed(self.packets())

    def frames(self) -> list[can.Message]:
        return list(iter(lambda: self.bus.recv(0), None))

    def ids(self) -> list[int]:
        return [frame.arbitration_id for frame in self.frames()]

    def counts(self) -> dict[Side, list[float]]:
        """What each counter said, one after the other."""
        layout, counts = Cia406(self.config.encoders, Path()), {side: list[float]() for side in Side}
        for frame in self.frames():
            for reading in layout.decode(CanFrame(0, frame.arbitration_id, False, bytes(frame.data))):
                assert isinstance(reading, WheelReading)
                counts[reading.side].append(reading.value)
        return counts


@pytest.fixture
def make_bench(tmp_path: Path) -> Iterator[Callable[..., Bench]]:
    made: list[Bench] = []

    def make(**changes: str) -> Bench:
        channel = f"bench {next(NEXT_CHANNEL)}"
        made.append(Bench(tmp_path, make_config(tmp_path / "fog", "virtual", channel, **changes)))
        return made[-1]

    yield make
    for bench in made:
        bench.close()


@pytest.fixture
def bench(make_bench: Callable[..., Bench]) -> Bench:
    return make_bench()


def expected_counts(travel_m: float) -> int:
    return math.floor(travel_m / (2 * math.pi * 0.1) * 1000) % 2**32


def test_the_gyro_reports_the_turn_in_its_own_sign_with_its_temperature(bench: Bench) -> None:
    bench.until(1.0)
    readings = bench.readings()
    assert len(readings) == 10
    for reading in readings:
        assert reading.value == pytest.approx(-0.5, abs=RATE_LSB_RAD_S)
        assert reading.temperature_c == pytest.approx(22.0, abs=0.01)
        assert reading.valid


def test_each_packet_holds_the_mean_rate_of_its_own_interval(tmp_path: Path) -> None:
    config = make_config(tmp_path / "fog", "virtual", "mean rate")
    spinning_up = Drive(Steps(np.zeros(1000), np.linspace(0.0, 1.0, 2001)[1::2] * STEP_S), 0)  # 0.5 rad/s^2
    bench = Bench(tmp_path, config, spinning_up)
    bench.until(1.0)
    means = [reading.value for reading in bench.readings()]
    bench.close()
    assert means == pytest.approx([-0.5 * (0.1 * k - 0.05) for k in range(1, 11)], abs=RATE_LSB_RAD_S)


def test_the_wheels_report_what_the_truth_says_they_counted(bench: Bench) -> None:
    bench.until(1.0)
    counts, truth = bench.counts(), bench.emulator.truth
    assert counts[Side.LEFT] == [expected_counts(row.left_m) for row in truth]
    assert counts[Side.RIGHT] == [expected_counts(row.right_m) for row in truth]
    assert len(truth) == 20
    for k, row in enumerate(truth, start=1):
        motion = bench.emulator.path.at(0.05 * k)
        assert row.t_ns == bench.emulator.start_ns + k * 50_000_000
        assert row[1:4] == pytest.approx(motion[:3], abs=1e-9)
        assert (row.left_m, row.right_m) == pytest.approx((0.05 * k * 0.85, 0.05 * k * 1.15))


def test_the_gyro_keeps_its_own_time(tmp_path: Path) -> None:
    config = make_config(tmp_path / "fog", "virtual", "own time", fog="rate_hz: 50")
    emulator = Emulator(config, tmp_path, CIRCLE, SensorErrors())  # 1 % fast
    emulator.plug_in()
    for tenth in range(101):
        emulator.step(tenth / 10 + 1e-6)
    emulator.stop()
    assert emulator.counters["fog_packets"] + emulator.counters["fog_dropped"] == 505
    assert emulator.counters["can_frames"] == 2 + 400  # boot-up messages and positions


@pytest.mark.parametrize(
    "fog",
    [
        "protocol: ecore",
        "protocol: dsp3000, dsp3000: {mode: rate}",
        "protocol: dsp3000, dsp3000: {mode: integrated}",
        "protocol: dsp17xx",
        "protocol: ecore, positive: counterclockwise, rate_hz: 50",
    ],
)
def test_the_daemons_gyro_stream_gets_the_heading_from_every_protocol(tmp_path: Path, fog: str) -> None:
    config = make_config(tmp_path / "fog", "virtual", "protocols", fog=fog)
    slow_clock = replace(PERFECT, clock_error_percent=-1.0)
    emulator, stream = Emulator(config, tmp_path, CIRCLE, slow_clock), FogStream(config.fog, 10.0)
    emulator.plug_in()
    samples, now_s, give_up = list[GyroSample](), 0.0, time.monotonic() + PATIENCE_S
    with serial.Serial(config.fog.port, 9600, timeout=0) as port:
        while now_s < 15.0:
            due_s = emulator.step(now_s)
            while stream.counters["frames"] < emulator.counters["fog_packets"]:
                assert time.monotonic() < give_up, "packets are missing"
                samples += stream.feed(port.read(999), round(now_s * 1e9))
            now_s = due_s
    emulator.stop()
    assert stream.counters["lost_packets"] == 0
    turned_rad = sum(sample.rate_rad_s * sample.interval_s for sample in samples)
    watched_s = (samples[-1].t_ns - samples[0].t_ns) * 1e-9 + samples[0].interval_s
    assert watched_s > 14.8
    assert turned_rad == pytest.approx(0.5 * watched_s, rel=1e-3)
    assert stream.rate_hz == pytest.approx(0.99 * config.fog.rate_hz, rel=1e-3)


def test_latency_delays_what_was_sampled_before(make_bench: Callable[..., Bench]) -> None:
    bench = make_bench(fog="latency_s: 0.03", encoders="latency_s: 0.02, counts_per_revolution: 1000, layout: cia406")
    bench.until(0.069)
    assert (len(bench.readings()), bench.ids()) == (0, [])
    assert bench.emulator.step(0.0701) == pytest.approx(0.12)
    assert bench.counts() == {side: [expected_counts(m)] for side, m in ((Side.LEFT, 0.0425), (Side.RIGHT, 0.0575))}
    bench.until(0.129)
    assert bench.readings() == []
    bench.until(0.13)
    assert len(bench.readings()) == 1


def test_a_silent_gyro_sends_nothing_until_it_speaks_again(bench: Bench) -> None:
    bench.emulator.fog_silent = True
    bench.until(1.0)
    assert bench.packets() == b""
    bench.emulator.fog_silent = False
    bench.until(2.0)
    assert len(bench.readings()) == 10
    assert bench.emulator.counters["fog_packets"] == 10


def test_garbage_comes_before_each_packet(bench: Bench) -> None:
    bench.emulator.fog_garbage = b"noise"
    bench.until(1.0)
    data = bench.packets(length=8 + 5)
    assert data.count(b"noise") == 10
    assert data.startswith(b"noise")
    assert len(bench.parser.feed(data)) == 10
    assert bench.parser.counters["foreign_bytes"] == 50


def test_each_nth_packet_is_missing(bench: Bench) -> None:
    bench.emulator.fog_drop_every = 5
    bench.until(2.0)
    assert len(bench.readings()) == 16


def test_each_nth_packet_has_one_wrong_bit(bench: Bench) -> None:
    bench.until(0.5)
    clean = bench.packets()
    bench.emulator.fog_corrupt_every = 2
    bench.until(1.5)
    data = bench.packets()
    packets = [data[i : i + 8] for i in range(0, 80, 8)]
    wrong_bits = [sum((a ^ b).bit_count() for a, b in zip(packet, clean[:8], strict=True)) for packet in packets]
    assert wrong_bits == [1, 0] * 5


def test_the_gyro_can_declare_its_packets_invalid(bench: Bench) -> None:
    bench.emulator.fog_invalid = True
    bench.until(0.3)
    bench.emulator.fog_invalid = False
    bench.until(0.5)
    assert [reading.valid for reading in bench.readings()] == [False] * 3 + [True] * 2


def test_the_gyros_bias_can_jump(bench: Bench) -> None:
    bench.emulator.fog_offset_deg_s = 1.0
    bench.until(0.1)
    assert bench.readings()[0].value == pytest.approx(-0.5 - RAD_PER_DEG, abs=RATE_LSB_RAD_S)


def test_wheels_can_fall_silent_together_and_singly_and_count_on(bench: Bench) -> None:
    emulator = bench.emulator
    emulator.left_silent = True
    bench.until(0.1)
    assert bench.ids() == [0x182, 0x182]
    emulator.left_silent, emulator.right_silent = False, True
    bench.until(0.2)
    assert bench.ids() == [0x181, 0x181]
    emulator.right_silent, emulator.wheels_silent = False, True
    bench.until(0.3)
    assert bench.ids() == []
    emulator.wheels_silent = False
    bench.until(0.35)
    assert bench.counts()[Side.LEFT] == [expected_counts(0.85 * 0.35)]


def test_one_frame_for_both_wheels_knows_no_silent_side(make_bench: Callable[..., Bench]) -> None:
    bench = make_bench(encoders="layout: agilex")
    bench.emulator.left_silent = True
    bench.until(0.1)
    assert bench.ids() == [0x311, 0x311]


def test_each_nth_pair_is_missing(bench: Bench) -> None:
    bench.emulator.wheels_drop_every = 4
    bench.until(1.0)
    assert len(bench.ids()) == 2 * 15


def test_the_right_wheel_can_come_first(bench: Bench) -> None:
    bench.until(0.05)
    bench.emulator.swap_frames = True
    bench.until(0.1)
    assert bench.ids() == [0x181, 0x182, 0x182, 0x181]


def test_counters_jump_when_they_are_preset(bench: Bench) -> None:
    bench.emulator.count_offset_m = -100.0
    bench.until(0.05)
    assert bench.counts() == {
        side: [expected_counts(m - 100)] for side, m in ((Side.LEFT, 0.0425), (Side.RIGHT, 0.0575))
    }


def test_a_slipping_wheel_counts_too_much_and_a_stuck_counter_nothing(bench: Bench) -> None:
    bench.emulator.left_slip, bench.emulator.right_slip = 1.0, -1.0
    bench.until(1.0)
    last = bench.emulator.truth[-1]
    assert (last.left_m, last.right_m) == pytest.approx((1.7, 0.0))
    assert last.x_m == pytest.approx(bench.emulator.path.at(1.0).x_m)
    assert set(bench.counts()[Side.RIGHT]) == {0}


def test_speed_layouts_get_the_speed_of_each_period(make_bench: Callable[..., Bench]) -> None:
    bench = make_bench(encoders="layout: odrive")
    bench.until(0.2)
    left_turns_s, right_turns_s = (np.frombuffer(frame.data, "<f4")[1] for frame in bench.frames()[-2:])
    per_turn_m = 2 * math.pi * 0.1
    assert (left_turns_s, right_turns_s) == pytest.approx((0.85 / per_turn_m, 1.15 / per_turn_m), rel=1e-5)


def test_frames_of_others_are_seen(bench: Bench) -> None:
    bench.bus.send(can.Message(arbitration_id=0x080, is_extended_id=False))
    bench.emulator.step(0.0)
    assert [frame.arbitration_id for frame in bench.emulator.received] == [0x080]
    assert bench.emulator.counters["can_received"] == 1


def test_the_same_seed_gives_the_same_bytes(tmp_path: Path) -> None:
    def first_bytes(seed: int) -> bytes:
        emulator = Emulator(make_config(tmp_path / "fog", "virtual", "seeds"), tmp_path, CIRCLE, seed=seed)
        emulator.fog_corrupt_every = 3
        emulator.plug_in()
        with serial.Serial(str(tmp_path / "fog"), 9600, timeout=0) as port:
            emulator.step(5.0)
            data, give_up = b"", time.monotonic() + PATIENCE_S
            while len(data) < 8 * 50 and time.monotonic() < give_up:
                data += port.read(65536)
        emulator.stop()
        return data

    assert len(first_bytes(1)) == 8 * 50
    assert first_bytes(1) == first_bytes(1)
    assert first_bytes(1) != first_bytes(2)


def test_a_robot_without_gyro_has_only_wheels(tmp_path: Path) -> None:
    config = make_config(tmp_path / "fog", "virtual", "no gyro", fog="protocol: none")
    with Emulator(config, tmp_path, CIRCLE) as emulator:
        assert emulator.places == {"FOG": "none", "CAN": "virtual no gyro"}
        assert list(tmp_path.iterdir()) == []
        emulator.unplug_fog()
        emulator.replug_fog()


def eventually(holds: Callable[[], object]) -> None:
    give_up = time.monotonic() + PATIENCE_S
    while not holds():
        assert time.monotonic() < give_up, "it never became true"
        time.sleep(0.002)


def test_in_real_time_a_serial_port_and_an_slcan_bus_read_both_sensors(tmp_path: Path) -> None:
    config = make_config(
        tmp_path / "fog",
        "slcan",
        str(tmp_path / "can"),
        fog="rate_hz: 100",
        encoders="rate_hz: 100, counts_per_revolution: 1000, layout: cia406",
    )
    parser, readings, counts = EcoreParser(config.fog), list[FogReading](), list[int]()
    with Emulator(config, tmp_path, CIRCLE, PERFECT) as emulator:
        assert emulator.is_running
        with (
            serial.Serial(config.fog.port, 9600, timeout=0, exclusive=True) as port,
            can.Bus(interface="slcan", channel=config.encoders.channel, sleep_after_open=0, ignore_config=True) as bus,
        ):

            def enough() -> bool:
                readings.extend(parser.feed(port.read(65536)))
                frame = bus.recv(0)
                if frame is not None and frame.arbitration_id == 0x181:
                    counts.append(int.from_bytes(frame.data, "little"))
                return len(readings) >= 30 and len(counts) >= 30

            eventually(enough)
    assert [reading.value for reading in readings] == pytest.approx([-0.5] * len(readings), abs=RATE_LSB_RAD_S)
    said = [expected_counts(row.left_m) for row in emulator.truth]
    first = said.index(counts[0])
    assert counts == said[first : first + len(counts)]
    assert emulator.counters["can_frames"] >= 60
    elapsed_s = (time.monotonic_ns() - emulator.start_ns) * 1e-9
    assert 30 <= len(emulator.truth) <= 100 * elapsed_s


def test_without_readers_everything_is_dropped_and_counted_and_time_goes_on(tmp_path: Path) -> None:
    config = make_config(
        tmp_path / "fog",
        "slcan",
        str(tmp_path / "can"),
        fog="rate_hz: 2000, protocol: ecore",
        encoders="rate_hz: 1000, counts_per_revolution: 1000, layout: cia406",
    )
    with Emulator(config, tmp_path, CIRCLE) as emulator:
        emulator.fog_garbage = bytes(1000)
        eventually(lambda: emulator.counters["fog_dropped"] > 20 and emulator.counters["can_dropped"] > 20)
        assert emulator.counters["can_frames"] == 0
        assert emulator.is_running


def read_until_hang_up(port: serial.Serial) -> None:
    for _ in range(int(PATIENCE_S)):
        port.read(65536)


def test_unplugging_is_a_hang_up_and_replugging_a_new_device_behind_the_same_name(tmp_path: Path) -> None:
    config = make_config(tmp_path / "fog", "slcan", str(tmp_path / "can"), fog="rate_hz: 100")
    with Emulator(config, tmp_path, CIRCLE) as emulator:
        for path, unplug, replug in (
            (tmp_path / "fog", emulator.unplug_fog, emulator.replug_fog),
            (tmp_path / "can", emulator.unplug_can, emulator.replug_can),
        ):
            with serial.Serial(str(path), 9600, timeout=1) as port:
                port.write(b"O\r")
                assert port.read(1)
                unplug()
                assert not path.is_symlink()
                with pytest.raises(serial.SerialException):
                    read_until_hang_up(port)
            replug()
            with serial.Serial(str(path), 9600, timeout=PATIENCE_S) as port:
                port.write(b"O\r")
                assert port.read(1)
    assert list(tmp_path.iterdir()) == []


def test_nothing_is_left_behind(tmp_path: Path) -> None:
    config = make_config(tmp_path / "fog", "slcan", str(tmp_path / "can"))
    descriptors, threads = open_descriptors(), threading.active_count()
    for _ in range(3):
        emulator = Emulator(config, tmp_path, CIRCLE)
        assert open_descriptors() == descriptors
        emulator.start()
        assert len(list(tmp_path.iterdir())) == 2
        emulator.stop()
        emulator.stop()
        assert not emulator.is_running
    unused = Emulator(config, tmp_path, CIRCLE)
    unused.stop()
    assert (open_descriptors(), threading.active_count()) == (descriptors, threads)
    assert list(tmp_path.iterdir()) == []


def test_a_start_that_fails_half_way_leaves_nothing_behind(tmp_path: Path) -> None:
    config = make_config(tmp_path / "same", "slcan", str(tmp_path / "same"))
    descriptors = open_descriptors()
    with pytest.raises(ConfigError, match=r"encoders\.channel: .*same"):
        Emulator(config, tmp_path, CIRCLE).start()
    assert open_descriptors() == descriptors
    assert list(tmp_path.iterdir()) == []


def test_a_taken_path_is_refused_before_anything_starts(tmp_path: Path) -> None:
    (tmp_path / "fog").write_text("precious")
    with pytest.raises(ConfigError, match=r"fog\.port: expected a path where nothing is yet"):
        Emulator(make_config(tmp_path / "fog", "virtual", "x"), tmp_path, CIRCLE)
