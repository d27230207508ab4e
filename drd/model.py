"""model.yaml: the nominal robot, and the physical effects to which it is blind, with their parameters."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, NamedTuple

import yaml

from drd.config import Config
from drd.effects.catalogue import catalogue
from drd.effects.effect import Effect, Parameter
from drd.nominal import Stated
from drd.schema import ConfigError, Loaded, _at, _join, _section, _shown, _yaml_problem, loads
from drd.units import RAD_PER_DEG


class Driver(NamedTuple):
    """A variable in which an effect was seen over some range: its unit in files, and the SI value of one unit."""

    unit: str
    si: float
    text: str


# Heading and the wheels' phase come round again, and a place is no number: they have no range.
DRIVERS: Final = {
    "time": Driver("s", 1.0, "since the gyro's power-on, or the recording's start"),
    "yaw_rate": Driver("deg/s", RAD_PER_DEG, "left positive"),
    "speed": Driver("m/s", 1.0, "forward positive"),
    "acceleration": Driver("m/s^2", 1.0, "forward positive"),
    "lateral_acceleration": Driver("m/s^2", 1.0, "speed times yaw rate"),
    "curvature": Driver("1/m", 1.0, "size of yaw rate over speed"),
    "temperature": Driver("degC", 1.0, "of the gyro"),
    "temperature_rate": Driver("degC/s", 1.0, "behind the effect's lag"),
}
# A value so many times larger than the largest plausible one is a slip of the pen, and may overflow.
LARGEST_TIMES_PLAUSIBLE: Final = 100.0
KEYS: Final = ("effect", "parameters", "seen", "provenance")


class Amount(NamedTuple):
    """A parameter's value and its standard deviation (0: not known), in the catalogue's unit."""

    value: float
    std: float = 0.0


@dataclass(frozen=True)
class Term:
    """An effect with its parameters, and the ranges of the drivers in which it was seen, in their files' units."""

    effect: Effect
    parameters: dict[str, Amount | str]
    seen: dict[str, tuple[float, float]] = field(default_factory=dict)
    provenance: dict[str, str] = field(default_factory=dict)

    def values(self) -> dict[str, float | str]:
        """The parameters in SI, as the effect's formulas want them; linear ones that are not stated are 0."""
        found: dict[str, float | str] = {}
        for q in self.effect.parameters:
            stated = self.parameters.get(q.name, Amount(0.0))
            found[q.name] = stated if isinstance(stated, str) else stated.value * q.si
        return found

    def stds(self) -> dict[str, float]:
        """Standard deviations in SI of those parameters that have one."""
        amounts = {q: self.parameters.get(q.name) for q in self.effect.parameters}
        return {q.name: a.std * q.si for q, a in amounts.items() if isinstance(a, Amount) and a.std > 0.0}


@dataclass(frozen=True)
class Model:
    """What a model file holds. `robot`: what it states of the nominal robot. `provenance`: free texts.

    `provenance.recording` names the recordings, separated by commas, in which the effects were found; those that do
    not last are taken off nowhere else.
    """

    terms: tuple[Term, ...] = ()
    robot: Loaded[Stated] = field(default_factory=lambda: loads("", Stated))
    provenance: dict[str, str] = field(default_factory=dict)

    def stated(self) -> Iterator[tuple[str, Any]]:
        """Path and value of each key of robot.yaml that the model states."""
        for path, origin in self.robot.origins.items():
            if origin != "default":
                value: Any = self.robot.value
                for name in path.split("."):
                    value = getattr(value, name)
                yield path, value

    def holds_in(self, recording: str | None) -> tuple[tuple[Term, ...], list[str]]:
        """The terms that hold in a recording (None: in a run that is still to come), and sentences about the others."""
        kept, notes = [], []
        for term in self.terms:
            effect, found_in = term.effect, (self.provenance | term.provenance).get("recording")
            elsewhere = recording is None or (found_in is not None and recording not in _names(found_in))
            if not effect.lasting and elsewhere:
                where = f" (here: {found_in})" if found_in else ""
                notes.append(f"{effect.id} is left alone: it holds only in the run in which it was found{where}")
                continue
            if not effect.lasting and found_in is None:
                notes.append(f"{effect.id} holds only in the run in which it was found: is it this one?")
            if effect.irreversible:
                notes.append(f"{effect.id} cannot be taken off: {effect.irreversible}")
            kept.append(term)
        return tuple(kept), notes


def _names(text: str) -> list[str]:
    return [name.strip() for name in text.split(",")]


def load_model(file: Path) -> Model:
    """Read a model file. Raises ConfigError with file, line, key, expected and got; nothing else escapes."""
    try:
        text = file.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        got = str(error.strerror) if isinstance(error, OSError) else str(error)
        raise ConfigError(str(file), "", "a readable UTF-8 text file", got) from error
    return loads_model(text, str(file))


