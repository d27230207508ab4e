"""The state's file on good disks and bad ones."""

import os
import threading
import time
from pathlib import Path

import pytest

from drd.config.keys import Config, Robot, State
from drd.estimation.basis import Basis
from drd.estimation.estimate import Estimate
from drd.estimation.filter import Filter
from drd.estimation.noise import NoiseProfile
from drd.estimation.state import Sigmas
from drd.state import store as store_module
from drd.state.saved import Moment, Saved, decoded, encoded
from drd.state.sealed import StateError
from drd.state.store import KEPT_ASIDE, Store, state_file


def saved(x_m: float = 0.0) -> Saved:
    kf = Filter(0.5, Sigmas(0.1, 0.1, 0.01, 0.01, 0.01, 0.01), NoiseProfile(comparison_rad2=1e-6))
    kf.nominal.x_m = x_m
    return Saved(Estimate(kf.nominal, kf.P, True, False, 0.0, 0.0), Moment(1, 1, ""), Basis({}, {}, {}), "robot")


def wait(condition: object, store: Store[Saved], timeout_s: float = 10.0) -> None:
    deadline = time.monotonic() + timeout_s
    while not condition():  # type: ignore[operator]
        assert time.monotonic() < deadline, store.health()
        time.sleep(0.005)


def test_the_last_state_is_there_after_the_end_and_nothing_else(tmp_path: Path) -> None:
    store = Store(tmp_path / "new" / "folder" / "robot.state", encoded, decoded)
    assert store.load() is None
    store.start()
    for i in range(50):
        store.put(saved(float(i)))
    assert store.close(10.0)
    found = store.load()
    assert found is not None
    assert found.estimate.nominal.x_m == 49.0
    assert [f.name for f in store.file.parent.iterdir()] == ["robot.state"]
    assert store.counters["written"] + store.counters["superseded"] == 50
    assert store.trouble is None


def test_a_disk_that_hangs_never_holds_the_caller_up_and_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    store, release = Store(tmp_path / "robot.state", encoded, decoded), threading.Event()
    fsync = os.fsync
    monkeypatch.setattr(os, "fsync", lambda fd: (release.wait(30.0), fsync(fd)))
    monkeypatch.setattr(store_module, "SLOW_NS", 50_000_000)
    store.start()
    for i in range(100):
        store.put(saved(float(i)))
    wait(lambda: store.trouble is not None, store)
    assert "has not taken it for" in (store.trouble or "")
    assert store.counters["superseded"] >= 98
    assert not store.close(0.05)
    release.set()
    assert store.close(10.0)
    found = store.load()
    assert found is not None
    assert found.estimate.nominal.x_m == 99.0
    assert store.trouble is None


def test_a_full_disk_is_told_leaves_the_old_state_and_is_tried_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    store, full = Store(tmp_path / "robot.state", encoded, decoded), [False]
    fsync = os.fsync

    def maybe(fd: int) -> None:
        if full[0]:
            raise OSError(28, os.strerror(28))
        fsync(fd)

    monkeypatch.setattr(os, "fsync", maybe)
    store.start()
    store.put(saved(1.0))
    wait(lambda: store.counters["written"] == 1, store)
    full[0] = True
    store.put(saved(2.0))
    wait(lambda: store.counters["errors"] == 1, store)
    assert store.trouble == f"{store.file}: No space left on device"
    assert decoded(store.file.read_bytes()).estimate.nominal.x_m == 1.0
    assert [f.name for f in tmp_path.iterdir()] == ["robot.state"]
    full[0] = False
    store.put(saved(3.0))
    assert store.close(10.0)
    assert store.trouble is None
    assert decoded(store.file.read_bytes()).estimate.nominal.x_m == 3.0


