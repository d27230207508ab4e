"""The content of a state file: written and read exactly, and checked."""

import dataclasses
import json
import time
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Final, NamedTuple

import msgspec
from msgspec import Meta

from drd import __version__
from drd.estimation.basis import Basis
from drd.estimation.estimate import Estimate, estimate_of
from drd.state.sealed import StateError, sealed, unsealed

VERSION: Final = 2
LARGEST_BYTES: Final = 1 << 18
Nanoseconds = Annotated[int, Meta(ge=0, le=2**63 - 1)]
BOOT_ID: Final = Path("/proc/sys/kernel/random/boot_id")


class Moment(NamedTuple):
    """A time on CLOCK_REALTIME, and on CLOCK_BOOTTIME of the boot with that id ("": unknown)."""

    wall_ns: int
    boottime_ns: int
    boot_id: str


def moment_now(boot_id: str) -> Moment:
    """The present of this boot."""
    return Moment(time.time_ns(), time.clock_gettime_ns(time.CLOCK_BOOTTIME), boot_id)


def this_boot(environment: Mapping[str, str]) -> str:
    """The boot's id, "" if unknown. The unit passes it on, since its sandbox hides the kernel's file."""
    boot_id = environment.get("DRD_BOOT_ID", "")
    if not boot_id:
        with suppress(OSError, ValueError):
            boot_id = BOOT_ID.read_text(encoding="ascii")
    # systemd writes the same digits without hyphens.
    return boot_id.strip().replace("-", "")


@dataclass(frozen=True)
class Saved:
    """An estimate, its time, and the basis on which its values were learned."""

    estimate: Estimate
    moment: Moment
    basis: Basis
    robot: str


@dataclass(frozen=True)
class _File:
    """The JSON below the header."""

    robot: str
    wall_ns: Nanoseconds
    boottime_ns: Nanoseconds
    boot_id: str
    estimate: dict[str, Any]
    basis: Basis


def encoded(saved: Saved) -> bytes:
    """The file's bytes. Raises ValueError for an estimate that `decoded` would refuse."""
    plain = saved.estimate.plain()
    estimate_of(plain)
    head = {"robot": saved.robot, "drd": __version__, **saved.moment._asdict()}
    content = head | {"estimate": plain, "basis": dataclasses.asdict(saved.basis)}
    body = json.dumps(content, indent=1, allow_nan=False).encode() + b"\n"
    return sealed("state", VERSION, body)


def decoded(data: bytes) -> Saved:
    """The inverse of `encoded`. Raises StateError; nothing else escapes."""
    body = unsealed("state", VERSION, data)
    try:
        found = msgspec.json.decode(body, type=_File)
        estimate = estimate_of(found.estimate)
    except (ValueError, RecursionError) as error:
        raise StateError(str(error)[:200]) from error
    return Saved(estimate, Moment(found.wall_ns, found.boottime_ns, found.boot_id), found.basis, found.robot)
