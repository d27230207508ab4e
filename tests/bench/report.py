"""What a benchmark measured, as a table for people and as JSON for machines."""

import dataclasses
import os
import platform
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.metadata import version
from typing import Any

from drd_tools.report.terminal import columns


@dataclass(frozen=True)
class Figure:
    """One measured value. `ratio`: how it compares with the benchmark's yardstick, where it has one."""

    name: str
    value: float
    unit: str
    ratio: float | None = None


@dataclass(frozen=True)
class Report:
    """One benchmark's result; `reading` is the line that says how to read it."""

    title: str
    reading: str
    figures: tuple[Figure, ...]


class Refused(Exception):  # noqa: N818  # an outcome: there is no honest figure to print
    """A benchmark's own check failed; the text says which."""


def table(report: Report) -> str:
    """The report as aligned text."""
    rows = [(f.name, f"{f.value:.4g}", f.unit, "" if f.ratio is None else f"x {f.ratio:.2f}") for f in report.figures]
    return "\n".join([report.title, f"  {report.reading}", *columns(rows, text=(0, 2))])


def as_json(reports: Mapping[str, Report], quick: bool) -> dict[str, Any]:
    """All reports, with what the figures depend on."""
    packages = ("numpy", "eclipse-zenoh", "pyserial", "python-can", "filterpy")
    return {
        "quick": quick,
        "machine": {
            "python": platform.python_version(),
            "system": f"{platform.system()} {platform.release()} {platform.machine()}",
            "cores": os.cpu_count(),
            "packages": {name: version(name) for name in packages},
        },
        "benchmarks": {name: dataclasses.asdict(report) for name, report in reports.items()},
    }
