"""Bytes of the FOG in, gyro samples out: protocol, clock, range and plausibility as configured."""

from math import isnan
from typing import Final

from drd.config.keys import Fog
from drd.fog import make_protocol
from drd.fog.clock import SampleClock, Stamp
from drd.samples import FogReading, GyroSample
from drd.units import NS_PER_S, RAD_PER_DEG, S_PER_NS

# Part of full scale beyond which a reading is over-range: the sensor clips or folds back there, and its valid flag
# does not show it (DSP-3000 manual 54-0215).
OVER_RANGE: Final = 0.999


class FogStream:
    """The gyro of one robot. `feed` never raises on bytes; unused readings leave a gap in time.

    A rate that is implausible after the previous sample is held back until the next one: released if they agree (a
    real impact), else dropped. Needed since the E-Core's 8-bit sum lets 1 of 256 corruptions pass and a DSP-3000's line
    has none. `temperature_c` is the last one received, None before. Raises ValueError for protocol none.
    """

    def __init__(self, fog: Fog, max_acceleration_rad_s2: float):
        self._protocol = make_protocol(fog)
        self._clock = SampleClock(fog.rate_hz, self._protocol.sequence_modulus)
        self._max_acceleration_rad_s2 = max_acceleration_rad_s2
        self._max_rate_rad_s = OVER_RANGE * fog.full_scale_deg_s * RAD_PER_DEG
        self._sign = -1.0 if fog.positive == "clockwise" else 1.0
        self._latency_ns = round(fog.latency_s * NS_PER_S)
        # Only this output loses no angle with a packet: the next one contains it.
        self._spans_losses = fog.protocol == "dsp3000" and fog.dsp3000.mode == "integrated"
        self._last: GyroSample | None = None
        self._suspect: GyroSample | None = None
        self._newest: FogReading | None = None
        self._counters = dict.fromkeys(("samples", "doubled", "over_range", "implausible"), 0)
        self.temperature_c: float | None = None

    @property
    def counters(self) -> dict[str, int]:
        """All counters in one: the stream's, its protocol's and its clock's."""
        return {**self._counters, **self._protocol.counters, **self._clock.counters}

    @property
    def rate_hz(self) -> float:
        """Measured packet rate; the nominal one before the first packets."""
        return 1.0 / self._clock.period_s

    def feed(self, data: bytes, arrival_ns: int) -> list[GyroSample]:
        """Take the bytes that were read at `arrival_ns`; return the samples that they complete or confirm, in order."""
        readings = [reading for reading in self._protocol.feed(data) if not self._is_copy(reading)]
        beats = self._beats(readings, arrival_ns) if self._spans_losses else ()
        stamps = self._clock.stamp([reading.sequence for reading in readings], arrival_ns, beats)
        samples = []
        for reading, stamp in zip(readings, stamps, strict=True):
            if not isnan(reading.temperature_c):
                self.temperature_c = reading.temperature_c
            if (sample := self._sample(reading, stamp)) is not None:
                samples += self._plausible(sample)
        self._counters["samples"] += len(samples)
        return samples

    def stalled(self) -> None:
        """Note a stall of the host: the next bytes were delayed."""
        self._clock.stalled()

    def restart(self) -> None:
        """Forget a partial packet, the phase and an unconfirmed sample: the port was opened again."""
        self._protocol.reset()
        self._clock.restart()
        self._newest = None
        self._drop_suspect()

    def _is_copy(self, reading: FogReading) -> bool:
        is_copy, self._newest = reading.is_copy_of(self._newest), reading
        self._counters["doubled"] += is_copy
        return is_copy

    def _beats(self, readings: list[FogReading], arrival_ns: int) -> list[int]:
        """Number of beats that each integrated angle spans, in total no more than are due: 1 if the acceleration limit
        permits it, else the best fit to the previous rate. On a fast line a loss shows in time some lines later.
        """
        if self._last is None:
            return [1] * len(readings)
        period_s, beats = self._clock.period_s, list[int]()
        spare = self._clock.due(arrival_ns) - len(readings)
        before_rad = self._sign * self._last.rate_rad_s * period_s
        limit_rad = self._max_acceleration_rad_s2 * period_s**2
        for i, reading in enumerate(readings):
            off_rad = {k: abs(reading.value / k - before_rad) for k in range(1, spare + 2) if reading.valid}
            permitted = [(k > 1, off, k) for k, off in off_rad.items() if off <= (i + k) * limit_rad]
            beats.append(min(permitted)[-1] if permitted else 1)
            spare -= beats[-1] - 1
        return beats

    def _sample(self, reading: FogReading, stamp: Stamp) -> GyroSample | None:
        """The reading in the robot's frame and units; None if it is invalid or over-range."""
        if not reading.valid:
            return None
        interval_s = stamp.interval_s * (stamp.steps if self._spans_losses else 1)
        rate_rad_s = reading.value / interval_s if reading.is_angle else reading.value
        if abs(rate_rad_s) > self._max_rate_rad_s:
            self._counters["over_range"] += 1
            return None
        t_ns = stamp.t_ns - self._latency_ns
        return GyroSample(t_ns, interval_s, self._sign * rate_rad_s, reading.temperature_c)

    def _plausible(self, sample: GyroSample) -> list[GyroSample]:
        """The samples that are plausible now that `sample` is known."""
        released = []
        if self._suspect is not None and self._permits(self._suspect, sample):
            released, self._suspect = [self._suspect, sample], None
        else:
            self._drop_suspect()
            if self._last is None or self._permits(self._last, sample):
                released = [sample]
            else:
                self._suspect = sample
        if released:
            self._last = released[-1]
        return released

    def _permits(self, earlier: GyroSample, later: GyroSample) -> bool:
        """Whether the acceleration limit permits the change between the middles of two intervals."""
        between_s = (later.t_ns - earlier.t_ns) * S_PER_NS - (later.interval_s - earlier.interval_s) / 2
        limit_rad_s = self._max_acceleration_rad_s2 * max(between_s, later.interval_s)
        return abs(later.rate_rad_s - earlier.rate_rad_s) <= limit_rad_s

    def _drop_suspect(self) -> None:
        self._counters["implausible"] += self._suspect is not None
        self._suspect = None
