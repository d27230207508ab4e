"""The daemon's health as ROS 2 diagnostics."""

import math
from collections.abc import Mapping
from typing import Any, Final

from drd.output.cdr import Diagnostic
from drd.samples import Validity

OK, WARN, ERROR = 0, 1, 2
# Levels as robot_monitor colours them. The rest are warnings: initialising is temporary, and no worse than degraded.
LEVELS: Final = {Validity.VALID: OK, Validity.INVALID: ERROR}


def diagnostics(health: Mapping[str, Any]) -> list[Diagnostic]:
    """Status of the pose (validity and reasons) and, if they run, of recorder and monitor."""
    validity, robot = Validity(health["validity"]), health["robot"]
    reasons = {reason["source"]: reason["text"] for reason in health["reasons"]}
    message = "; ".join([validity.value, *(f"{source}: {text}" for source, text in reasons.items())])
    found = [Diagnostic(LEVELS.get(validity, WARN), "drd: pose", message, robot, reasons | _scalars(health))]
    if (recording := health.get("recording")) is not None:
        trouble = recording["reason"]
        level = OK if trouble is None else WARN
        found.append(Diagnostic(level, "drd: recording", trouble or "recording", robot, _scalars(recording)))
    if (monitor := health.get("monitor")) is not None:
        texts = [finding["text"] for finding in health["findings"] if finding["until_ns"] is None]
        message = "; ".join(texts) or monitor["reason"] or monitor["state"]
        found.append(Diagnostic(WARN if texts else OK, "drd: monitor", message, robot, _scalars(monitor)))
    return found


def _scalars(values: Mapping[str, Any]) -> dict[str, str]:
    """Numbers and strings only, without nested and unknown values."""
    return {
        name: f"{value:.6g}" if isinstance(value, float) else str(value)
        for name, value in values.items()
        if isinstance(value, str | int) or (isinstance(value, float) and math.isfinite(value))
    }
