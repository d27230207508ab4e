from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drd.config.keys import Dsp17xx, Dsp3000, Ecore, Fog
from drd.fog import make_protocol
from drd.fog.stream import FogStream
from drd.samples import GyroSample
from drd.units import NS_PER_S, RAD_PER_DEG
from drd_tools.emulate.fog_packets import make_encoder

START_NS = 5_000 * NS_PER_S
GENTLE_RAD_S2 = 500 * RAD_PER_DEG
ANY_RAD_S2 = 1e9
STATUS = Ecore(status_byte=1, status_mask=0x80, status_good=0x80)


class Gyro:
    """A gyro and the stream that reads it; every packet arrives when its measuring interval ends."""

    def __init__(self, fog: Fog, max_acceleration_rad_s2: float = ANY_RAD_S2, true_hz: float | None = None):
        self.stream = FogStream(fog, max_acceleration_rad_s2)
        self.encoder = make_encoder(fog)
        self.period_s = 1 / (true_hz or fog.rate_hz)
        self.beats = 0

    @property
    def now_ns(self) -> int:
        return START_NS + round(self.beats * self.period_s * NS_PER_S)

    def packet(self, rate_deg_s: float, temperature_c: float = 20.0, valid: bool = True) -> bytes:
        self.beats += 1
        return self.encoder.encode(rate_deg_s * RAD_PER_DEG, self.period_s, temperature_c, valid)

    def turn(self, *rates_deg_s: float, **keys: Any) -> list[GyroSample]:
        """Samples of packets that are sent and received one by one."""
        samples = []
        for rate_deg_s in rates_deg_s:
            packet = self.packet(rate_deg_s, **keys)
            samples += self.stream.feed(packet, self.now_ns)
        return samples

    def settled(self, beats: int = 100) -> "Gyro":
        """After enough beats at rest to know the sensor's clock."""
        assert self.turn(*[0.0] * beats)
        return self

    def count(self, name: str) -> int:
        return self.stream.counters[name]


def rates_deg_s(samples: list[GyroSample]) -> list[float]:
    return [round(sample.rate_rad_s / RAD_PER_DEG, 2) for sample in samples]


VARIANTS = {
    "ecore": Fog(protocol="ecore"),
    "dsp3000 rate": Fog(protocol="dsp3000", dsp3000=Dsp3000(mode="rate")),
    "dsp3000 incremental": Fog(protocol="dsp3000", dsp3000=Dsp3000(mode="incremental")),
    "dsp3000 integrated": Fog(protocol="dsp3000", dsp3000=Dsp3000(mode="integrated")),
    "dsp17xx delta radians": Fog(protocol="dsp17xx"),
    "dsp17xx delta degrees": Fog(protocol="dsp17xx", dsp17xx=Dsp17xx(angle_unit="degrees")),
    "dsp17xx rate radians": Fog(protocol="dsp17xx", dsp17xx=Dsp17xx(rotation="rate")),
    "dsp17xx rate degrees": Fog(protocol="dsp17xx", dsp17xx=Dsp17xx(rotation="rate", angle_unit="degrees")),
}


each_variant = pytest.mark.parametrize("fog", VARIANTS.values(), ids=VARIANTS.keys())


