"""YAML files into frozen dataclasses: checked, with the origin of each value and errors that name the key."""

import dataclasses
import math
import types
import typing
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

import yaml

T = TypeVar("T")
REQUIRED: Any = dataclasses.MISSING
BOOLEANS = {"true": True, "yes": True, "on": True, "false": False, "no": False, "off": False}


class ConfigError(Exception):
    """A file cannot be used. The text names the file, the key, what was expected and what was found."""

    def __init__(self, where: str, path: str, expected: str, got: str):
        super().__init__(f"{where}: {path or '(top level)'}: expected {expected}, got {got}")
        self.where, self.path, self.expected, self.got = where, path, expected, got

    def __reduce__(self) -> tuple[type["ConfigError"], tuple[str, str, str, str]]:
        """From one process to another: the text alone would not make it again."""
        return ConfigError, (self.where, self.path, self.expected, self.got)


@dataclass(frozen=True)
class Key:
    """What a configuration key means: sentence, unit, limits. `low` and `high` are included in the range."""

    text: str
    unit: str = ""
    low: float = -math.inf
    high: float = math.inf
    choices: tuple[str, ...] = ()


def key(default: Any, text: str, unit: str = "", **limits: Any) -> Any:
    """A dataclass field with its documentation. `default=REQUIRED` makes it mandatory."""
    return field(default=default, metadata={"key": Key(text, unit, **limits)})


def section(cls: type[T]) -> T:
    """A dataclass field that is itself a section of keys."""
    made: T = field(default_factory=cls)
    return made


@dataclass(frozen=True)
class Loaded(typing.Generic[T]):
    """The values in force and, for each key's path, where its value came from."""

    value: T
    origins: dict[str, str]
    file: str = "(text)"

    def place(self, path: str) -> str:
        """Where the key `path` stands: file and line, or the file alone where its default is in force."""
        origin = self.origins.get(path, "default")
        return self.file if origin == "default" else origin


def load(file: Path, cls: type[T], base: T | None = None) -> Loaded[T]:
    """Read `file` into `cls`; see `loads`. Raises ConfigError; nothing else escapes."""
    try:
        text = file.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        got = str(error.strerror) if isinstance(error, OSError) else str(error)
        raise ConfigError(str(file), "", "a readable UTF-8 text file", got) from error
    return loads(text, cls, str(file), base)


def loads(text: str, cls: type[T], where: str = "(text)", base: T | None = None) -> Loaded[T]:
    """Read YAML text into `cls`. Raises ConfigError; nothing else escapes.

    What the text does not state has its default; with `base` it has the value there, and no key is required.
    """
    try:
        node = yaml.compose(text, Loader=yaml.SafeLoader)
    except (yaml.YAMLError, RecursionError, ValueError, OverflowError) as error:  # the last: "\UFFFFFFFF"
        line, problem = _yaml_problem(error, text)
        raise ConfigError(f"{where}{line}", "", "YAML", problem) from error
    origins: dict[str, str] = {}
    value = _section(cls, node, "", where, origins, base)
    return Loaded(value, origins, where)


def _yaml_problem(error: Exception, text: str) -> tuple[str, str]:
    """Where PyYAML gave up, as ":line" or "" if it does not say, and why."""
    if isinstance(error, yaml.MarkedYAMLError) and error.problem_mark is not None:
        context = f" ({error.context})" if error.context else ""
        return f":{error.problem_mark.line + 1}", f"an error: {error.problem}{context}"
    if isinstance(error, yaml.reader.ReaderError):
        line = text.count("\n", 0, error.position) + 1
        return f":{line}", f"an error: {error.reason} (U+{error.character:04X})"
    return "", f"an error: {' '.join(str(error).split()) or type(error).__name__}"


def _section(
    cls: type[T], node: yaml.Node | None, path: str, where: str, origins: dict[str, str], base: T | None = None
) -> T:
    found: dict[str, yaml.Node] = {}
    if node is not None and not _is_null(node):
        if not isinstance(node, yaml.MappingNode):
            raise ConfigError(_at(where, node), path, "a section of keys", _shown(node))
        names = [f.name for f in dataclasses.fields(cls)]  # type: ignore[arg-type]  # T is always a dataclass
        for key_node, value_node in node.value:
            name = str(key_node.value) if isinstance(key_node, yaml.ScalarNode) else _shown(key_node)
            if name not in names:
                raise ConfigError(
                    _at(where, key_node), _join(path, name), f"one of {', '.join(names)}", "an unknown key"
                )
            if name in found:
                raise ConfigError(_at(where, key_node), _join(path, name), "each key once", "a second one")
            found[name] = value_node
    hints = typing.get_type_hints(cls)
    values: dict[str, Any] = {}
    for f in dataclasses.fields(cls):  # type: ignore[arg-type]  # T is always a dataclass
        here, child = _join(path, f.name), found.get(f.name)
        unstated = f.default if base is None else getattr(base, f.name)
        if dataclasses.is_dataclass(hints[f.name]):
            inner = None if base is None else unstated
            values[f.name] = _section(typing.cast(type[Any], hints[f.name]), child, here, where, origins, inner)
        elif child is not None:
            values[f.name] = _value(hints[f.name], f.metadata["key"], child, here, where)
            origins[here] = _at(where, child)
        elif unstated is dataclasses.MISSING:
            raise ConfigError(
                where, here, _expectation(hints[f.name], f.metadata["key"]), "nothing (the key is required)"
            )
        else:
            values[f.name], origins[here] = unstated, "default"
    return cls(**values)