def loads_model(text: str, where: str = "(text)") -> Model:
    """Read a model from YAML text. Raises ConfigError; nothing else escapes."""
    try:
        root = yaml.compose(text, Loader=yaml.SafeLoader)
    except (yaml.YAMLError, RecursionError, ValueError, OverflowError) as error:  # as in drd.schema
        line, problem = _yaml_problem(error, text)
        raise ConfigError(f"{where}{line}", "", "YAML", problem) from error
    pairs = root.value if isinstance(root, yaml.MappingNode) else []
    mine = [(k, v) for k, v in pairs if k.value in ("effects", "provenance")]
    if root is not None and pairs:
        root.value = [pair for pair in pairs if pair not in mine]
    reader = _Reader(where)
    found = reader.section(yaml.MappingNode("tag:yaml.org,2002:map", mine), "", ("effects", "provenance"))
    origins: dict[str, str] = {}
    robot = _section(Stated, root, "", where, origins)
    terms = [reader.term(node, f"effects[{i}]") for i, node in enumerate(reader.items(found.get("effects")))]
    provenance = reader.texts(found.get("provenance"), "provenance")
    return Model(tuple(terms), Loaded(robot, origins, where), provenance)


class _Reader:
    """From YAML's nodes to terms, with errors that name the line."""

    def __init__(self, where: str):
        self._where = where

    def refuse(self, node: yaml.Node, path: str, expected: str, got: str | None = None) -> ConfigError:
        return ConfigError(_at(self._where, node), path, expected, _shown(node) if got is None else got)

    def section(self, node: yaml.Node | None, path: str, names: Sequence[str] | None) -> dict[str, yaml.Node]:
        """The keys of a section, each of `names` (None: any) and once."""
        if node is None or node.tag == "tag:yaml.org,2002:null":
            return {}
        if not isinstance(node, yaml.MappingNode):
            raise self.refuse(node, path, "a section of keys")
        found: dict[str, yaml.Node] = {}
        for key_node, value in node.value:
            name = str(key_node.value) if isinstance(key_node, yaml.ScalarNode) else _shown(key_node)
            if names is not None and name not in names:
                raise self.refuse(key_node, _join(path, name), f"one of {', '.join(names)}", "an unknown key")
            if name in found:
                raise self.refuse(key_node, _join(path, name), "each key once", "a second one")
            found[name] = value
        return found

    def items(self, node: yaml.Node | None) -> list[yaml.Node]:
        if node is None or node.tag == "tag:yaml.org,2002:null":
            return []
        if not isinstance(node, yaml.SequenceNode):
            raise self.refuse(node, "effects", "a list of effects")
        return list(node.value)

    def texts(self, node: yaml.Node | None, path: str) -> dict[str, str]:
        found = {}
        for name, value in self.section(node, path, None).items():
            if not isinstance(value, yaml.ScalarNode):
                raise self.refuse(value, _join(path, name), "a text")
            found[name] = str(value.value)
        return found

    def number(
        self, node: yaml.Node, path: str, expected: str, low: float = -math.inf, high: float = math.inf
    ) -> float:
        value = math.nan
        if isinstance(node, yaml.ScalarNode) and not node.style and not node.tag.endswith(":bool"):
            try:
                value = float(node.value)
            except ValueError:
                value = math.nan
        if not (math.isfinite(value) and low <= value <= high):
            raise self.refuse(node, path, expected)
        return value

    def term(self, node: yaml.Node, path: str) -> Term:
        found = self.section(node, path, KEYS)
        known = catalogue()
        effect_node = found.get("effect", node)
        name = effect_node.value if isinstance(effect_node, yaml.ScalarNode) else None
        if name not in known:
            got = "nothing" if "effect" not in found else _shown(effect_node)
            raise self.refuse(effect_node, f"{path}.effect", f"one of {', '.join(known)}", got)
        effect, here = known[name], f"{path}.parameters"
        given = self.section(found.get("parameters"), here, [q.name for q in effect.parameters])
        for q in effect.parameters:
            if q.name not in given and (q.choices or not q.linear or not given):
                raise self.refuse(found.get("parameters", node), f"{here}.{q.name}", _expected(q), "nothing")
        parameters = {q.name: self.parameter(q, given[q.name], f"{here}.{q.name}") for q in effect.parameters
                      if q.name in given}  # fmt: skip
        seen = self.section(found.get("seen"), f"{path}.seen", tuple(DRIVERS))
        ranges = {driver: self.range(item, f"{path}.seen.{driver}", driver) for driver, item in seen.items()}
        return Term(effect, parameters, ranges, self.texts(found.get("provenance"), f"{path}.provenance"))

    def parameter(self, q: Parameter, node: yaml.Node, path: str) -> Amount | str:
        if q.choices:
            if not isinstance(node, yaml.ScalarNode) or node.value not in q.choices:
                raise self.refuse(node, path, _expected(q))
            return str(node.value)
        low, high = _limits(q)
        if not isinstance(node, yaml.MappingNode):
            return Amount(self.number(node, path, _expected(q), low, high))
        found = self.section(node, path, ("value", "std", "unit"))
        if "value" not in found:
            raise self.refuse(node, f"{path}.value", _expected(q), "nothing")
        if "unit" in found and (not isinstance(found["unit"], yaml.ScalarNode) or found["unit"].value != q.unit):
            raise self.refuse(found["unit"], f"{path}.unit", f"{q.unit!r}, the catalogue's")
        std = 0.0
        if "std" in found and found["std"].tag != "tag:yaml.org,2002:null":
            std = self.number(found["std"], f"{path}.std", f"a number from 0 to {high:g}", 0.0, high)
        return Amount(self.number(found["value"], f"{path}.value", _expected(q), low, high), std)

    def range(self, node: yaml.Node, path: str, driver: str) -> tuple[float, float]:
        expected = f"a low and a higher number in {DRIVERS[driver].unit}"
        if not isinstance(node, yaml.SequenceNode) or len(node.value) != 2:
            raise self.refuse(node, path, expected)
        low, high = (self.number(item, path, expected) for item in node.value)
        if low >= high:
            raise self.refuse(node, path, expected, f"{low:g} and {high:g}")
        return low, high


