"""Reading the configuration file, and what only several of its keys together can say."""

from pathlib import Path

from can import VALID_INTERFACES

from drd.config import Config, Encoders
from drd.schema import ConfigError, Loaded, load


def load_config(file: Path) -> Loaded[Config]:
    """Read and check a configuration file. Raises ConfigError with file, key path, expected and got."""
    loaded = load(file, Config)
    for path, expected, got in [*_encoders(loaded.value.encoders), *_timing(loaded.value), *_rest(loaded.value)]:
        raise ConfigError(loaded.place(path), path, expected, got)
    return loaded


Complaint = tuple[str, str, str]


def _encoders(e: Encoders) -> list[Complaint]:
    """Key path, expected and got of what is wrong with the encoders."""
    found: list[Complaint] = []
    by_counts = {"cia406": True, "odrive": e.odrive.message == "counts", "dbc": e.dbc.quantity == "counts"}
    if by_counts.get(e.layout, False) and e.counts_per_revolution is None:
        found.append(("encoders.counts_per_revolution", f"a number, since layout {e.layout} counts", "nothing"))
    if e.interface not in VALID_INTERFACES:
        found.append(("encoders.interface", f"one of {', '.join(sorted(VALID_INTERFACES))}", repr(e.interface)))
    if e.layout == "dbc":
        names = {
            "encoders.dbc.file": e.dbc.file,
            "encoders.left.message": e.left.message,
            "encoders.left.signal": e.left.signal,
            "encoders.right.message": e.right.message,
            "encoders.right.signal": e.right.signal,
        }
        found += [(path, "a name, since the layout is dbc", "nothing") for path, name in names.items() if name is None]
    elif e.layout != "agilex" and e.left.node == e.right.node:
        found.append(("encoders.right.node", "another node than the left wheel's", str(e.right.node)))
    if e.cia406.byte_offset + e.cia406.byte_length > 8:
        got = f"offset {e.cia406.byte_offset} and length {e.cia406.byte_length}"
        found.append(("encoders.cia406.byte_length", "a field that ends within 8 bytes", got))
    return found


def _timing(c: Config) -> list[Complaint]:
    """Times that do not go together."""
    found: list[Complaint] = []
    bias, wait_s = c.estimation.static_bias, c.estimation.reorder_s
    if 0 < bias.duration_s < bias.minimum_s:
        expected = f"at most duration_s ({bias.duration_s:g})"
        found.append(("estimation.static_bias.minimum_s", expected, f"{bias.minimum_s:g}"))
    gyro_age_s = c.fog.latency_s + 1.0 / c.fog.rate_hz
    if c.fog.protocol != "none" and gyro_age_s >= wait_s:
        expected = f"more than a gyro sample's age, latency_s and one period ({gyro_age_s:g} s)"
        found.append(("estimation.reorder_s", expected, f"{wait_s:g}"))
    for name, part in (("fog", c.fog), ("encoders", c.encoders)):
        age_s = part.latency_s + 1.0 / part.rate_hz
        if part.silent_after_s <= age_s:
            expected = f"more than a sample's age, latency_s and one period ({age_s:g} s)"
            found.append((f"{name}.silent_after_s", expected, f"{part.silent_after_s:g}"))
    return found


def _rest(c: Config) -> list[Complaint]:
    """Outputs."""
    found: list[Complaint] = []
    if c.output.publish_on == "gyro" and c.fog.protocol == "none":
        found.append(("output.publish_on", "wheels, since the robot has no gyro", "'gyro'"))
    if c.estimation.heading == "gyro" and c.fog.protocol == "none":
        found.append(("estimation.heading", "filter, since the robot has no gyro", "'gyro'"))
    chunks = c.output.prefix.split("/")
    if set("*$?#") & set(c.output.prefix) or "" in chunks or any(chunk.startswith("@") for chunk in chunks):
        expected = "a Zenoh key without *, $, ?, #, leading @ and outer or double slashes"
        found.append(("output.prefix", expected, repr(c.output.prefix)))
    return found
