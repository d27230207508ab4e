"""The file of what the monitor knows: kept over restarts; what cannot be used is put aside, counted and told."""

import hashlib
from dataclasses import replace
from pathlib import Path

import pytest

from drd.config.keys import Config
from drd.config.schema import loads
from drd.monitor.memory import EARLIEST_NS, Day, Memory
from drd.state.memory_file import MemoryKeeper, basis_of, decoded, encoded
from drd.state.sealed import StateError

DAY = Day(EARLIEST_NS + 1, 12.5, (0.1, -1e-3, 0.1 + 0.2), (1e-3, 1e-4, 0.1))


@pytest.fixture
def config(tmp_path: Path) -> Config:
    text = f"robot: {{wheel_radius_m: 0.11, tread_m: 0.6}}\nstate: {{folder: {tmp_path}}}\n"
    return loads(text, Config).value


def begun(config: Config) -> MemoryKeeper:
    keeper = MemoryKeeper(config)
    keeper.begin()
    return keeper


def test_it_is_as_it_was_after_a_restart(config: Config) -> None:
    first, basis = begun(config), basis_of(config, None)
    assert first.memory(basis) == Memory(basis)
    first.put(replace_way(DAY, 3.0))
    first.put(DAY)  # of the same drive
    assert first.close(10.0)
    second = begun(config)
    assert second.memory(basis) == Memory(basis, [DAY])
    assert (second.health() or {})["days"] == 1
    assert second.close(10.0)


def replace_way(day: Day, distance_m: float) -> Day:
    return Day(day.wall_ns, distance_m, day.values, day.sigmas)


def test_another_robot_begins_with_nothing(config: Config) -> None:
    keeper, basis = begun(config), basis_of(config, None)
    keeper.memory(basis)
    keeper.put(DAY)
    larger = basis_of(replace(config, robot=replace(config.robot, tread_m=0.7)), None)
    assert larger != basis
    assert keeper.memory(larger) == Memory(larger)
    assert keeper.close(10.0)


def head(body: bytes, version: int = 1) -> bytes:
    return f"drd-memory/{version} sha256={hashlib.sha256(body).hexdigest()}\n".encode() + body


LATER_FIRST = Memory("x", [DAY, Day(EARLIEST_NS, 1.0, DAY.values, DAY.sigmas)])


@pytest.mark.parametrize(
    ("data", "text"),
    [
        (b"", "does not begin"),
        (encoded(Memory("x", [DAY]))[:-9], "checksum"),
        (head(b"{}", 7), "version 7; this drd reads version 1"),
        (head(b'{"basis": 3}'), "Expected `str`"),
        (head(b'{"basis": "x", "days": [[]]}'), "Expected `object`"),
        (encoded(LATER_FIRST), "order of time"),
    ],
)
def test_a_broken_or_old_file_is_put_aside_counted_and_told(
    config: Config, tmp_path: Path, data: bytes, text: str, caplog: pytest.LogCaptureFixture
) -> None:
    with pytest.raises(StateError, match=text):
        decoded(data)
    file = tmp_path / "robot.memory"
    file.write_bytes(data)
    keeper = begun(config)
    assert keeper.memory("x") == Memory("x")
    assert (keeper.health() or {})["refused"] == 1
    assert text in caplog.text
    assert (tmp_path / "robot.memory.refused-1").read_bytes() == data
    assert keeper.close(10.0)


def test_nothing_is_kept_without_a_folder(config: Config, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("STATE_DIRECTORY", raising=False)
    keeper = begun(replace(config, state=replace(config.state, folder=None)))
    assert keeper.memory("x") is None
    keeper.put(DAY)
    assert keeper.health() is None
    assert keeper.close(1.0)
