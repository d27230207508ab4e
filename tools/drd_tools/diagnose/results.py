"""Results of a diagnosis as classes: the content of diagnosis.json. `files` turns them into JSON."""

import math
from collections.abc import Mapping, Sequence
from enum import StrEnum
from typing import Final, Literal

from msgspec import UNSET, Struct, UnsetType, field

from drd import arrays

Array = arrays.Array
Ranges = Mapping[str, tuple[float, float]]  # low and high of each covariate, in its file's unit
Figures = dict[str, float | None]  # of an evaluation, by name and unit
Window = tuple[float, float]

UNNAMED: Final = "unknown"  # in place of an effect's name
NOTHING: Final = "nothing"  # in place of an effect, that there is none


class Verdict(StrEnum):
    """Verdict on a recording, one word."""

    NOTHING = "nothing_missing"
    EXPLAINED = "explained"
    PARTLY = "partly_explained"
    UNKNOWN = "unknown"


class Status(StrEnum):
    """Certainty of a finding, the surest last."""

    SUSPECTED = "suspected"
    SUPPORTED = "supported"
    CONFIRMED = "confirmed"


class Amount(Struct, frozen=True):
    """A parameter's estimate and its standard deviation (0: not fitted; NaN: not known), in the catalogue's unit."""

    value: float
    std: float
    unit: str


class Term(Struct, frozen=True, kw_only=True):
    """An effect as a model has it. `choices`: parameters that are words. `seen`: where its covariate was. `provenance`:
    why it is there, and of several recordings the one in which it was found, where it holds in that alone.
    """

    effect: str
    parameters: dict[str, Amount]
    choices: dict[str, str] = {}
    seen: Ranges = {}
    provenance: dict[str, str] = {}


class Support(Struct, frozen=True):
    """Evidence for a finding: gain in log likelihood, chance of it anywhere in the catalogue, e-value.

    `prior_odds`: of what a recording is expected to have, by others of the robot, whose value is its parameters' prior.
    """

    gain_nats: float | None
    family_wise_p: float | None
    e_value: float | None
    prior_odds: float | UnsetType = UNSET


class HeldOut(Struct, frozen=True):
    """Log likelihood ratio of an effect in recordings that it was not fitted to, and which way that speaks."""

    nats: float
    speaks: Literal["for", "against", "neither"]


class Finding(Struct, frozen=True, kw_only=True):
    """One cause: an effect of the catalogue with its parameters, or what is known of one without a name.

    `probabilities`: of its name and of each that was tried in its place, of "unknown" and of "nothing", one together;
    those below 0.001 are left out. `surrogate`: the name that comes nearest to a cause without one. `recording`: of
    several the one that it was found in, where it holds in that alone.
    """

    effect: str
    status: Status
    also_fits: tuple[str, ...]
    acts_on: str
    parameters: dict[str, Amount]
    choices: dict[str, str] = {}
    windows: tuple[Window, ...]
    seen: Ranges = {}
    covariate: str | None = field(name="driver")
    evidence: Support
    explains: float | None
    surrogate: Term | None = field(name="stand_in", default=None)
    sentence: str
    held_out: HeldOut | UnsetType = UNSET
    probabilities: dict[str, float] = {}
    recording: str | UnsetType = UNSET

    @property
    def probability(self) -> float:
        """Posterior probability of its name; NaN where a file does not tell."""
        return self.probabilities.get(self.effect, math.nan)

    @property
    def is_named(self) -> bool:
        """Whether it is an effect of the catalogue."""
        return self.effect != UNNAMED

    @property
    def gain_nats(self) -> float:
        """The gain in log likelihood; 0 where it is not known."""
        return self.evidence.gain_nats or 0.0


class Unexplained(Struct, frozen=True):
    """Mismatch that is left. `end_error_m`: None where no reference gives it."""

    share_of_residual: float | None
    end_error_m: float | None


class Because(Struct, frozen=True):
    """An effect that was ruled out, or cannot be observed, and why."""

    effect: str
    because: str