@settings(deadline=None, max_examples=200)
@given(
    fog=st.sampled_from(list(VARIANTS.values())),
    positive=st.sampled_from(["clockwise", "counterclockwise"]),
    axis=st.sampled_from("xyz"),
    full_scale_deg_s=st.floats(20, 900),
    rate_hz=st.floats(10, 1000),
    parts=st.lists(st.floats(-0.998, 0.998), min_size=2, max_size=30),
    temperature_c=st.floats(-40, 75),
)
def test_what_the_gyro_measures_is_what_the_stream_says(
    fog: Fog,
    positive: Any,
    axis: Any,
    full_scale_deg_s: float,
    rate_hz: float,
    parts: list[float],
    temperature_c: float,
) -> None:
    fog = replace(fog, positive=positive, axis=axis, full_scale_deg_s=full_scale_deg_s, rate_hz=rate_hz)
    gyro = Gyro(fog)
    sent_rad_s = [part * full_scale_deg_s * RAD_PER_DEG for part in parts]
    samples = gyro.turn(*[part * full_scale_deg_s for part in parts], temperature_c=temperature_c)
    if fog.protocol == "dsp3000" and fog.dsp3000.mode == "integrated":
        del sent_rad_s[0]
    assert len(samples) == len(sent_rad_s)
    decimals_rad = 1e-6 * RAD_PER_DEG
    resolution_rad_s = {
        "ecore": full_scale_deg_s * RAD_PER_DEG / 32768 / 2,
        "dsp3000": decimals_rad * (1 if fog.dsp3000.mode == "rate" else rate_hz),
        "dsp17xx": full_scale_deg_s * RAD_PER_DEG * 2**-23,
    }[fog.protocol]
    # Arrivals are whole nanoseconds, and so is what is known of the period.
    tolerance_rad_s = resolution_rad_s * 1.01 + full_scale_deg_s * RAD_PER_DEG * 3e-9 * rate_hz
    for sample, rate_rad_s in zip(samples, sent_rad_s, strict=True):
        assert abs(sample.rate_rad_s - rate_rad_s) <= tolerance_rad_s
        assert sample.interval_s == pytest.approx(1 / rate_hz, rel=1e-5)
    if fog.protocol == "dsp3000":
        assert gyro.stream.temperature_c is None
        assert np.isnan(samples[-1].temperature_c)
    else:
        step_c = fog.ecore.temperature_scale_c if fog.protocol == "ecore" else fog.dsp17xx.temperature_scale_c
        assert gyro.stream.temperature_c == samples[-1].temperature_c
        assert samples[-1].temperature_c == pytest.approx(temperature_c, abs=step_c * 0.501)
    assert sum(gyro.stream.counters.values()) == gyro.count("samples") + gyro.count("frames")


