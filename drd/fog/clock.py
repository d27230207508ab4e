"""End times of a FOG's measuring intervals, from its packets' arrivals.

A FOG sends at its own clock's beat. Counting packets at the nominal rate is wrong by 2 to 3 % (DSP-3000 manual 54-0215
p. 12; a DSP-1750 gives 989 Hz for nominal 1000), which would be a scale error of every turn. Arrival times are right on
the average but scattered: an adapter delivers in bursts every 16 to 30 ms (FTDI's latency timer), a busy host reads
late. So phase and period of the beat are tracked against the arrivals, and the beat gives the times.

Tracking: a Kalman filter with two states, phase and period. It is the alpha-beta filter whose gains fall as in a
fit to all arrivals since the start and settle at a memory of some ten seconds, set by the sensor clock's drift.
Packets are late, never early: an arrival before the predicted one is nearly exact, a later one proves little. Two
measurement variances express this and put the phase near the smallest delay, not the mean one. Both corrections
of one arrival have the same sign and nearly the same ratio, so where the phase settles does not bias the period.

Losses: a packet counter, if any, numbers the beats. Elsewhere the content may show a loss, and so does an arrival
later than delays explain; a lateness that delays could explain must last. A loss that was only a delay is recognised,
since the next packets come early, and undone; only losses that lasted are counted. A surplus packet is one that came
twice. After a stall of the host nothing is inferred until an arrival fits the beat again: delayed packets may come in
parts, and a part that is stamped with its arrival leaves no time for the others. Counters that continue, less than two
periods late, show that the beat continues. Limits, for sensors without counter whose beat is within 0.5 % of a multiple
of the adapter's: in bundles, losses may stay uncounted, with the intervals spread over them; in single packets (an
adapter that delivers every 10 ms at 100 Hz), a slower sensor looks like one that loses packets.
"""

from cmath import rect
from collections import deque
from collections.abc import Sequence
from itertools import accumulate
from math import floor, sqrt, tau
from statistics import median
from typing import Final, NamedTuple

from drd.units import NS_PER_S, S_PER_NS

# Delay of a packet beyond the smallest: standard deviation of a late packet, that of one before its prediction, and
# the largest delay that a burst or a busy host often causes.
LATE_S: Final = 0.01
EARLY_S: Final = 0.001
MAX_DELAY_S: Final = 0.03
# No packet is early by this many standard deviations, at least 5 ms.
EARLY_SIGMAS: Final = 5.0
# Standard deviation of the sensor's clock against its nominal rate.
NOMINAL_TOLERANCE: Final = 0.03
# Random walk of the relative period per sqrt(s). DSP-3000: 0.2 % over temperature; some 0.01 % in a minute.
DRIFT_PER_SQRT_S: Final = 1e-5
# Losses are inferred from time once the period is known this well, after this many arrivals that fit.
LOCKED_TOLERANCE: Final = 0.005
LOCKING: Final = 20
# An arrival fits within the largest usual delay and this part of a period. After this many in a row that do not fit,
# the beat is measured again.
FIT_PART: Final = 0.1
RELOCKING: Final = 8
# Delayed packets may come one by one: at 10 Hz, those of six seconds.
HELD_UP_RELOCKING: Final = 64
# Arrivals closer than this, and than this part of a period, are one bundle read in parts: a packet takes some 2 ms on
# a line of 115200 Bd, and the host reads what has arrived.
TOGETHER_S: Final = 0.005
TOGETHER_PART: Final = 0.5
# Number of arrivals that must all be late to show a loss, and that a loss must survive to be counted: for single
# packets, and while an adapter bundles them (the newest of a bundle has any age up to a period).
EVIDENCE: Final = 3
EVIDENCE_BUNDLED: Final = 16
# Ages scatter if this many of them, as phasors of one turn per period, add up to less than this part of their number.
SCATTER: Final = 64
SCATTERED: Final = 0.5
# Part of a period by which even the freshest arrival is late after a loss; the rest is for the phase's error.
LOSS_PART: Final = 0.75
# After a silence longer than both, the sensor may have been switched off and on: phase new, period the same.
SILENCE_S: Final = 1.0
SILENCE_BEATS: Final = 10
MIN_PERIOD_S: Final = 1e-4


