"""Results of recordings, made by hand."""

from pathlib import Path

import diagnosis_files
from msgspec.structs import replace

from drd_tools.diagnose.files import load
from drd_tools.diagnose.results import Amount, Finding, Result, Smallest, Status, Support, Unexplained, Verdict


def said(folder: Path, name: str, end_error_m: float | None = None) -> Result:
    result, _ = load(diagnosis_files.write(folder, diagnosis_files.nothing_missing()))
    return replace(result, recording=name, unexplained=Unexplained(0.0, end_error_m))


def tread(value: float, std: float = 0.002) -> Finding:
    return Finding(
        effect="tread_error", status=Status.CONFIRMED, also_fits=(), acts_on="wheels", windows=((0.0, 1.0),),
        parameters={"k": Amount(value, std, "1")}, covariate="yaw_rate", evidence=Support(50.0, 0.001, 1e9),
        explains=1.0, sentence="Found.",
    )  # fmt: skip


def seeing(folder: Path, smallest: float, *findings: Finding) -> Result:
    result = replace(said(folder, "other"), detectable={"tread_error": Smallest(smallest, "1")}, findings=findings)
    return replace(result, recording=f"{len(findings)} at {smallest} of {findings}", verdict=Verdict.EXPLAINED)
