"""Several recordings, each diagnosed by itself: what they say together."""

import math
from collections.abc import Sequence
from typing import Any, Final

from drd.effects.catalogue import catalogue
from drd_tools.diagnose.joint import Share, together

ORDER: Final = ("suspected", "supported", "confirmed")
# Values of one parameter further apart than this, in sigmas of their difference, are not one value.
APART_SIGMAS: Final = 4.0


def pooled(contents: Sequence[dict[str, Any]], shares: Sequence[Share]) -> dict[str, Any]:
    """One diagnosis.json of several. A lasting effect's parameters are combined with the inverse of their variances.

    Where they contradict each other their scatter replaces their sigma; effects of one run only stay as they are. What
    only all together show comes to it (`joint`).
    """
    findings: list[dict[str, Any]] = []
    for name, parts in _grouped(contents).items():
        if name == "unknown" or not catalogue()[name].lasting:
            findings += [{**f, "sentence": f"{r}: {f['sentence']}"} for r, f in parts]
            continue
        found = [f for _, f in parts]
        best = max(found, key=lambda f: float(f["evidence"]["gain_nats"]))
        evidence = {
            "gain_nats": sum(float(f["evidence"]["gain_nats"]) for f in found),
            "family_wise_p": min(1.0, min(float(f["evidence"]["family_wise_p"]) for f in found) * len(contents)),
            "e_value": math.exp(min(690.0, sum(math.log(max(float(f["evidence"]["e_value"]), 1e-300)) for f in found))),
        }
        where = ", ".join(r for r, _ in parts)
        findings.append({
            **best,
            "status": max((f["status"] for f in found), key=ORDER.index),
            "also_fits": sorted(set.intersection(*(set(f["also_fits"]) for f in found))),
            "parameters": _combined(found),
            "seen": _united(found),
            "evidence": evidence,
            "explains": sum(float(f["explains"]) for f in found) / len(contents),
            "sentence": f"{best['sentence']} Found in {len(parts)} of {len(contents)} recordings ({where}).",
        })  # fmt: skip
    _put_stand_ins_together(findings)
    common = together(shares, {f["effect"] for f in findings})
    findings = sorted([*findings, *common], key=lambda f: -float(f["evidence"]["gain_nats"]))
    verdicts = {c["verdict"] for c in contents} | ({"explained"} if common else set())
    named = any(f["effect"] != "unknown" for f in findings)
    mixed = "partly_explained" if named and len(verdicts - {"nothing_missing", "explained"}) else "explained"
    claimed = {f["effect"] for f in findings}
    return {
        "schema": 1,
        "recording": ", ".join(c["recording"] for c in contents),
        "verdict": verdicts.pop() if len(verdicts) == 1 else mixed if named else "unknown",
        "findings": findings,
        "unexplained": {
            "share_of_residual": max(float(c["unexplained"]["share_of_residual"]) for c in contents),
            "end_error_m": max((c["unexplained"]["end_error_m"] or 0.0 for c in contents), default=0.0),
        },
        "ruled_out": [r for r in contents[0]["ruled_out"] if r["effect"] not in claimed],
        "detectable": _most_sensitive(contents),
        "classes": [c for c in contents[0]["classes"] if all(c in other["classes"] for other in contents)],
        "fit": {"train": _side_by_side(contents), "held_out": contents[0]["fit"]["held_out"]},
        "next_drive": next((c["next_drive"] for c in contents if c["next_drive"]), None),
    }


def _put_stand_ins_together(findings: Sequence[dict[str, Any]]) -> None:
    """Each name stands in once, as all recordings have it that need it, and not beside itself."""
    named = {f["effect"] for f in findings}
    groups: dict[str, list[dict[str, Any]]] = {}
    for finding in findings:
        near = finding.setdefault("stand_in", None)
        if near is not None and near["effect"] not in named:
            groups.setdefault(near["effect"], []).append({"seen": {}, **near})
            if len(groups[near["effect"]]) == 1:
                continue
        finding["stand_in"] = None
    for finding in findings:
        if finding["stand_in"] is not None:
            terms = groups[finding["stand_in"]["effect"]]
            finding["stand_in"] |= {"parameters": _combined(terms)} | ({"seen": s} if (s := _united(terms)) else {})


def _side_by_side(contents: Sequence[dict[str, Any]]) -> dict[str, dict[str, float]]:
    return {
        when: {f"{c['recording']}: {q}": v for c in contents for q, v in c["fit"]["train"][when].items()}
        for when in ("before", "after")
    }


def _grouped(contents: Sequence[dict[str, Any]]) -> dict[str, list[tuple[str, dict[str, Any]]]]:
    groups: dict[str, list[tuple[str, dict[str, Any]]]] = {}
    for content in contents:
        for finding in content["findings"]:
            groups.setdefault(finding["effect"], []).append((content["recording"], finding))
    return groups


def _united(findings: Sequence[dict[str, Any]]) -> dict[str, list[float]]:
    """The range that the recordings have seen together."""
    drivers = {driver for f in findings for driver in f["seen"]}
    ends = {driver: [f["seen"][driver] for f in findings if driver in f["seen"]] for driver in sorted(drivers)}
    return {driver: [min(e[0] for e in found), max(e[1] for e in found)] for driver, found in ends.items()}


def _combined(findings: Sequence[dict[str, Any]]) -> dict[str, Any]:
    shown: dict[str, Any] = {}
    for name, first in findings[0]["parameters"].items():
        values = [f["parameters"][name] for f in findings if name in f["parameters"]]
        if not isinstance(first, dict) or any(not v["std"] > 0.0 for v in values):
            shown[name] = first
            continue
        weights = [v["std"] ** -2 for v in values]
        mean = sum(w * v["value"] for w, v in zip(weights, values, strict=True)) / sum(weights)
        std = sum(weights) ** -0.5
        scatter = math.sqrt(
            sum(w * (v["value"] - mean) ** 2 for w, v in zip(weights, values, strict=True)) / sum(weights)
        )
        apart = any(abs(v["value"] - mean) > APART_SIGMAS * math.hypot(v["std"], std) for v in values)
        shown[name] = {**first, "value": mean, "std": max(std, scatter) if apart else std}
    return shown


def _most_sensitive(contents: Sequence[dict[str, Any]]) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for content in contents:
        for name, size in content["detectable"].items():
            if name not in found or size["smallest"] < found[name]["smallest"]:
                found[name] = size
    return found