class Stamp(NamedTuple):
    """End of a packet's measuring interval on the host's clock, and its duration.

    `steps`: beats since the previous packet, more than 1 after a loss.
    """

    t_ns: int
    interval_s: float
    steps: int


class SampleClock:
    """Times of one sensor's packets.

    `rate_hz` is nominal; a wrong one is detected and replaced. `sequence_modulus` is that of the packets' counter, None
    if they have none. `period_s` is the tracked beat. `counters`: `lost_packets`; `clock_relocks`, how often arrivals
    did not fit the beat and it was measured again.
    """

    def __init__(self, rate_hz: float, sequence_modulus: int | None):
        self.period_s = 1.0 / rate_hz
        self.counters = {"lost_packets": 0, "clock_relocks": 0}
        self._modulus = sequence_modulus
        self._period_var = (NOMINAL_TOLERANCE * self.period_s) ** 2
        self._bundled: int
        self._habit: int
        self._first: int
        self._rest: int
        self._origin_ns: int | None = None
        self._last_t_ns: int | None = None
        self.restart()

    def restart(self) -> None:
        """Begin with a new phase after the port was opened again; missed packets are not counted, the period stays."""
        self._synchronised = self._is_stalled = False
        self._last_sequence: int | None = None
        self._arrival_s = self._phase_s = self._phase_var = self._covariance = 0.0
        self._forget_evidence()

    def stalled(self) -> None:
        """Note a stall of the host: packets that come late were delayed, and do not follow a loss."""
        self._is_stalled = True

    def due(self, arrival_ns: int) -> int:
        """Beats from the newest packet to one that arrives at `arrival_ns`; 0 while time is not conclusive."""
        if self._origin_ns is None or not self._locked or self._is_stalled:
            return 0
        return round(((arrival_ns - self._origin_ns) * S_PER_NS - self._phase_s) / self.period_s)

    def stamp(self, sequences: Sequence[int | None], arrival_ns: int, beats: Sequence[int] = ()) -> list[Stamp]:
        """Times of the packets that were read together at `arrival_ns`, oldest first; strictly increasing.

        `sequences`: each packet's counter, or None. The last packet is the newest, the others are older by their beats.
        `beats`: those from each packet's predecessor to it by its content, if there is no counter; else 1.
        """
        if not sequences:
            return []
        if self._origin_ns is None:
            self._origin_ns = arrival_ns
        arrival_s = (arrival_ns - self._origin_ns) * S_PER_NS
        steps = self._steps(sequences, arrival_s, beats)
        self._note_bundle(len(steps), arrival_s)
        if not self._synchronised:
            self._synchronise(arrival_s)
        elif self._is_silence(arrival_s - self._arrival_s):
            self._resume(arrival_s, steps)
        else:
            steps[0] = max(1, steps[0] + self._observe(arrival_s, steps))
        self._arrival_s = arrival_s
        return self._stamps(steps, min(self._phase_s, arrival_s))

    def _is_silence(self, quiet_s: float) -> bool:
        limit_s = max(SILENCE_S, SILENCE_BEATS * self.period_s)
        return self._locked and not self._is_stalled and quiet_s > limit_s

    def _note_bundle(self, packets: int, arrival_s: float) -> None:
        """Note the pattern of bundles: how many in a row, and how many packets follow the first part of one."""
        if self._synchronised and arrival_s - self._arrival_s < min(TOGETHER_S, TOGETHER_PART * self.period_s):
            self._rest += packets
        else:
            self._habit = self._habit + 1 if self._first + self._rest > 1 else int(self._habit > 1)
            self._rests.append(self._rest)
            self._first, self._rest = packets, 0
        self._bundled = EVIDENCE_BUNDLED if self._first + self._rest > 1 else max(0, self._bundled - 1)

    @property
    def _is_first_part(self) -> bool:
        """Whether more of this bundle will come: the age of its newest packet so far is unknown."""
        return not (self._rest or self._is_stalled) and self._habit > 0 and any(self._rests)

    @property
    def _waiting_s(self) -> float:
        """Age that the newest packet of a bundle may have: almost a period; 0 if there are no bundles.

        A single bundle of packets that are far apart is due to a busy host, not to an adapter's habit.
        """
        is_habit = self._habit + (self._first + self._rest > 1) > 1
        return self.period_s if self._bundled and (self.period_s < MAX_DELAY_S or is_habit) else 0.0

    @property
    def _locked(self) -> bool:
        return self._fitting >= LOCKING and self._period_var < (LOCKED_TOLERANCE * self.period_s) ** 2

    def _steps(self, sequences: Sequence[int | None], arrival_s: float, beats: Sequence[int]) -> list[int]:
        """Beats from each packet to the next, by their counter where they have one."""
        if self._modulus is None:
            return list(beats) or [1] * len(sequences)
        steps = []
        for sequence in sequences:
            last, self._last_sequence = self._last_sequence, sequence
            steps.append(1 if sequence is None or last is None else (sequence - last) % self._modulus)
        if self._locked and not self._is_stalled:  # delayed packets come in parts, long after they were sent
            turns = ((arrival_s - self._arrival_s) / self.period_s - sum(steps)) / self._modulus
            steps[0] += max(0, round(turns)) * self._modulus
        # A packet that repeats its predecessor's number still counts as a packet.
        return [step or 1 for step in steps]

    def _synchronise(self, arrival_s: float) -> None:
        """Use the newest packet's arrival as its time."""
        self._phase_s, self._phase_var, self._covariance = arrival_s, LATE_S**2, 0.0
        self._synchronised = True

    def _forget_evidence(self) -> None:
        """Restart the statistics that reveal losses and a wrong beat."""
        self._fitting = 0
        self._bundled = 0  # arrivals until bundling is forgotten
        self._habit = 0  # bundles in a row before this one; an interval that is no multiple has one with a packet alone
        self._first = self._rest = 0  # packets of this bundle: in its first part, and in others
        self._rests: deque[int] = deque([0], maxlen=2)
        self._misfits: list[tuple[float, int]] = []
        self._only_late = True
        self._lates_s: deque[float] = deque(maxlen=SCATTER)
        self._is_sudden = False  # a single arrival has shown the last inferred loss
        self._inferred: deque[int] = deque([0], maxlen=EVIDENCE_BUNDLED)
        self._counted = 0

    def _resume(self, arrival_s: float, steps: list[int]) -> None:
        """Add the missing packets to `steps` after a silence, and begin with a new phase."""
        if self._modulus is None:
            steps[0] = max(1, round((arrival_s - self._phase_s) / self.period_s) - sum(steps[1:]))
        self.counters["lost_packets"] += sum(steps) - len(steps)
        self._lates_s.clear()
        self._synchronise(arrival_s)

    def _observe(self, arrival_s: float, steps: list[int]) -> int:
        """Compare the newest packet's arrival with the beat; return further beats that passed (loss inferred)."""
        self._advance(sum(steps))
        if self._modulus is None:
            self._inferred[-1] += sum(steps) - len(steps)  # undone if the next packets come early
        if self._is_first_part:
            return 0
        late_s, further = arrival_s - self._phase_s, 0
        fitting_s = max(FIT_PART * self.period_s, MAX_DELAY_S) + self._waiting_s
        limit_s = max(LOSS_PART * self.period_s, MAX_DELAY_S) + self._waiting_s
        if self._modulus is not None:
            self.counters["lost_packets"] += sum(steps) - len(steps) if late_s >= -limit_s else 0
        elif self._locked and (surplus := self._surplus(late_s, len(steps))):
            self._advance(-surplus)
            late_s += surplus * self.period_s
        elif self._locked and not (self._is_stalled and late_s > limit_s):
            further = self._infer_loss(late_s, limit_s)
            self._advance(further)
            late_s -= further * self.period_s
        if abs(late_s) > fitting_s:
            self._misfit(arrival_s, sum(steps), 0.0 < late_s < 2.0 * self.period_s)
        elif further <= 0:
            # A loss just inferred may turn out to be a delay: its arrival proves no phase.
            self._correct(late_s)
            self._is_stalled = False
        return further

    def _surplus(self, late_s: float, packets: int) -> int:
        """Number of packets that came twice: no loss is left to undo, and they are whole periods early. Unobservable
        with a fast sensor, as the ages of its bundles drift by as much.
        """
        most = packets - 1 if self.period_s >= MAX_DELAY_S and self._inferred[-1] == self._counted else 0
        early_s = max(LOSS_PART * self.period_s, self._earliest_s)
        return min(most, round(-late_s / self.period_s)) if late_s < -early_s else 0

    def _infer_loss(self, late_s: float, limit_s: float) -> int:
        """Packets lost before this arrival, judged by time alone; negative: a loss that was only a delay."""
        evidence = EVIDENCE_BUNDLED if self._waiting_s else EVIDENCE
        self._lates_s.append(late_s)
        recent_s = list(self._lates_s)[-evidence:]
        inferred, lost = self._inferred[-1], 0
        if late_s > limit_s:
            lost, self._is_sudden = self._periods(late_s - limit_s + LOSS_PART * self.period_s), True
        elif len(recent_s) == evidence and self._shows_loss(recent_s):
            lost, self._is_sudden = self._periods(min(recent_s)), False
        elif late_s < -self._early_limit_s:
            lost = -min(inferred - self._counted, max(1, round(-late_s / self.period_s)))
        if lost:
            self._lates_s = deque((late - lost * self.period_s for late in self._lates_s), SCATTER)
        self._inferred.append(inferred + lost)
        recent = list(self._inferred)[-evidence:]
        if len(recent) == evidence and min(recent) > self._counted:
            self.counters["lost_packets"] += min(recent) - self._counted
            self._counted = min(recent)
        return lost

    @property
    def _early_limit_s(self) -> float:
        """Earliness that disproves the inferred loss. Several late arrivals that have shown the loss have also drawn
        the phase: then only half a period, as far from the one beat as from the other, decides.
        """
        half_s = self.period_s / 2
        return min(half_s, self._earliest_s) if self._is_sudden else half_s

    @property
    def _earliest_s(self) -> float:
        """Earliness that no packet of the beat reaches."""
        return EARLY_SIGMAS * sqrt(self._phase_var + EARLY_S**2)

    def _shows_loss(self, lates_s: list[float]) -> bool:
        """Whether even the freshest of these arrivals came a period late, and not because bundles slipped.

        After a loss, packets of bundles come one to two periods late. But where the adapter's beat is close to a
        multiple of the sensor's, the newest packets' age hardly changes for seconds, the sensor's beat seems to be the
        adapter's, and when at last a bundle has one packet less, all that follow come a period late. So nothing is
        inferred while the ages (lateness modulo the period) do not scatter.
        """
        freshest_s = LOSS_PART * self.period_s
        if min(lates_s) <= freshest_s or not self._waiting_s:
            return min(lates_s) > freshest_s
        ages = [rect(1.0, tau * late_s / self.period_s) for late_s in self._lates_s]
        return median(lates_s) > freshest_s + self.period_s / 2 and abs(sum(ages)) < SCATTERED * len(ages)

    def _periods(self, late_s: float) -> int:
        """Whole periods in a lateness of at least LOSS_PART of one."""
        return floor(late_s / self.period_s + 1 - LOSS_PART)

    def _advance(self, beats: int) -> None:
        """Predict the phase `beats` later; a negative number takes beats back."""
        self._phase_s += beats * self.period_s
        self._phase_var += (2 * self._covariance + beats * self._period_var) * beats
        self._covariance += beats * self._period_var
        self._period_var += abs(beats) * DRIFT_PER_SQRT_S**2 * self.period_s**3

    def _correct(self, late_s: float) -> None:
        """Kalman update of phase and period."""
        innovation_var = self._phase_var + (EARLY_S if late_s < 0 else LATE_S) ** 2
        phase_gain, period_gain = self._phase_var / innovation_var, self._covariance / innovation_var
        self._phase_s += phase_gain * late_s
        self.period_s = max(MIN_PERIOD_S, self.period_s + period_gain * late_s)
        self._period_var -= period_gain * self._covariance
        self._covariance *= 1 - phase_gain
        self._phase_var *= 1 - phase_gain
        self._fitting += 1
        self._misfits.clear()

    def _misfit(self, arrival_s: float, beats: int, is_late: bool) -> None:
        """Keep the beat, unless misfits last: then measure it again from the arrivals that did not fit."""
        self._only_late = is_late and (self._only_late or not self._misfits)
        if self._misfits and self._rest:  # a bundle's newest packet counts
            beats += self._misfits.pop()[1]
        self._misfits.append((arrival_s, beats))
        *whole, (_, newest) = self._misfits  # more of the newest bundle may come
        if len(whole) < RELOCKING:
            return
        # Counters that continue mean that the beat does, too: packets late by a period or two are held up.
        goes_on = self._modulus is not None and self._locked and self._only_late
        if len(whole) < HELD_UP_RELOCKING and (goes_on or (self._is_stalled and self._waited(whole))):
            return
        whole = whole[-RELOCKING:]
        ends = list(accumulate(beats for _, beats in whole[1:]))
        measured_s = (whole[-1][0] - whole[0][0]) / ends[-1]
        delays_s = [arrival - end * measured_s for (arrival, _), end in zip(whole, [0, *ends], strict=True)]
        uncertainty_s = (max(delays_s) - min(delays_s) + MAX_DELAY_S + self._waiting_s) / ends[-1]
        if abs(measured_s - self.period_s) > uncertainty_s:
            self.period_s = max(MIN_PERIOD_S, measured_s)
            self._period_var = uncertainty_s**2
        self.counters["clock_relocks"] += 1
        self._is_stalled = False
        self._forget_evidence()
        # Packets are late, never early: the least late of them all gives the phase.
        latest, p = ends[-1] + newest, self.period_s
        firsts_s = (arrival + (latest - end) * p for (arrival, _), end in zip(whole, [0, *ends], strict=True))
        self._synchronise(min(arrival_s, *firsts_s))

    def _waited(self, bundles: list[tuple[float, int]]) -> bool:
        """Whether the last of these came faster than the sensor sends: they were delayed, and do not show its beat."""
        (first_s, _), *others = bundles[-RELOCKING:]
        return others[-1][0] - first_s < (1.0 - FIT_PART) * self.period_s * sum(beats for _, beats in others)

    def _stamps(self, steps: list[int], newest_s: float) -> list[Stamp]:
        """Stamps of one chunk's packets, the newest at `newest_s`; none before an earlier stamp."""
        assert self._origin_ns is not None
        newest_ns = self._origin_ns + round(newest_s * NS_PER_S)
        beats, stamps = sum(steps), []
        for step in steps:
            beats -= step
            t_ns = newest_ns - round(beats * self.period_s * NS_PER_S)
            if self._last_t_ns is not None:
                t_ns = max(t_ns, self._last_t_ns + 1)
            self._last_t_ns = t_ns
            stamps.append(Stamp(t_ns, self.period_s, step))
        return stamps
