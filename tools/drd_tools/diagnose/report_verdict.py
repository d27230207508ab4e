"""The verdict of a diagnosis, in three sentences."""

from collections.abc import Mapping, Sequence
from typing import Any, Final

from drd_tools.diagnose.report_text import FIXED, channel, length, listed, named_quantity, parameters, percent, rms

Section = Mapping[str, Any]

ALL: Final = 0.005  # less than this share is left

TITLES: Final = {
    "nothing_missing": "nothing is missing",
    "explained": "explained",
    "partly_explained": "partly explained",
    "unknown": "a cause that is in no catalogue",
}


def title(d: Section, names: Sequence[str]) -> str:
    """Of the page."""
    shown = names[0] if len(names) == 1 else f"{names[0]} and {len(names) - 1} more"
    return f"Diagnosis of {shown}: {TITLES[d['verdict']]}"


def lead(d: Section, s: Section) -> list[str]:
    """At most three sentences: what was found, how sure that is, what it explains and what is left."""
    if not d["findings"]:
        return _nothing(d, s)
    return [_what(d["findings"]), _how_sure(d["findings"]), _what_is_left(d, s)]


def _nothing(d: Section, s: Section) -> list[str]:
    length_s = sum(r["duration_s"] for r in s["recordings"])
    metres = sum(r["path_m"] for r in s["recordings"])
    drive = f"{length_s / 60.0:.3g} minutes and {metres:.4g} m"
    if d["verdict"] == "nothing_missing":
        first = f"Over {drive} the recording agrees with the nominal model: no effect beyond what noise alone brings."
    else:
        first = f"Over {drive} something is left that the noise does not bring, but nothing could be named."
    size = rms(s["residual"]["before"])
    second = "" if size is None else f"Its residual is {size:.3g} times what the noise alone gives."
    if all(r["path"]["reference"] is None for r in s["recordings"]):
        third = (
            "Without a reference the sensors could only be judged against each other: an error of the path that both "
            "gyro and wheels share is not excluded."
        )
    else:
        third = "How small an error may be and still have been seen is listed below, effect by effect."
    return [sentence for sentence in (first, second, third) if sentence]


def _what(findings: Sequence[Section]) -> str:
    named = [f for f in findings if _is_named(f)]
    unknown = [f for f in findings if not _is_named(f)]
    parts = []
    if named:
        count = "one effect" if len(named) == 1 else f"{len(named)} effects"
        parts.append(f"the nominal model leaves out {count}: {listed(_named(f, len(findings) == 1) for f in named)}")
    if unknown:
        channels = listed(dict.fromkeys(channel(f) for f in unknown))
        drivers = listed(dict.fromkeys(f["driver"].replace("_", " ") for f in unknown if f["driver"]))
        goes_with = f"goes with {drivers}" if drivers else "goes with no variable that was tried"
        parts.append(f"something that is in no catalogue acts on the {channels} and {goes_with}")
    text = "; besides, ".join(parts)
    return f"{text[0].upper()}{text[1:]}."


def _named(f: Section, with_values: bool) -> str:
    values = [value for value in parameters(f) if FIXED not in value] if with_values else []
    shown = f" ({', '.join(values)})" if values else ""
    rivals = f" (or {listed(f['also_fits'], 'or')}, which fits as well)" if f["also_fits"] else ""
    return f"{f['effect']}{shown}{rivals}"


def _how_sure(findings: Sequence[Section]) -> str:
    worst = max((f["evidence"]["family_wise_p"] for f in findings if f["evidence"]["family_wise_p"] is not None), default=None)  # fmt: skip  # noqa: E501
    chance = "" if worst is None else (
        f"; a recording in which nothing is missing would bring such a claim in {percent(worst)} of cases"
        + (" at most" if len(findings) > 1 else "")
    )  # fmt: skip
    if len({f["status"] for f in findings}) == 1:
        who = "This is" if len(findings) == 1 else "Both are" if len(findings) == 2 else "All of them are"
        return f"{who} {findings[0]['status']}{chance}."
    shown = listed(f"{_name(f)} is {f['status']}" for f in findings)
    return f"Of these, {shown}{chance}."


def _what_is_left(d: Section, s: Section) -> str:
    parts = [_share(d)] if _share(d) else []
    end_m = d["unexplained"]["end_error_m"]
    if end_m is not None:
        parts.append(
            f"the end of the path is {'still ' if any(map(_is_named, d['findings'])) else ''}{length(end_m)} off"
        )
    row = next((r for r in s["held_out"] if None not in (r["before"], r["after"])), None)
    if row is not None:
        name, unit = named_quantity(row["quantity"], row["unit"])
        goes = "goes" if row["after"] < row["before"] else "does not fall: it goes"
        parts.append(f"on unseen data the {name} {goes} from {row['before']:.3g} to {row['after']:.3g} {unit}".rstrip())
    text = "; ".join(parts) or "how much of the mismatch that explains is not known"
    return f"{text[0].upper()}{text[1:]}."


def _share(d: Section) -> str:
    """How much is explained; where something has no name, the shares one by one."""
    findings, left = d["findings"], d["unexplained"]["share_of_residual"]
    if all(map(_is_named, findings)) and left is not None:
        who, ending = ("It explains", "s") if len(findings) == 1 else ("Together they explain", "")
        if left < ALL:
            return f"{who} all of the mismatch that the noise does not"
        return f"{who} {percent(1.0 - left)} of the mismatch and leave{ending} {percent(left)}"
    known = [f for f in findings if f["explains"] is not None]
    if len(findings) == 1:
        return f"it makes up {percent(known[0]['explains'])} of the mismatch" if known else ""
    shares = [f"{_name(f)} {percent(f['explains'])}" for f in known]
    return f"shares of the mismatch: {listed(shares)}" if shares else ""


def _name(f: Section) -> str:
    return str(f["effect"]) if _is_named(f) else "the unknown one"


def _is_named(f: Section) -> bool:
    return bool(f["effect"] != "unknown")
