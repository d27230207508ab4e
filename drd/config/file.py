"""Read the configuration file: checks across keys, and paths of the files that it names."""

import os
import re
from collections.abc import Iterable, Iterator
from dataclasses import replace
from itertools import chain
from operator import attrgetter
from pathlib import Path

from drd.config.keys import Config, Encoders
from drd.config.schema import ConfigError, Loaded, load


def load_config(file: Path) -> Loaded[Config]:
    """Read and check a configuration file. Raises ConfigError with file, key path, expected and got."""
    loaded = load(file, Config)
    check_layout(loaded)
    check_estimate(loaded)
    return loaded


def load_overlay(file: Path, base: Config) -> Loaded[Config]:
    """Read a configuration file, any part of which may be missing, over `base`. Raises ConfigError.

    File paths in it are relative to its own folder, and are made absolute. There are no checks across keys.
    """
    loaded = load(file, Config, base)
    config, folder = loaded.value, file.parent.resolve()

    def found(path: str, name: str | None) -> str | None:
        return str(folder / name) if name is not None and loaded.origins[path] != "default" else name

    dbc = replace(config.encoders.dbc, file=found("encoders.dbc.file", config.encoders.dbc.file))
    changed = replace(
        config,
        calibration=replace(config.calibration, file=found("calibration.file", config.calibration.file)),
        model=replace(config.model, file=found("model.file", config.model.file)),
        encoders=replace(config.encoders, dbc=dbc),
    )
    return replace(loaded, value=changed)


def check_layout(loaded: Loaded[Config]) -> None:
    """Raise ConfigError where keys of the encoders' frames contradict each other."""
    _refuse(loaded, _encoders(loaded.value.encoders))


def check_estimate(loaded: Loaded[Config]) -> None:
    """Raise ConfigError where keys of times, heading or outputs contradict each other."""
    _refuse(loaded, chain(_times(loaded.value), _outputs(loaded.value)))


Complaint = tuple[str, str, str]  # key path, expected and got


def _refuse(loaded: Loaded[Config], found: Iterable[Complaint]) -> None:
    """Raise the first complaint as a ConfigError."""
    for path, expected, got in found:
        raise ConfigError(loaded.place(path), path, expected, got)


def _encoders(e: Encoders) -> Iterator[Complaint]:
    """Complaints about the encoders."""
    by_counts = {"cia406": True, "odrive": e.odrive.message == "counts", "dbc": e.dbc.quantity == "counts"}
    if by_counts.get(e.layout, False) and e.counts_per_revolution is None:
        yield "encoders.counts_per_revolution", f"a number, since layout {e.layout} reads counts", "nothing"
    from can import VALID_INTERFACES  # noqa: PLC0415  # replay and diagnosis work without python-can

    if e.interface not in VALID_INTERFACES:
        yield "encoders.interface", f"one of {', '.join(sorted(VALID_INTERFACES))}", repr(e.interface)
    if e.layout == "dbc":
        for path in ("dbc.file", "left.message", "left.signal", "right.message", "right.signal"):
            if attrgetter(path)(e) is None:
                yield f"encoders.{path}", "a name, since the layout is dbc", "nothing"
    elif e.layout != "agilex" and e.left.node == e.right.node:
        yield "encoders.right.node", "a node other than the left wheel's", str(e.right.node)
    if e.cia406.byte_offset + e.cia406.byte_length > 8:
        got = f"offset {e.cia406.byte_offset} and length {e.cia406.byte_length}"
        yield "encoders.cia406.byte_length", "a field that ends within 8 bytes", got


def _times(c: Config) -> Iterator[Complaint]:
    """Complaints about times that contradict each other."""
    bias, wait_s = c.estimation.static_bias, c.estimation.reorder_s
    if 0 < bias.duration_s < bias.minimum_s:
        expected = f"at most duration_s ({bias.duration_s:g})"
        yield "estimation.static_bias.minimum_s", expected, f"{bias.minimum_s:g}"
    gyro_age_s, wheels_age_s = (part.latency_s + 1.0 / part.rate_hz for part in (c.fog, c.encoders))
    if c.fog.protocol != "none" and gyro_age_s >= wait_s:
        expected = f"more than a gyro sample's age, latency_s plus one period ({gyro_age_s:g} s)"
        yield "estimation.reorder_s", expected, f"{wait_s:g}"
    if wheels_age_s >= c.encoders.gap_s + wait_s:
        expected = f"with estimation.reorder_s ({wait_s:g} s) more than a sample's age ({wheels_age_s:g} s)"
        yield "encoders.gap_s", expected, f"{c.encoders.gap_s:g}"
    silences = ("fog", c.fog.silent_after_s, gyro_age_s), ("encoders", c.encoders.silent_after_s, wheels_age_s)
    for name, silent_after_s, age_s in silences:
        if silent_after_s <= age_s:
            expected = f"more than a sample's age, latency_s plus one period ({age_s:g} s)"
            yield f"{name}.silent_after_s", expected, f"{silent_after_s:g}"


def _outputs(c: Config) -> Iterator[Complaint]:
    """Complaints about outputs that the robot's sensors, or Zenoh, do not permit."""
    if c.output.publish_on == "gyro" and c.fog.protocol == "none":
        yield "output.publish_on", "wheels, since the robot has no gyro", "'gyro'"
    if c.estimation.heading == "gyro" and c.fog.protocol == "none":
        yield "estimation.heading", "filter, since the robot has no gyro", "'gyro'"
    chunks = c.output.prefix.split("/")
    if set("*$?#") & set(c.output.prefix) or "" in chunks or any(chunk.startswith("@") for chunk in chunks):
        expected = "a Zenoh key without *, $, ?, #, leading @ and outer or double slashes"
        yield "output.prefix", expected, repr(c.output.prefix)


def in_state_directory(folder: str) -> Path:
    """A folder relative to the service's first state directory under systemd, else to the working directory."""
    return Path(os.environ.get("STATE_DIRECTORY", "").split(":")[0]) / folder


def file_name(robot: str) -> str:
    """A robot's name as used in file names."""
    return re.sub(r"[^A-Za-z0-9_.]+", "_", robot)
