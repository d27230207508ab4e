"""Packages that drd needs on a robot, from the metadata of installed distributions."""

import importlib.metadata
from collections.abc import Iterable
from typing import NamedTuple

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

# Extras that a robot may have: encoders described by a DBC file, the web page.
ROBOT_EXTRAS = ("dbc", "web")


class Package(NamedTuple):
    """An installed distribution; `requires`: names of those that it needs here."""

    name: str
    version: str
    metadata: "importlib.metadata.PackageMetadata"
    requires: tuple[str, ...]


def installed(extras: Iterable[str] = ROBOT_EXTRAS) -> dict[str, Package]:
    """Find drd and its dependencies with these extras, by canonical name, drd first.

    Raises importlib.metadata.PackageNotFoundError if one is not installed.
    """
    found: dict[str, Package] = {}
    waiting = [("drd", frozenset(extras))]
    done: set[tuple[str, frozenset[str]]] = set()
    while waiting:
        entry = waiting.pop()
        if entry in done:
            continue
        done.add(entry)
        name, wanted = entry
        distribution = importlib.metadata.distribution(name)
        needed = [r for r in map(Requirement, distribution.requires or ()) if _applies(r, wanted)]
        requires = {str(canonicalize_name(r.name)) for r in needed} - {name}
        before = found[name].requires if name in found else ()
        found[name] = Package(name, distribution.version, distribution.metadata, tuple(sorted({*before, *requires})))
        waiting += [(str(canonicalize_name(r.name)), frozenset(r.extras)) for r in needed]
    return found


def _applies(requirement: Requirement, extras: frozenset[str]) -> bool:
    """Whether it is needed on this Python with one of these extras, or with none."""
    marker = requirement.marker
    return marker is None or any(marker.evaluate({"extra": extra}) for extra in ("", *extras))