def test_a_power_cut_at_any_moment_leaves_the_old_state_or_the_new_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each step of the replacement is the last one once: what the folder holds then must be loadable."""
    file = tmp_path / "robot.state"
    store_module.replace_file(file, b"old")
    steps: list[str] = []

    class Cut(BaseException):
        pass

    def counted(name: str, limit: int) -> object:
        real = getattr(os, name)

        def call(*arguments: object, **options: object) -> object:
            if len(steps) == limit:
                raise Cut
            steps.append(name)
            return real(*arguments, **options)

        return call

    for limit in range(4):
        steps.clear()
        with monkeypatch.context() as patch:
            for name in ("fsync", "rename"):
                patch.setattr(os, name, counted(name, limit))
            try:
                store_module.replace_file(file, b"new %d" % limit)
            except Cut:
                assert limit < 3
        assert file.read_bytes() in (b"old", b"new 1", b"new 2", b"new 3")
    # Data are on the disk before they get the name, and the name before the call ends.
    assert steps == ["fsync", "rename", "fsync"]
    assert file.read_bytes() == b"new 3"


def test_a_refused_file_is_kept_aside_and_only_so_many(tmp_path: Path) -> None:
    file = tmp_path / "robot.state"
    for i in range(KEPT_ASIDE + 3):
        file.write_bytes(b"garbage %d" % i)
        store = Store(file, encoded, decoded)
        with pytest.raises(StateError, match=rf"does not begin as .*kept as robot.state.refused-{i + 1}$"):
            store.load()
        assert not file.exists()
        assert store.counters["refused"] == 1
    kept = {f.name: f.read_bytes() for f in tmp_path.iterdir()}
    first = 1 + 3
    assert kept == {f"robot.state.refused-{i}": b"garbage %d" % (i - 1) for i in range(first, first + KEPT_ASIDE)}
    store = Store(file, encoded, decoded)
    store.start()
    store.put(saved())
    assert store.close(10.0)
    assert store.load() is not None
    assert {f.name for f in tmp_path.iterdir()} == {"robot.state", *kept}


def test_a_refused_file_that_cannot_be_moved_is_never_replaced(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = tmp_path / "robot.state"
    file.write_bytes(b"drd-state/7 sha256=" + b"0" * 64 + b"\n{}")

    def refuse(*_: object) -> None:
        raise OSError(30, os.strerror(30))

    store = Store(file, encoded, decoded)
    with monkeypatch.context() as patch:
        patch.setattr(Path, "rename", refuse)
        with pytest.raises(StateError, match=r"version 7; .* cannot be moved aside: Read-only file system"):
            store.load()
    store.start()
    store.put(saved())
    assert store.close(10.0)
    assert file.read_bytes().startswith(b"drd-state/7")
    assert "no state is kept" in (store.trouble or "")


def test_a_file_too_large_to_be_a_state_is_not_read_whole(tmp_path: Path) -> None:
    file = tmp_path / "robot.state"
    with file.open("wb") as stream:
        stream.truncate(1 << 40)  # sparse
    with pytest.raises(StateError, match="more than"):
        Store(file, encoded, decoded).load()


@pytest.mark.parametrize(
    ("folder", "service", "expected"),
    [
        (None, None, None),
        (None, "", None),
        (None, "/var/lib/drd-a", "/var/lib/drd-a/my_robot_1.state"),
        (None, "/var/lib/drd-a:/var/lib/b", "/var/lib/drd-a/my_robot_1.state"),
        ("sub", "/var/lib/drd-a", "/var/lib/drd-a/sub/my_robot_1.state"),
        ("/data", "/var/lib/drd-a", "/data/my_robot_1.state"),
        ("sub", None, "sub/my_robot_1.state"),
    ],
)
def test_where_the_state_lies(
    folder: str | None, service: str | None, expected: str | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    robot = Robot(name="my robot/1", wheel_radius_m=0.1, tread_m=0.5)
    if service is None:
        monkeypatch.delenv("STATE_DIRECTORY", raising=False)
    else:
        monkeypatch.setenv("STATE_DIRECTORY", service)
    assert state_file(Config(robot=robot, state=State(folder=folder))) == (Path(expected) if expected else None)
    assert state_file(Config(robot=robot, state=State(folder=folder, enabled=False))) is None
