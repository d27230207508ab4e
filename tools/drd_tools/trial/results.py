"""Results of a trial as classes, and the one place where they are read and written.

`Record`: a recording whose answer is known, with its diagnosis. `Untouched` and `Planted`: of a real drive, as it is
and with an effect put into its raw data. `NotMade`: a case that no drive showed. `Store`: the file of a trial, a line
of JSON for each, added as it is ready, so that a stopped trial goes on. Parameters are in the catalogue's units.
"""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import msgspec
from msgspec import UNSET, Struct, UnsetType, field

from drd.config.schema import ConfigError
from drd.effects.catalogue import catalogue
from drd.effects.effect import Values
from drd_tools.build import fingerprint as fingerprint_of
from drd_tools.diagnose.files import parted, plain
from drd_tools.diagnose.results import Amount, Figures, Finding
from drd_tools.report.json_file import converted, read_json

RESULTS: Final = "results.jsonl"
OLD: Final = "results.old.jsonl"
ANSWERS: Final = "answers.json"
FORMAT: Final = "drd-trial/2"
FAILED: Final = "failed"  # in place of a verdict


class TrueEffect(Struct, kw_only=True):
    """An effect that is in a recording. `detectability`: its whitened distance d, the square root of the noncentrality.

    `rival`: what does best in its place without noise, another name or nothing (""), by `margin_nats` worse;
    `separable`: by more than the names of one class differ. `nearest`: what comes nearest to it in its place, at the
    whitened `distance`, no name preferred. `ceiling`: probability of the right one of these two that no method exceeds,
    where they are equally likely; `least`: that which the best method reaches among all names, sizes known. (93)
    `own`: sizes of it that a real drive has as it is, though they are not reported.
    """

    effect: str
    parameters: dict[str, float | str]
    detectability: float | UnsetType | None = field(name="visibility", default=UNSET)
    rival: str | UnsetType = UNSET
    margin_nats: float | UnsetType = UNSET
    separable: bool | UnsetType = UNSET
    nearest: str | UnsetType = UNSET
    distance: float | UnsetType = UNSET
    ceiling: float | UnsetType = UNSET
    least: float | UnsetType = UNSET
    own: dict[str, Amount] | UnsetType = UNSET


class Run(Struct, frozen=True):
    """One drive of a robot. The temperature is the other world's own in MuJoCo, the friction only there."""

    mission: str
    temperature: str
    seconds: float
    seed: int
    friction: float


class Stress(Struct, frozen=True):
    """Noise against the data sheets', degrees of freedom of its tails, and what is wrong with the reference."""

    gyro_noise: float
    wheel_noise: float
    reference_noise: float
    tails: float
    latency_s: float
    sideways_m: float
    yaw_deg: float


class Mismatch(Struct):
    """Figures of another drive: without a model, with that of the diagnosis, and with the true effects (the oracle)."""

    before: float
    after: float
    oracle: float | UnsetType = UNSET


class OtherDrive(Struct):
    """`residual`: squared whitened innovations of `rows`. `path_m`: rms distance of the path from the reference."""

    rows: int
    residual: Mismatch
    path_m: Mismatch


class Answer(Struct, kw_only=True):
    """The truth about a recording: an entry of answers.json."""

    case: str
    kind: str
    effects: list[TrueEffect]
    drive: Run | UnsetType = UNSET
    stress: Stress | UnsetType = UNSET


class Record(Answer, kw_only=True):
    """A recording's answer, and what the diagnosis reports, the best finding first; a failed one has an `error`.

    `baselines`: names that other methods select, the best first. `truth_nats`: score of the true effects, refined,
    less that of what was found: above 0 the search has missed the better answer; below, the evidence as it is weighed
    speaks for the wrong one.
    """

    verdict: str
    findings: tuple[Finding, ...]
    noise: Figures | UnsetType = UNSET
    took_s: float | UnsetType = UNSET
    truth_nats: float | UnsetType = UNSET
    error: str | UnsetType = UNSET
    baselines: dict[str, list[str]] = {}
    held_out: OtherDrive | UnsetType = UNSET


