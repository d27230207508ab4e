"""Results of a trial as classes, and the one place where they are read and written.

`Record`: a recording whose answer is known, with its diagnosis. `Untouched` and `Planted`: those of a real drive, as it
is and with an effect planted in its raw data. `NotMade`: a case that no drive showed. `Store`: the file of a trial, a
line of JSON per row, added as it becomes ready, so that a stopped trial resumes. Parameters are in catalogue units.
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
    """A true effect of a recording. `detectability`: its whitened distance d, the square root of the noncentrality.

    `rival`: the best surrogate without noise, another name or none (""), worse by `margin_nats`; `separable`: by more
    than the names of one class differ. `nearest`: the nearest surrogate, at the whitened `distance`, with no name
    preferred. `ceiling`: probability of choosing correctly between these two, if equally likely, that no method
    exceeds; `least`: the one that the best method attains among all names, sizes known. (93) `own`: sizes that the
    untouched real drive already has, though not reported.
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
    """One drive of a robot. MuJoCo has its own temperature; only MuJoCo uses the friction."""

    mission: str
    temperature: str
    seconds: float
    seed: int
    friction: float


class Stress(Struct, frozen=True):
    """Noise relative to the datasheets, degrees of freedom of its tails, and errors of the reference."""

    gyro_noise: float
    wheel_noise: float
    reference_noise: float
    tails: float
    latency_s: float
    sideways_m: float
    yaw_deg: float


class Mismatch(Struct):
    """A figure of another drive without a model, with the diagnosed one, and with the true effects (the oracle)."""

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
    """A recording's answer, and the diagnosis's findings, the best first; a failed diagnosis has an `error`.

    `baselines`: names that other methods select, the best first. `truth_nats`: score of the true effects, refined,
    minus that of the effects found: above 0 the search missed the better answer; below, the evidence favours the wrong
    one.
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
    """An untouched real drive: the effects that it can show, by the case that plants each, and the others.

    `lag_s`: lag of its reference.
    """

    plantings: dict[str, TrueEffect]
    not_visible: list[str]
    lag_s: float = 0.0


class Planted(Record, kw_only=True):
    """A real drive, `base`, with one effect planted in its raw data."""

    base: str


class NotMade(Struct):
    """A case that could not be made, and why."""

    case: str
    kind: str
    not_made: str


Row = Record | NotMade


class Head(Struct, kw_only=True):
    """Settings that determine the cases, and the build that diagnosed them. `plant`: the folder of real drives."""

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
    """Results of a trial in a folder."""

    def __init__(self, folder: Path):
        self.file = folder / RESULTS

    def begin(self, head: Head) -> list[Row]:
        """Resume from the existing results, or begin; return the existing ones.

        Results of another build of the diagnosis are moved aside. Raises ConfigError if they belong to other cases
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
                self._write([was, *rows])  # drops a truncated last line
                return rows
            self.file.replace(self.file.with_name(OLD))
        self._write([head])
        return []

    def add(self, row: Row) -> None:
        """Keep a row. Raises OSError."""
        with self.file.open("a", encoding="utf-8") as out:
            out.write(_line(row))

    def read(self) -> tuple[Head, list[Row]]:
        """Read head and rows. A truncated last line does not count. Raises ConfigError."""
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
    """Write rows of another trial, one JSON object per line. Raises OSError."""
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_bytes(b"".join(msgspec.json.encode(row) + b"\n" for row in rows))


def read_answers(folder: Path) -> list[Answer]:
    """Read answers.json of a folder of recordings. Raises ConfigError."""
    file = folder / ANSWERS
    return converted(file, read_json(file, "a JSON file with the answers"), list[Answer])


def si(true: TrueEffect) -> Values:
    """Parameters of an effect of the catalogue in SI."""
    q = {q.name: q.si for q in catalogue()[true.effect].parameters}
    return {name: v if isinstance(v, str) else v * q[name] for name, v in true.parameters.items()}


def fingerprint() -> str:
    """Hash of the code that simulates and diagnoses: results of different builds must not be mixed."""
    return fingerprint_of("drd.effects", "drd_tools.diagnose", "drd_tools.simulate")


def _line(row: Head | Row) -> str:
    return json.dumps(plain(row), allow_nan=False) + "\n"


def _form(row: dict[str, Any]) -> Any:
    forms = {"not_made": NotMade, "plantings": Untouched, "base": Planted}
    return next((form for key, form in forms.items() if key in row), Record)