def _value(hint: Any, meta: Key, node: yaml.Node, path: str, where: str) -> Any:
    """One checked value: bool, int, float, str, a tuple of strings, or None where the hint allows it."""
    is_quoted = isinstance(node, yaml.ScalarNode) and node.style in {"'", '"'}
    got = _shown(node) + (" (quoted)" if is_quoted and _bare(hint) in {bool, int, float} else "")
    error = ConfigError(_at(where, node), path, _expectation(hint, meta), got)
    if _is_null(node):
        if type(None) in typing.get_args(hint):
            return None
        raise error
    try:
        if _bare(hint) == tuple[str, ...]:
            return _texts(node)
        value = _scalar(_bare(hint), node)
        in_range = isinstance(value, str) or (math.isfinite(value) and meta.low <= value <= meta.high)
    except (ValueError, OverflowError):  # the latter: a whole number of hundreds of digits
        raise error from None
    if not in_range:
        raise error
    if meta.choices and value not in meta.choices:
        raise error
    return value


def _texts(node: yaml.Node) -> tuple[str, ...]:
    if not isinstance(node, yaml.SequenceNode):
        raise ValueError("not a list")
    return tuple(str(_scalar(str, item)) for item in node.value)


def _scalar(kind: Any, node: yaml.Node) -> bool | int | float | str:
    if not isinstance(node, yaml.ScalarNode) or _is_null(node):
        raise ValueError("not a single value")
    text = str(node.value)
    if kind is bool:
        if node.tag != "tag:yaml.org,2002:bool" or text.lower() not in BOOLEANS:
            raise ValueError(text)
        return BOOLEANS[text.lower()]
    if kind is str:
        # Line breaks and lone surrogates would come out again in a log, a Zenoh key or a frame name.
        if not text or not text.isprintable():
            raise ValueError("empty or not printable")
        return text
    if node.style or node.tag.endswith(":bool"):
        raise ValueError("a quoted or boolean value is not a number")
    # PyYAML takes 2e-5 for a string (YAML 1.1 wants 2.0e-5); a number is meant.
    return int(text, 0) if kind is int else float(text)


def _bare(hint: Any) -> Any:
    """The type without its `| None`."""
    if typing.get_origin(hint) in {typing.Union, types.UnionType}:
        return next(a for a in typing.get_args(hint) if a is not type(None))
    return hint


def _expectation(hint: Any, meta: Key) -> str:
    unit = f" in {meta.unit}" if meta.unit else ""
    texts = {
        bool: "true or false",
        int: f"a whole number{unit}",
        float: f"a number{unit}",
        str: f"a {meta.unit or 'text'}",
    }
    text = texts.get(_bare(hint), f"a list of {meta.unit or 'texts'}")
    if meta.choices:
        text = f"one of {', '.join(meta.choices)}"
    if meta.low > -math.inf or meta.high < math.inf:
        text += f" from {_number(meta.low)} to {_number(meta.high)}"
    return text + (" or null" if type(None) in typing.get_args(hint) else "")


def _number(value: float) -> str:
    """Without an exponent where it is whole."""
    return str(int(value)) if math.isfinite(value) and value == int(value) else f"{value:g}"


def _is_null(node: yaml.Node) -> bool:
    return isinstance(node, yaml.ScalarNode) and node.tag == "tag:yaml.org,2002:null"


def _shown(node: yaml.Node) -> str:
    return (
        repr(str(node.value)[:80])
        if isinstance(node, yaml.ScalarNode)
        else "a list"
        if isinstance(node, yaml.SequenceNode)
        else "a section"
    )


def _at(where: str, node: yaml.Node) -> str:
    return f"{where}:{node.start_mark.line + 1}"


def _join(path: str, name: str) -> str:
    return f"{path}.{name}" if path else name
