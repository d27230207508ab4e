"""What was handed over, counted a second time: the daemon's counters must say the same."""

import math
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Final, NamedTuple

from drd.config.keys import Config
from drd.fog.dsp17xx import BODY, FRAME_BYTES, HEADER, crc32_mpeg2
from drd.pipeline import Observer
from drd.samples import CanFrame, GyroSample, WheelSample
from drd.units import S_PER_NS
from soak.faults import BOOT_UP_ID, EMERGENCY_ID, LEFT_ID, RIGHT_ID

MARGIN_COUNTS: Final = 3
SIDES: Final = {LEFT_ID: "left", RIGHT_ID: "right"}


class Row(NamedTuple):
    """One counter: what the daemon counted, and what it had to count."""

    name: str
    counted: int
    expected: int


class Ledger(Observer):
    """Counts deliveries. It is the pipeline's observer, too, and so knows which samples went to the estimator."""

    def __init__(self, config: Config):
        per_m = (config.encoders.counts_per_revolution or 0.0) / (2.0 * math.pi * config.robot.wheel_radius_m)
        self._max_counts_s = config.robot.max_speed_m_s * per_m
        self._period_s = 1.0 / config.encoders.rate_hz
        self._modulus = config.encoders.modulus_counts or 1 << 32
        self._gap_s = min(config.encoders.gap_s, (self._modulus // 2 - MARGIN_COUNTS) / self._max_counts_s)
        self._sides = {name: _Side() for name in SIDES.values()}
        self._counts: Counter[str] = Counter()
        self._tail = b""
        self._sequence: int | None = None
        self._sent = 0

    # ---- deliveries

    def gyro_bytes(self, data: bytes, sent: int) -> None:
        """Look for packets in what was read; they do not overlap here. `sent`: all that the gyro has sent so far."""
        self._counts["bytes"] += len(data)
        self._tail += data
        while (start := self._tail.find(HEADER)) >= 0 and len(self._tail) >= start + FRAME_BYTES:
            packet = self._tail[start : start + FRAME_BYTES]
            good = crc32_mpeg2(packet[: BODY.size]) == packet[BODY.size :]
            self._tail = self._tail[start + (FRAME_BYTES if good else 1) :]
            if not good:
                self._counts["fog.bad_checksum"] += 1
                continue
            _, _, _, z, *_, status, sequence, _ = BODY.unpack_from(packet)
            self._counts["fog.frames"] += 1
            self._counts["fog.bad_flag"] += not status & 4
            self._counts["fog.not_finite"] += math.isnan(z)
            if self._sequence is not None:
                steps = (sequence - self._sequence) % 128 or 1
                turns = max(0, round((sent - self._sent - steps) / 128))  # of the packets' counter, in a long silence
                self._counts["fog.lost_packets"] += steps + 128 * turns - 1
            self._sequence, self._sent = sequence, sent
        self._tail = self._tail[-FRAME_BYTES:] if HEADER not in self._tail else self._tail

    def gyro_port_lost(self) -> None:
        """Losses are not counted over an opening of the port."""
        self._sequence = None

    def frame(self, frame: CanFrame) -> None:
        """A frame that was read."""
        self._counts["encoders.frames"] += 1
        side = SIDES.get(frame.can_id)
        if side is not None and len(frame.data) < 4:
            self._counts["encoders.wrong_length"] += 1
        elif side is not None:
            self._read(side, frame.t_ns, int.from_bytes(frame.data, "little"))
        elif frame.can_id == BOOT_UP_ID:
            self._counts["encoders.boot_ups"] += 1
            self._counts["encoders.left_restarts"] += 1
            self._sides["left"].value = None
        elif frame.can_id == EMERGENCY_ID:
            self._counts["encoders.emergencies"] += 1
        else:
            self._counts["encoders.foreign"] += 1

    def _read(self, name: str, t_ns: int, value: int) -> None:
        """One reading: a wrap is a step whose shorter way round passes the counter's end."""
        side, half = self._sides[name], self._modulus // 2
        if side.t_ns is not None and t_ns <= side.t_ns:
            self._counts[f"encoders.{name}_not_newer"] += 1
            return
        elapsed_s = 0.0 if side.t_ns is None else (t_ns - side.t_ns) * S_PER_NS
        before, side.t_ns, side.value = side.value, t_ns, value
        if before is None:
            return
        step = value - before
        shorter = step - self._modulus if step >= half else step + self._modulus if step < -half else step
        if elapsed_s > self._gap_s:
            self._counts[f"encoders.{name}_gaps"] += 1
        elif abs(shorter) > self._max_counts_s * max(elapsed_s, self._period_s) + MARGIN_COUNTS:
            self._counts[f"encoders.{name}_jumps"] += 1
        elif shorter != step:
            self._counts[f"encoders.{name}_wraps"] += 1

    # ---- the pipeline's observer

    def gyro(self, sample: GyroSample) -> None:  # noqa: ARG002  # the interface's
        """A gyro sample went to the estimator."""
        self._counts["fog.samples"] += 1

    def wheels(self, sample: WheelSample) -> None:  # noqa: ARG002  # the interface's
        """A wheel sample went to the estimator."""
        self._counts["encoders.samples"] += 1

    # ---- the comparison

    def rows(self, counters: Mapping[str, Mapping[str, int]], poses: int) -> Iterator[Row]:
        """Each counter that deliveries determine."""
        fog = counters["fog"]
        yield Row("estimator.poses", counters["estimator"]["poses"], poses)
        names = [f"fog.{n}" for n in ("frames", "bad_checksum", "bad_flag", "not_finite", "lost_packets", "samples")]
        names += [f"encoders.{n}" for n in ("frames", "foreign", "wrong_length", "boot_ups", "emergencies", "samples")]
        kinds = ("wraps", "jumps", "gaps", "restarts", "not_newer")
        names += [f"encoders.{side}_{kind}" for side in SIDES.values() for kind in kinds]
        for name in names:
            part, counter = name.split(".")
            yield Row(name, counters[part][counter], self._counts[name])
        spent = FRAME_BYTES * fog["frames"] + fog["foreign_bytes"]
        yield Row("fog: bytes in packets or foreign", spent, self._counts["bytes"])
        refused = ("bad_flag", "not_finite", "doubled", "over_range", "implausible")
        used = fog["samples"] + sum(fog[name] for name in refused)
        yield Row("fog: packets used or refused", used, self._counts["fog.frames"])


@dataclass
class _Side:
    t_ns: int | None = field(default=None)
    value: int | None = None