def test_a_left_turn_is_negative_for_a_gyro_that_counts_clockwise_and_positive_here() -> None:
    fog = Fog(protocol="ecore", ecore=Ecore(status_byte=0, temperature_byte=0))
    # +10.001 deg/s and -10.001 deg/s of a unit of +-100 deg/s.
    right, left = bytes.fromhex("93400000000019 4d"), bytes.fromhex("ed000000000366 33")
    for turned, sign in ((replace(fog, positive="clockwise"), -1), (replace(fog, positive="counterclockwise"), 1)):
        stream = FogStream(turned, ANY_RAD_S2)
        samples = stream.feed(right, START_NS) + stream.feed(left, START_NS + NS_PER_S // 10)
        assert rates_deg_s(samples) == [sign * 10.0, -sign * 10.0]


@each_variant
def test_a_full_turn_adds_up_though_the_sensors_clock_is_3_percent_off(fog: Fog) -> None:
    gyro = Gyro(replace(fog, rate_hz=100), true_hz=103).settled()
    samples = gyro.turn(*[36.0] * 1030)
    turned_deg = sum(s.rate_rad_s * s.interval_s for s in samples) / RAD_PER_DEG
    assert turned_deg == pytest.approx(360, rel=1e-3)
    assert gyro.stream.rate_hz == pytest.approx(103, rel=1e-4)


@each_variant
def test_the_rate_is_right_though_the_sensors_clock_is_3_percent_off(fog: Fog) -> None:
    gyro = Gyro(replace(fog, rate_hz=100), true_hz=103).settled(300)
    assert set(np.round(rates_deg_s(gyro.turn(*[36.0] * 100)), 1)) == {36.0}


@each_variant
def test_an_invalid_reading_leaves_a_hole(fog: Fog) -> None:
    gyro = Gyro(replace(fog, ecore=STATUS)).settled()
    before = gyro.turn(5.0)[-1]
    assert gyro.turn(5.0, valid=False) == []
    after = gyro.turn(5.0, 5.0)[-1]
    assert (after.t_ns - before.t_ns) / NS_PER_S == pytest.approx(0.3, abs=1e-3)
    assert after.interval_s == pytest.approx(0.1, rel=1e-3)
    assert after.rate_rad_s == pytest.approx(5 * RAD_PER_DEG, abs=1e-4)
    assert (gyro.count("bad_flag"), gyro.count("lost_packets")) == (1, 0)


@each_variant
def test_a_lost_packet_leaves_a_hole_and_is_counted(fog: Fog) -> None:
    gyro = Gyro(fog).settled()
    before = gyro.turn(5.0)[-1]
    gyro.packet(5.0)
    after = gyro.turn(5.0)[0]
    gyro.turn(5.0, 5.0)
    assert gyro.count("lost_packets") == 1
    assert (after.t_ns - before.t_ns) / NS_PER_S == pytest.approx(0.2, abs=1e-3)
    assert after.rate_rad_s == pytest.approx(5 * RAD_PER_DEG, abs=1e-4)
    # Only an integrated angle holds the turn of the lost packet too.
    whole = fog.protocol == "dsp3000" and fog.dsp3000.mode == "integrated"
    assert after.interval_s == pytest.approx(0.2 if whole else 0.1, rel=1e-3)


def test_an_integrated_angle_keeps_the_turn_of_lines_that_are_missing_among_fast_ones() -> None:
    gyro = Gyro(replace(VARIANTS["dsp3000 integrated"], rate_hz=100.0), GENTLE_RAD_S2).settled()
    gyro.turn(*range(0, -40, -4))
    samples: list[GyroSample] = []
    for lost in (1, 2, 3):
        for _ in range(lost):
            gyro.packet(-40.0)
        samples += gyro.turn(*[-40.0] * 20)
    assert rates_deg_s(samples) == [-40.0] * 60
    assert [round(100.0 * s.interval_s) for s in samples[::20]] == [2, 3, 4]
    assert (samples[0].t_ns - START_NS) / NS_PER_S == pytest.approx(1.12, abs=1e-3)
    assert (gyro.count("lost_packets"), gyro.count("implausible")) == (6, 0)


def test_a_real_impact_that_comes_late_is_no_missing_line() -> None:
    gyro = Gyro(replace(VARIANTS["dsp3000 integrated"], rate_hz=100.0), GENTLE_RAD_S2).settled()
    gyro.turn(*range(0, 40, 4))
    samples = gyro.stream.feed(gyro.packet(80.0), gyro.now_ns + 6_000_000)
    samples += gyro.turn(*[80.0] * 20)
    assert sum(s.rate_rad_s * s.interval_s for s in samples) == pytest.approx(21 * 0.8 * RAD_PER_DEG, rel=0.01)
    assert (gyro.count("lost_packets"), gyro.count("implausible")) == (0, 0)
    assert (samples[-1].t_ns - START_NS) / NS_PER_S == pytest.approx(1.31, abs=2e-3)


@pytest.mark.parametrize("rate_deg_s", [99.95, -99.95, 150.0])
@each_variant
def test_over_range_is_dropped_though_the_sensor_calls_it_valid(fog: Fog, rate_deg_s: float) -> None:
    gyro = Gyro(fog).settled()
    assert rates_deg_s(gyro.turn(99.85, rate_deg_s, 99.85)) == [99.85, 99.85]
    assert (gyro.count("over_range"), gyro.count("bad_flag")) == (1, 0)


def test_what_only_full_scale_makes_absurd_never_comes_out() -> None:
    gyro = Gyro(Fog(protocol="dsp17xx")).settled()
    assert gyro.turn(1e30, -1e38) == []
    assert gyro.count("over_range") == 2


@pytest.mark.parametrize("outlier_deg_s", [90.0, -90.0])
def test_a_lone_outlier_is_dropped_and_delays_nothing_else(outlier_deg_s: float) -> None:
    gyro = Gyro(Fog(protocol="ecore"), GENTLE_RAD_S2).settled()
    assert rates_deg_s(gyro.turn(1.0)) == [1.0]
    assert gyro.turn(outlier_deg_s) == []
    assert rates_deg_s(gyro.turn(2.0)) == [2.0]
    assert (gyro.count("implausible"), gyro.count("samples")) == (1, 102)


def test_two_that_agree_are_real_and_come_out_in_order() -> None:
    gyro = Gyro(Fog(protocol="ecore"), GENTLE_RAD_S2).settled()
    assert gyro.turn(90.0) == []
    released = gyro.turn(88.0)
    assert rates_deg_s(released) == [90.0, 88.0]
    assert [round((gyro.now_ns - s.t_ns) / NS_PER_S, 3) for s in released] == [0.1, 0.0]
    assert rates_deg_s(gyro.turn(87.0)) == [87.0]
    assert gyro.count("implausible") == 0


def test_outliers_that_disagree_are_all_dropped() -> None:
    gyro = Gyro(Fog(protocol="ecore"), 200 * RAD_PER_DEG).settled()
    assert gyro.turn(80.0, -80.0) == []
    assert rates_deg_s(gyro.turn(0.5)) == [0.5]
    assert gyro.count("implausible") == 2


def test_what_the_robot_can_do_is_never_held_back() -> None:
    gyro = Gyro(Fog(protocol="ecore"), GENTLE_RAD_S2).settled()
    assert rates_deg_s(gyro.turn(49.0, 98.0, 50.0, 0.0, -49.0)) == [49.0, 98.0, 50.0, 0.0, -49.0]
    # Over a hole it can do more.
    gyro.packet(0.0)
    assert rates_deg_s(gyro.turn(49.0)) == [49.0]


def test_a_corrupted_start_does_not_shut_the_good_readings_out() -> None:
    gyro = Gyro(Fog(protocol="ecore"), GENTLE_RAD_S2)
    assert rates_deg_s(gyro.turn(95.0)) == [95.0]
    assert rates_deg_s(gyro.turn(0.0, 0.0, 0.0)) == [0.0, 0.0, 0.0]


def test_corruptions_that_pass_the_sum_do_not_pass_the_stream() -> None:
    """Wrong bits in 1 of 20 frames; the 8-bit sum alone lets some of them through."""
    rng, gyro = np.random.default_rng(8), Gyro(Fog(protocol="ecore"), GENTLE_RAD_S2).settled()
    rates: list[float] = []
    sum_passed = 0
    for k in range(20_000):
        packet = bytearray(gyro.packet(10.0))
        if k % 20 == 7:
            packet[1:] = rng.integers(0, 128, 7, dtype=np.uint8).tobytes()
        good = gyro.count("frames")
        rates += rates_deg_s(gyro.stream.feed(bytes(packet), gyro.now_ns))
        sum_passed += k % 20 == 7 and gyro.count("frames") > good
    assert sum_passed >= 2
    assert gyro.count("implausible") + gyro.count("over_range") >= 1
    wrong = [rate for rate in rates if abs(rate - 10) > 0.01]
    # What a gentle turn permits cannot be told from one.
    assert len(wrong) <= sum_passed
    assert all(abs(rate - 10) <= 110 for rate in wrong)
    assert len(rates) >= 19_000


def test_the_latency_is_taken_off_the_stamps() -> None:
    prompt, late = (Gyro(Fog(protocol="ecore", latency_s=s)).turn(1.0)[0] for s in (0.0, 0.0625))
    assert prompt.t_ns - late.t_ns == 62_500_000


def test_a_burst_is_spread_over_its_beats() -> None:
    gyro = Gyro(Fog(protocol="ecore")).settled()
    burst = b"".join(gyro.packet(rate) for rate in (1.0, 2.0, 3.0))
    samples = gyro.stream.feed(burst, gyro.now_ns)
    assert [round((gyro.now_ns - s.t_ns) / NS_PER_S, 4) for s in samples] == [0.2, 0.1, 0.0]
    assert gyro.count("lost_packets") == 0


@each_variant
def test_byte_by_byte_is_the_same_as_packet_by_packet(fog: Fog) -> None:
    whole, split = Gyro(fog), Gyro(fog)
    rates = [float(k % 7) for k in range(30)]
    expected = whole.turn(*rates)
    samples = []
    for rate in rates:
        packet = split.packet(rate)
        for byte in packet:
            samples += split.stream.feed(bytes([byte]), split.now_ns)
    assert [s[:3] for s in samples] == [s[:3] for s in expected]


@each_variant
def test_garbage_between_packets_costs_none_and_shows_in_a_counter(fog: Fog) -> None:
    gyro = Gyro(fog).settled()
    clean = dict(gyro.stream.counters)
    for rate in range(20):
        data = b"\x00noise\r\n" + gyro.packet(float(rate))
        assert rates_deg_s(gyro.stream.feed(data, gyro.now_ns)) == [rate]
    changed = {k for k, n in gyro.stream.counters.items() if n != clean[k]}
    assert changed == {"samples", "frames", "malformed_lines" if fog.protocol == "dsp3000" else "foreign_bytes"}


@each_variant
def test_a_restart_joins_no_halves_and_keeps_the_clock(fog: Fog) -> None:
    gyro = Gyro(fog, GENTLE_RAD_S2, true_hz=10.3).settled(200)
    assert gyro.turn(90.0) == []  # waits for a confirmation that never comes
    half = gyro.packet(0.0)
    gyro.stream.feed(half[: len(half) // 2], gyro.now_ns)
    gyro.stream.restart()
    assert gyro.count("implausible") == 1
    gyro.beats += 50
    samples = gyro.turn(1.0, 1.0, 1.0)
    assert set(np.round(rates_deg_s(samples), 1)) == {1.0}
    assert gyro.count("lost_packets") == 0
    assert gyro.stream.rate_hz == pytest.approx(10.3, rel=1e-3)


@each_variant
def test_counters_are_all_there_from_the_start(fog: Fog) -> None:
    counters = FogStream(fog, ANY_RAD_S2).counters
    assert set(counters.values()) == {0}
    assert {"samples", "over_range", "implausible", "lost_packets", "clock_relocks", "frames", "bad_flag"} <= set(
        counters
    )


@each_variant
def test_the_rate_is_the_nominal_one_before_anything_came(fog: Fog) -> None:
    assert FogStream(fog, ANY_RAD_S2).rate_hz == fog.rate_hz


@each_variant
def test_arbitrary_bytes_never_raise_and_never_give_nonsense(fog: Fog) -> None:
    rng, gyro = np.random.default_rng(9), Gyro(fog)
    for _ in range(3_000):
        packet = bytearray(gyro.packet(10.0))
        packet[rng.integers(len(packet))] ^= 1 << int(rng.integers(8))
        for data in (bytes(packet), rng.bytes(int(rng.integers(20)))):
            for sample in gyro.stream.feed(data, gyro.now_ns):
                assert abs(sample.rate_rad_s) <= 100 * RAD_PER_DEG
                assert sample.interval_s > 0


def test_a_robot_without_gyro_has_no_stream() -> None:
    with pytest.raises(ValueError, match="none"):
        make_protocol(Fog(protocol="none"))
    with pytest.raises(ValueError, match="none"):
        make_encoder(Fog(protocol="none"))


def test_an_ecore_without_status_bits_cannot_say_invalid() -> None:
    assert len(Gyro(Fog(protocol="ecore")).turn(1.0, valid=False)) == 1


def test_rates_beyond_the_packet_are_clipped_by_the_gyro() -> None:
    (reading,) = make_protocol(Fog(protocol="ecore", positive="counterclockwise")).feed(
        make_encoder(Fog(protocol="ecore", positive="counterclockwise")).encode(9.0, 0.1, 1e6)
    )
    assert reading.value == pytest.approx(100 * RAD_PER_DEG * 32767 / 32768)
    assert reading.temperature_c == pytest.approx(327.67)


def test_packets_that_come_twice_count_once() -> None:
    fog = Fog(protocol="dsp17xx", rate_hz=100.0)
    once, twice = Gyro(fog), Gyro(fog)
    found, doubled = [], []
    for k in range(300):
        packet = once.packet(20.0 * np.sin(0.05 * k))
        found += once.stream.feed(packet, once.now_ns)
        doubled += twice.stream.feed(packet + packet, once.now_ns)
    assert doubled == found
    assert twice.count("doubled") == 300
    assert once.count("doubled") == twice.count("lost_packets") == 0
