"""Results of a diagnosis as classes: the content of diagnosis.json. `files` turns them into JSON."""

import math
from collections.abc import Mapping, Sequence
from enum import StrEnum
from typing import Final, Literal

from msgspec import UNSET, Struct, UnsetType, field

Ranges = Mapping[str, tuple[float, float]]  # low and high of each covariate, in its file's unit
Figures = dict[str, float | None]  # of an evaluation, by name with unit
Window = tuple[float, float]

UNNAMED: Final = "unknown"  # in place of an effect's name
NOTHING: Final = "nothing"  # in place of an effect's name: no effect


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
    """A parameter's estimate and standard deviation (0: not fitted; NaN: unknown), in the catalogue's unit."""

    value: float
    std: float
    unit: str


class Term(Struct, frozen=True, kw_only=True):
    """An effect in a model. `choices`: parameters that are words. `seen`: range of its covariate. `provenance`: the
    reason for it, and the recording in which it was found, if it holds in only one of several.
    """

    effect: str
    parameters: dict[str, Amount]
    choices: dict[str, str] = {}
    seen: Ranges = {}
    provenance: dict[str, str] = {}


class Support(Struct, frozen=True):
    """Evidence for a finding: gain in log likelihood, family-wise p-value over the catalogue, e-value.

    `prior_odds`: of an expected effect, from other recordings of the robot, which also give its parameters' prior.
    """

    gain_nats: float | None
    family_wise_p: float | None
    e_value: float | None
    prior_odds: float | UnsetType = UNSET


class HeldOut(Struct, frozen=True):
    """Log likelihood ratio of an effect in held-out recordings, and whether this is for or against it."""

    nats: float
    speaks: Literal["for", "against", "neither"]


class Finding(Struct, frozen=True, kw_only=True):
    """One cause: an effect of the catalogue with its parameters, or the description of an unnamed one.

    `probabilities`: of its name, of each tried in its place, of "unknown" and of "nothing"; they sum to one, and those
    below 0.001 are left out. `beside`: the linear effect that was fitted together with it. `surrogate`: the name
    nearest to an unnamed cause. `recording`: the one in which it was found, if it holds in only one of several.
    `contradicted_by`: number of other recordings for which it is withdrawn.
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
    beside: Term | UnsetType = UNSET
    surrogate: Term | None = field(name="stand_in", default=None)
    sentence: str
    held_out: HeldOut | UnsetType = UNSET
    probabilities: dict[str, float] = {}
    recording: str | UnsetType = UNSET
    contradicted_by: int | UnsetType = UNSET

    @property
    def probability(self) -> float:
        """Posterior probability of its name; NaN if the file does not contain it."""
        return self.probabilities.get(self.effect, math.nan)

    @property
    def is_named(self) -> bool:
        """Whether it is an effect of the catalogue."""
        return self.effect != UNNAMED

    @property
    def gain_nats(self) -> float:
        """The gain in log likelihood; 0 if unknown."""
        return self.evidence.gain_nats or 0.0


class Unexplained(Struct, frozen=True):
    """Remaining mismatch. `end_error_m`: None without a reference."""

    share_of_residual: float | None
    end_error_m: float | None


class Because(Struct, frozen=True):
    """An effect that was ruled out, or is not observable, and the reason."""

    effect: str
    because: str


class Smallest(Struct, frozen=True):
    """The smallest detectable size, in its parameter's unit."""

    smallest: float | None
    unit: str


class Train(Struct, frozen=True):
    """Figures of the fitted data, without and with the model."""

    before: Figures
    after: Figures


class Validation(Struct, frozen=True):
    """Figures of held-out data, by name, without and with the model."""

    before: dict[str, Figures | float | None]
    after: dict[str, Figures | float | None]


class Fit(Struct, frozen=True):
    """Figures of the model on the fitted data and on held-out data."""

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
    """An open question: two names, the probability that a drive settles it, and the expected nats."""

    names: list[str]
    probability: float
    nats: float


class NextDrive(Struct, frozen=True):
    """The drive that settles most open questions; `separates`: the pairs of names that it distinguishes.

    `segments`: its manoeuvres, after a standstill of `stand_s`. `questions`: each open pair. `probability`: of settling
    all pairs that it separates (if none: all open ones).
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
    """Relative size of a noise to the stated one, with its deviation, in a covariate's bin; `at`: the bin in words."""

    at: str
    middle: float
    ratio: float
    std: float


class Scatter(Struct, frozen=True, kw_only=True):
    """A noise much larger than stated, by `ratio`: the covariate it depends on, and when it is largest.

    `channel`: slip (of the wheels), gyro, or position and heading of the reference. `levels`: by bins of `covariate`,
    None if none is significant. `nats`: gain of the covariate's bins, `window_nats`: of the interval of time, each less
    its cost. `jitter_s`: of the timing of the wheels' changes of speed (25).
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

    `noise`: sizes of the noise relative to the stated ones; `scatter`: those much larger. `reference`: errors of the
    reference itself: its `lag`, the position of its marker, `ahead` and `left` of the robot's centre, its `heading`
    offset, `smoothing`, time for which it was lost (`held`), number of `jumps` and, without a gyro, its clock's `drift`
    and a `delay`. `notes`: sentences about the recording, such as on rows left out.
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
    notes: tuple[str, ...] | UnsetType = UNSET

    @property
    def unobservable(self) -> Sequence[Because]:
        """Effects that the data cannot show; empty if the file does not contain them."""
        return () if isinstance(self.not_observable, UnsetType) else self.not_observable
