"""The daemon as a user installs it, under a real systemd, on a kernel with a CAN stack. `make vm-test` runs it."""

import os
import shutil
import tempfile
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import pytest
from vm import image, machine
from vm.guest import CHECKS
from vm.table import VERDICTS

from drd.units import S_PER_NS

pytestmark = pytest.mark.vm

KEPT = image.CHECKOUT / "out" / "vm"


class Run(NamedTuple):
    """What the machines left."""

    verdicts: dict[str, dict[str, Any]]
    poses: list[dict[str, Any]]


@pytest.fixture(scope="module")
def run(request: pytest.FixtureRequest) -> Run:
    if (reason := image.missing()) is not None:
        (pytest.fail if os.environ.get("DRD_VM_REQUIRED") else pytest.skip)(f"no virtual machine: {reason}")
    with tempfile.TemporaryDirectory(prefix="drd-vm-", dir=image.workshop()) as folder:
        work = Path(folder)
        left = machine.run(image.build(work), work)
        verdicts = {title: verdict for out in left.values() for title, verdict in machine.results(out).items()}
        made = Run(verdicts, machine.poses_outside(left["driving"]))
        request.config.stash[VERDICTS] = made.verdicts
        shutil.rmtree(KEPT, ignore_errors=True)
        for name, out in left.items():
            shutil.copytree(out, KEPT / name, ignore=shutil.ignore_patterns("__pycache__"))
    return made


@pytest.mark.parametrize("name", CHECKS)
def test_inside(run: Run, name: str) -> None:
    assert name in run.verdicts, f"the machine did not come so far; its logs are in {KEPT}"
    verdict = run.verdicts[name]
    assert verdict["ok"], verdict["evidence"]
    for time_s, limit_s in (
        (verdict["noticed_s"], CHECKS[name].notice_s),
        (verdict["recovered_s"], CHECKS[name].recover_s),
    ):
        assert (time_s is None) == (limit_s is None)
        assert time_s is None or limit_s is None or time_s <= limit_s, verdict


def test_poses_arrive_outside(run: Run) -> None:
    again = (i for i, (a, b) in enumerate(pairwise(run.poses), start=1) if b["sequence"] <= a["sequence"])
    poses = run.poses[: next(again, None)]  # of the first daemon; the second one counts from 1
    assert len(poses) > 0.9 * (poses[-1]["sequence"] - poses[0]["sequence"])  # where nobody takes a pose it is dropped
    taken_s = (poses[-1]["monotonic_ns"] - poses[0]["monotonic_ns"]) * S_PER_NS
    assert taken_s > 20
    assert len(poses) / taken_s > 10  # 20 Hz, less what the faults take
    assert max(abs(pose["x_m"]) for pose in poses if pose["validity"] == "valid") > 1.0