class Untouched(Record, kw_only=True):
    """A real drive as it is: the effects that it can show, each with the case that plants it, and the others.

    `lag_s`: how late its reference is.
    """

    plantings: dict[str, TrueEffect]
    not_visible: list[str]
    lag_s: float = 0.0


class Planted(Record, kw_only=True):
    """A real drive, `base`, with its one effect planted in the raw data."""

    base: str


class NotMade(Struct):
    """A case that could not be made, and why."""

    case: str
    kind: str
    not_made: str


Row = Record | NotMade


class Head(Struct, kw_only=True):
    """Settings that make cases the same, and the build that diagnosed them. `plant`: the folder of real drives."""

    format: str = FORMAT
    seed: int
    minutes: tuple[float, float] = (4.0, 10.0)
    reference: str = "full"
    folder: str | None = None
    baselines: list[str] = []
    plant: str | UnsetType = UNSET
    glob: str | UnsetType = UNSET
    build: str = ""


class Store:
    """The results in a folder."""

    def __init__(self, folder: Path):
        self.file = folder / RESULTS

    def begin(self, head: Head) -> list[Row]:
        """Go on with the results that are there, or begin; returns those that are there.

        Results of another build of the diagnosis are moved aside. Raises ConfigError where they are of other cases
        (another seed, say), and OSError.
        """
        head = msgspec.structs.replace(head, build=fingerprint())
        self.file.parent.mkdir(parents=True, exist_ok=True)
        if self.file.exists() and self.file.stat().st_size:
            was, rows = self.read()
            if was.build == head.build:
                for name, value in msgspec.structs.asdict(head).items():
                    if (there := getattr(was, name)) != value:
                        expected = f"the trial that it holds, with {name} {there}; or another folder"
                        raise ConfigError(str(self.file.parent), name, expected, str(value))
                self._write([was, *rows])  # without a line that was cut off
                return rows
            self.file.replace(self.file.with_name(OLD))
        self._write([head])
        return []

    def add(self, row: Row) -> None:
        """Keep a row. Raises OSError."""
        with self.file.open("a", encoding="utf-8") as out:
            out.write(_line(row))

    def read(self) -> tuple[Head, list[Row]]:
        """The rows that are there. A last line that was cut off does not count. Raises ConfigError."""
        try:
            lines = self.file.read_text(encoding="utf-8").split("\n")[:-1]
            rows: list[Any] = [json.loads(line) for line in lines]
        except (OSError, ValueError) as error:
            raise ConfigError(str(self.file), "", "results of a trial", str(error)) from error
        if not rows or not isinstance(rows[0], dict) or rows[0].get("format") != FORMAT:
            raise ConfigError(str(self.file), "format", FORMAT, "something else")
        head = converted(self.file, rows[0], Head)
        return head, [
            converted(self.file, row | {"findings": parted(row.get("findings", ()))}, _form(row)) for row in rows[1:]
        ]

    def _write(self, rows: Sequence[Head | Row]) -> None:
        self.file.write_text("".join(map(_line, rows)), encoding="utf-8")


def save(file: Path, rows: Sequence[Struct]) -> None:
    """Write rows of another trial, one JSON a line. Raises OSError."""
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_bytes(b"".join(msgspec.json.encode(row) + b"\n" for row in rows))


def read_answers(folder: Path) -> list[Answer]:
    """answers.json of a folder of recordings. Raises ConfigError."""
    file = folder / ANSWERS
    return converted(file, read_json(file, "a JSON file with the answers"), list[Answer])


def si(true: TrueEffect) -> Values:
    """Parameters of an effect of the catalogue in SI."""
    q = {q.name: q.si for q in catalogue()[true.effect].parameters}
    return {name: v if isinstance(v, str) else v * q[name] for name, v in true.parameters.items()}


def fingerprint() -> str:
    """Hash of the code that simulates and diagnoses: results of one and of another build are not to be mixed."""
    return fingerprint_of("drd.effects", "drd_tools.diagnose", "drd_tools.simulate")


def _line(row: Head | Row) -> str:
    return json.dumps(plain(row), allow_nan=False) + "\n"


def _form(row: dict[str, Any]) -> Any:
    forms = {"not_made": NotMade, "plantings": Untouched, "base": Planted}
    return next((form for key, form in forms.items() if key in row), Record)