class Smallest(Struct, frozen=True):
    """The smallest size that would be found, in its parameter's unit."""

    smallest: float | None
    unit: str


class Train(Struct, frozen=True):
    """Figures of the data that were fitted, without and with the model."""

    before: Figures
    after: Figures


class Validation(Struct, frozen=True):
    """Figures of data that had no part in the fit, by their name, without and with the model."""

    before: dict[str, Figures | float | None]
    after: dict[str, Figures | float | None]


class Fit(Struct, frozen=True):
    """Figures of the model's fit, on the data of the fit and on others."""

    train: Train
    held_out: Validation


class Alternative(Struct, frozen=True):
    """Another manoeuvre, and how many questions it settles."""

    manoeuvre: str
    minutes: float
    settles: float
    nats: float | None
    probability: float | None = None


class Segment(Struct, frozen=True):
    """A manoeuvre of a drive, driven for some laps; its duration."""

    manoeuvre: str
    laps: int
    minutes: float


class Settled(Struct, frozen=True):
    """An open question: two names, the probability that a drive settles which it is, and the nats that it brings."""

    names: list[str]
    probability: float
    nats: float


class NextDrive(Struct, frozen=True):
    """The drive that settles most open questions; `separates`: the pairs of names that it separates.

    `segments`: its manoeuvres, after a standstill of `stand_s`. `questions`: each open pair. `probability`: of settling
    all that it separates (where it separates none: all that are open).
    """

    manoeuvre: str
    minutes: float
    separates: list[list[str]]
    nats: float | None
    unsettled: list[list[str]] = []
    alternatives: list[Alternative] = []
    sentence: str = ""
    stand_s: float = 0.0
    segments: list[Segment] = []
    questions: list[Settled] = []
    probability: float | None = None


class Level(Struct, frozen=True):
    """Size of a noise, over the stated one, with its deviation, in a bin of a covariate; `at`: the bin in words."""

    at: str
    middle: float
    ratio: float
    std: float


class Scatter(Struct, frozen=True, kw_only=True):
    """A noise that is much larger than stated, `ratio` times: with what it goes, and when it is largest.

    `channel`: slip (of the wheels), gyro, or position and heading of the reference. `levels`: by bins of `covariate`,
    None where none tells. `nats`: gain of the covariate's bins, `window_nats` of the interval of time, their
    costs taken off. `jitter_s`: of the wheels' time from one change of speed to the next (25).
    """

    kind: Literal["noise"] = "noise"
    channel: str
    ratio: float
    covariate: str | None
    unit: str
    levels: tuple[Level, ...]
    nats: float | None
    window: Window | None
    window_ratio: float | None
    window_nats: float | None
    sentence: str
    jitter_s: float | UnsetType = UNSET


class Result(Struct, frozen=True, kw_only=True):
    """The content of diagnosis.json.

    `noise`: sizes of the noise over those that are stated; `scatter`: those that are much larger. `reference`: faults
    of the reference itself: its `lag`, where its marker is, `ahead` and `left` of the robot's centre, its `heading`'s
    offset, `smoothing`, `jumps` (how many) and, without a gyro, its clock's `drift` and a `delay`.
    """

    schema: Literal[1] = 1
    recording: str
    verdict: Verdict
    findings: tuple[Finding, ...]
    unexplained: Unexplained
    ruled_out: list[Because]
    detectable: dict[str, Smallest]
    not_observable: list[Because] | UnsetType = UNSET
    classes: list[list[str]]
    fit: Fit
    next_drive: NextDrive | None
    cut: str | UnsetType = UNSET
    noise: Figures | UnsetType = UNSET
    scatter: tuple[Scatter, ...] = ()
    reference: dict[str, Amount] | UnsetType = UNSET

    @property
    def unobservable(self) -> Sequence[Because]:
        """Effects of which the data say nothing; none where the file does not tell."""
        return () if isinstance(self.not_observable, UnsetType) else self.not_observable
