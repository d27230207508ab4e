"""Engines: the same bits from each, and what a killed worker had is done elsewhere."""

import os
import signal
import threading
import time
from pathlib import Path

import pytest
from fleet_stub import fleet, killing, slow, stubbed

from drd.config.schema import ConfigError
from drd_tools.fleet import engine as engine_module
from drd_tools.fleet.engine import Engine
from drd_tools.fleet.store import Store
from drd_tools.fleet.update import KILLED, Updated, update

distributed = pytest.importorskip("distributed", reason="dask.distributed is not installed")
POOL, CLUSTER = Engine(jobs=2), Engine(cluster=2)


def bits(folder: Path) -> dict[str, bytes]:
    return {str(f.relative_to(folder)): f.read_bytes() for f in sorted(folder.rglob("*.parquet"))}


def test_every_engine_gives_the_same_bits(tmp_path: Path) -> None:
    runs = fleet(tmp_path / "runs", 6)
    with distributed.LocalCluster(n_workers=1, threads_per_worker=2, dashboard_address="127.0.0.1:0") as cluster:
        engines = {"pool": POOL, "one": Engine(), "running": Engine(scheduler=cluster.scheduler_address)}
        for name, engine in engines.items():
            assert update([runs], Store(tmp_path / name), (), engine, stubbed) == Updated(6, 6, 0, 0, [])
    found = [bits(tmp_path / name) for name in engines]
    assert len(found[0]) == 4
    assert found[0] == found[1] == found[2]


@pytest.mark.parametrize("engine", [POOL, CLUSTER], ids=["pool", "dask"])
def test_what_killed_workers_had_is_done_elsewhere(tmp_path: Path, engine: Engine) -> None:
    runs, store = fleet(tmp_path / "runs", 6), tmp_path / "store"
    made = update([runs], Store(store), (), engine, killing)
    assert (runs / "killed").exists()
    assert made == Updated(6, 6, 0, 0, [("run_003", KILLED)])
    assert Store(store).table("constants").num_rows == 10
    # What had no chance is tried again; all else is as if nobody had been killed.
    assert update([runs], Store(store), (), Engine(), stubbed) == Updated(6, 1, 0, 0, [])
    update([runs], Store(tmp_path / "quiet"), (), Engine(), stubbed)
    assert bits(store) == bits(tmp_path / "quiet")


@pytest.mark.parametrize("engine", [POOL, CLUSTER], ids=["pool", "dask"])
def test_a_worker_that_somebody_kills_is_replaced(tmp_path: Path, engine: Engine) -> None:
    runs, killed = fleet(tmp_path / "runs", 8), list[int]()

    def kill() -> None:
        deadline_s = time.monotonic() + 60.0
        while not list(tmp_path.glob("store/pending/*.parquet")) and time.monotonic() < deadline_s:
            time.sleep(0.02)
        killed.append(_workers()[-1])
        os.kill(killed[0], signal.SIGKILL)

    killer = threading.Thread(target=kill)
    killer.start()
    made = update([runs], Store(tmp_path / "store"), (), engine, slow)
    killer.join()
    assert killed
    assert made == Updated(8, 8, 0, 0, [])
    update([runs], Store(tmp_path / "quiet"), (), Engine(), stubbed)
    assert bits(tmp_path / "store") == bits(tmp_path / "quiet")


def _workers() -> list[int]:
    """Processes that this one has spawned, but for those that keep book of semaphores."""
    found = []
    for children in Path("/proc/self/task").glob("*/children"):
        for pid in map(int, children.read_text().split()):
            if b"spawn_main" in Path(f"/proc/{pid}/cmdline").read_bytes():
                found.append(pid)
    return sorted(found)


def test_a_scheduler_that_is_not_there_is_an_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(engine_module, "REACH_S", 0.5)
    runs = fleet(tmp_path / "runs", 1)
    with pytest.raises(ConfigError, match="running Dask scheduler"):
        update([runs], Store(tmp_path / "store"), (), Engine(scheduler="tcp://127.0.0.1:1"), stubbed)