def _limits(q: Parameter) -> tuple[float, float]:
    """What a value may be at all: far more than is plausible. A delay or a time constant of 0 or less is none."""
    high = LARGEST_TIMES_PLAUSIBLE * max(abs(q.low), abs(q.high))
    positive = not (q.signed or q.linear) and q.low > 0.0
    return (q.low / LARGEST_TIMES_PLAUSIBLE if positive else -high), high


def _expected(q: Parameter) -> str:
    if q.choices:
        return f"one of {', '.join(q.choices)}"
    low, high = _limits(q)
    return f"a number in {q.unit} from {low:g} to {high:g}"


def check_geometry(model: Model, config: Config) -> None:
    """What the model states of the robot must be the configuration's: its effects were found with it.

    Raises ConfigError.
    """
    robot, counts = config.robot, config.encoders.counts_per_revolution
    mine = {
        "wheel.radius_m": ("robot.wheel_radius_m", robot.wheel_radius_m),
        "wheel.counts_per_revolution": ("encoders.counts_per_revolution", counts),
        "tread_m": ("robot.tread_m", robot.tread_m),
    }
    for path, value in model.stated():
        name, expected = mine.get(path, ("", None))
        if expected is not None and value is not None and not math.isclose(value, expected, rel_tol=1e-6):
            text = f"{expected:.12g}, the configuration's {name}: effects hold for the robot with which they were found"
            raise ConfigError(model.robot.place(path), path, text, f"{value:.12g}")


def save_model(file: Path, model: Model, comment: str = "") -> None:
    """Write a model file, which `load_model` reads as the same model. `comment`: its head. Raises OSError."""
    content: dict[str, Any] = {}
    for path, value in model.stated():
        *sections, name = path.split(".")
        inner = content
        for part in sections:
            inner = inner.setdefault(part, {})
        inner[name] = value
    content["effects"] = [_plain(term) for term in model.terms]
    if model.provenance:
        content["provenance"] = dict(model.provenance)
    head = "".join(f"# {line}\n" for line in comment.splitlines())
    text = yaml.safe_dump(content, sort_keys=False, allow_unicode=True, width=100)
    file.write_text(head + text, encoding="utf-8")


def _plain(term: Term) -> dict[str, Any]:
    units = {q.name: q.unit for q in term.effect.parameters}
    parameters: dict[str, Any] = {}
    for name, p in term.parameters.items():
        parameters[name] = p if isinstance(p, str) else {"value": p.value, "std": p.std, "unit": units[name]}
    found: dict[str, Any] = {"effect": term.effect.id, "parameters": parameters}
    if term.seen:
        found["seen"] = {driver: list(ends) for driver, ends in term.seen.items()}
    if term.provenance:
        found["provenance"] = dict(term.provenance)
    return found


def make_model(
    effects: Sequence[Mapping[str, Any]], robot: Mapping[str, Any] | None = None, **provenance: str
) -> Model:
    """A model from plain values as they stand in a file (`diagnosis.json` has the same form). Raises ConfigError."""
    content = {**(robot or {}), "effects": [dict(effect) for effect in effects], "provenance": provenance}
    return loads_model(yaml.safe_dump(content, sort_keys=False), "(model)")
