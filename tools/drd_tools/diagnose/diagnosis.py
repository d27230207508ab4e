"""The diagnosis of a recording, or of several together, with its model and files."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import msgspec

from drd.effects.model import Model, save_model
from drd_tools.diagnose import files
from drd_tools.diagnose.combine.statistics import SufficientStatistics
from drd_tools.diagnose.results import Finding, Result, Term, Verdict
from drd_tools.diagnose.series import Series


@dataclass(frozen=True)
class Diagnosis:
    """The result, the series to be drawn, and the model: the nominal robot with the effects found.

    `statistics`: its contribution to a joint regression. `stand_ins`: for each finding the name that may stand in for
    it, not yet validated.
    """

    result: Result
    series: Series
    model: Model
    statistics: SufficientStatistics | None = None
    stand_ins: Sequence[Term | None] = ()

    @property
    def verdict(self) -> Verdict:
        """The verdict, one word."""
        return self.result.verdict

    @property
    def findings(self) -> tuple[Finding, ...]:
        """Findings, the largest share of the mismatch first."""
        return self.result.findings

    @property
    def notes(self) -> tuple[str, ...]:
        """Sentences about the recording."""
        return self.result.notes or ()

    def with_stand_ins(self) -> Result:
        """The result, before the findings lost what may stand in for them."""
        findings = zip(self.result.findings, self.stand_ins, strict=True)
        with_them = tuple(msgspec.structs.replace(f, surrogate=term) for f, term in findings)
        return msgspec.structs.replace(self.result, findings=with_them)

    def report(self, folder: Path) -> list[Path]:
        """Write diagnosis.json, series.json, model.yaml and the report into a folder; the files. Raises OSError."""
        from drd_tools.diagnose.report.page import write_report  # noqa: PLC0415  # matplotlib is slow

        folder.mkdir(parents=True, exist_ok=True)
        save_model(folder / "model.yaml", self.model)
        files.save(folder, self.result, self.series)
        return [folder / files.DIAGNOSIS, folder / "model.yaml", *write_report(folder)]
