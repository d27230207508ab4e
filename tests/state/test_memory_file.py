"""The file of what the monitor knows: kept over restarts; what cannot be used is put aside, counted and told."""

import hashlib
from dataclasses import replace
from pathlib import Path

import pytest

from drd.config.keys import Config
from drd.config.schema import loads
from drd.estimation.basis import basis_of
from drd.monitor.memory import EARLIEST_NS, Day, Memory
from drd.state.memory_file import MemoryKeeper, decoded, digest_of, encoded, first_digest_of
from drd.state.sealed import StateError

DAY = Day(EARLIEST_NS + 1, 12.5, (0.1, -1e-3, 0.1 + 0.2), (1e-3, 1e-4, 0.1))


@pytest.fixture
def config(tmp_path: Path) -> Config:
    text = f"robot: {{wheel_radius_m: 0.11, tread_m: 0.6}}\nstate: {{folder: {tmp_path}}}\n"
    return loads(text, Config).value


def digest(config: Config) -> str:
    return digest_of(basis_of(config, None, None, True))


def begun(config: Config) -> MemoryKeeper:
    keeper = MemoryKeeper(config)
    keeper.begin()
    return keeper


def test_it_is_as_it_was_after_a_restart(config: Config) -> None:
    first, basis = begun(config), digest(config)
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
    keeper, basis = begun(config), digest(config)
    keeper.memory(basis)
    keeper.put(DAY)
    larger = digest(replace(config, robot=replace(config.robot, tread_m=0.7)))
    assert larger != basis
    assert keeper.memory(larger) == Memory(larger)
    assert keeper.close(10.0)


@pytest.mark.parametrize(
    ("keys", "is_same"),
    [
        ("encoders: {vesc: {gear_ratio: 3.1}}", False),
        ("encoders: {vesc: {pole_pairs: 8}}", False),
        ("encoders: {odrive: {gear_ratio: 3.1}}", False),
        ("encoders: {layout: vesc}", False),
        ("encoders: {dbc: {speed_unit_m_s: 0.1}}", False),
        ("encoders: {left: {node: 5}}", False),
        ("encoders: {right: {reversed: true}}", False),
        ("encoders: {latency_s: 0.1}", False),
        ("fog: {latency_s: 0.1}", False),
        ("fog: {protocol: dsp3000}", False),
        ("fog: {full_scale_deg_s: 103}", False),
        ("fog: {axis: x}", False),
        ("fog: {positive: counterclockwise}", False),
        ("robot: {drive: skid}", True),
        ("estimation: {profile: paper}", True),
    ],
)
def test_constants_are_known_while_the_readings_mean_the_same(keys: str, is_same: bool) -> None:
    text = "robot: {wheel_radius_m: 0.11, tread_m: 0.6}\n"
    other = text.replace("}", ", drive: skid}\n") if keys.startswith("robot") else text + keys
    before, after = (digest(loads(t, Config).value) for t in (text, other))
    assert (before == after) is is_same


def test_a_file_with_the_first_digest_is_gone_on_from(config: Config, tmp_path: Path) -> None:
    first, basis = first_digest_of(config, None), digest(config)
    (tmp_path / "robot.memory").write_bytes(encoded(Memory(first, [DAY])))
    keeper = begun(config)
    assert keeper.memory(basis, first) == Memory(basis, [DAY])
    geared = digest(loads("robot: {wheel_radius_m: 0.11, tread_m: 0.6}\nencoders: {layout: vesc}\n", Config).value)
    assert keeper.memory(geared, first) == Memory(geared)
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
