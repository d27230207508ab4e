"""Read YAML files into frozen dataclasses with msgspec; keep each value's origin; name the key in errors.

A key's annotation gives its type: `Annotated[float, "m", Meta(ge=0.1, le=5)] | None`, `Literal["a", "b"]`; the text
in it is the unit, or says what a string or a list holds. The string below the key gives its meaning. Every number is
finite; integers have at most 64 bits.
"""

import ast
import dataclasses
import functools
import inspect
import math
import re
import textwrap
import types
import typing
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import pairwise
from operator import attrgetter
from pathlib import Path
from typing import Any, Final, Literal, TypeVar

import msgspec
import yaml

T = TypeVar("T")
NULL, BOOL = "tag:yaml.org,2002:null", "tag:yaml.org,2002:bool"
BOOLEANS: Final = {"true": True, "yes": True, "on": True, "false": False, "no": False, "off": False}
LARGEST_INT: Final = 2**64
MISSING: Final = re.compile(r"Object missing required field `(.*)`")


class ConfigError(Exception):
    """An unusable file. The text names the file, the key, the expected and the actual value."""

    def __init__(self, where: str, path: str, expected: str, got: str):
        super().__init__(f"{where}: {f'{path}: ' if path else ''}expected {expected}, got {got}")
        self.where, self.path, self.expected, self.got = where, path, expected, got

    def __reduce__(self) -> tuple[type["ConfigError"], tuple[str, str, str, str]]:
        """Arguments for pickling, since the text alone would not restore the error."""
        return ConfigError, (self.where, self.path, self.expected, self.got)


@dataclass(frozen=True)
class Key:
    """The content of an annotation. `low` and `high` are inclusive limits."""

    kind: Any
    unit: str = ""
    low: float = -math.inf
    high: float = math.inf

    @property
    def expected(self) -> str:
        """Expected value, in the words of an error."""
        unit = f" in {self.unit}" if self.unit else ""
        words = {bool: "true or false", int: f"a whole number{unit}", float: f"a number{unit}", types.NoneType: "null"}
        text, items = words.get(self.kind, f"a {self.unit or 'text'}"), typing.get_args(self.kind)
        if typing.get_origin(self.kind) is tuple:
            text = f"a list of {self.unit or 'texts'}" if ... in items else self.unit or f"{len(items)} finite numbers"
        elif typing.get_origin(self.kind) is Literal:
            text = f"one of {', '.join(items)}" if len(items) > 1 else repr(items[0])
        if math.isfinite(self.low):
            text += f" from {_number(self.low)}" + (f" to {_number(self.high)}" if math.isfinite(self.high) else "")
        return text


@functools.cache
def _arms(hint: Any) -> tuple[Key, ...]:
    """Permitted types of a value, in order; null last."""
    if isinstance(hint, types.UnionType) or typing.get_origin(hint) is typing.Union:
        return tuple(key for arm in typing.get_args(hint) for key in _arms(arm))
    notes: tuple[Any, ...] = getattr(hint, "__metadata__", ())
    kind = hint.__origin__ if notes else hint
    unit = next((note for note in notes if isinstance(note, str)), "")
    limits = next((note for note in notes if isinstance(note, msgspec.Meta)), msgspec.Meta())
    low = -math.inf if limits.ge is None else limits.ge
    high = (LARGEST_INT if kind is int else math.inf) if limits.le is None else limits.le
    return (Key(kind, unit, low, high),)


@functools.cache
def _hints(cls: Any) -> dict[str, Any]:
    return typing.get_type_hints(cls, include_extras=True)


def _is_section(kind: Any) -> bool:
    return isinstance(kind, type) and dataclasses.is_dataclass(kind)


def keys(cls: Any, prefix: str = "") -> Iterator[tuple[str, Key]]:
    """Path and annotation of each key; a section's keys are in its place."""
    for name, hint in _hints(cls).items():
        if _is_section(hint):
            yield from keys(hint, f"{prefix}{name}.")
        else:
            yield prefix + name, _arms(hint)[0]


def values(section: Any) -> dict[str, Any]:
    """The value of each key by its path."""
    return {path: attrgetter(path)(section) for path, _ in keys(type(section))}


def nested(values: Mapping[str, Any]) -> dict[str, Any]:
    """Nest values by path into sections, as in a file."""
    content: dict[str, Any] = {}
    for path, value in values.items():
        *sections, name = path.split(".")
        inner = content
        for part in sections:
            inner = inner.setdefault(part, {})
        inner[name] = value
    return content


def meanings(cls: Any, prefix: str = "") -> dict[str, str]:
    """The string below each key, by path, read from the source."""
    found: dict[str, str] = {}
    for part in cls.__mro__[-2::-1]:
        (definition,) = ast.parse(textwrap.dedent(inspect.getsource(part))).body
        for line, below in pairwise(definition.body if isinstance(definition, ast.ClassDef) else ()):
            match line, below:
                case ast.AnnAssign(target=ast.Name(name)), ast.Expr(ast.Constant(str(text))):
                    found[prefix + name] = " ".join(text.split())
    for name, hint in _hints(cls).items():
        if _is_section(hint):
            found |= meanings(hint, f"{prefix}{name}.")
    return found


@dataclass(frozen=True)
class Loaded(typing.Generic[T]):
    """The values in force and, for each key's path, where its value came from."""

    value: T
    origins: dict[str, str]
    file: str = "(text)"

    def place(self, path: str) -> str:
        """Location of the key `path`: file and line, or the file alone where its default is in force."""
        origin = self.origins.get(path, "default")
        return self.file if origin == "default" else origin


def load(file: Path, cls: type[T], base: T | None = None) -> Loaded[T]:
    """Read `file` into `cls`; see `loads`. Raises ConfigError; nothing else escapes."""
    return loads(read_text(file), cls, str(file), base)


def read_text(file: Path, encoding: str = "utf-8") -> str:
    """The content of a file. Raises ConfigError."""
    try:
        return file.read_text(encoding)
    except (OSError, UnicodeDecodeError) as error:
        got = str(error.strerror) if isinstance(error, OSError) else str(error)
        raise ConfigError(str(file), "", "a readable UTF-8 text file", got) from error


@contextmanager
def named_by(key: str, file: Path) -> Iterator[None]:
    """Report a file that is invalid as a whole at the line of the key that names it. Raises ConfigError."""
    try:
        yield
    except ConfigError as error:
        if error.path:
            raise
        raise ConfigError(str(file), key, "a readable YAML file", f"{error.where}: {error.got}") from error


def loads(text: str, cls: type[T], where: str = "(text)", base: T | None = None) -> Loaded[T]:
    """Read YAML text into `cls`. Raises ConfigError; nothing else escapes.

    A key missing in the text has its default; with `base`, it has the value there and no key is required.
    """
    try:
        node = yaml.compose(text, Loader=yaml.SafeLoader)
    except (yaml.YAMLError, RecursionError, ValueError, OverflowError) as error:  # the last: "\UFFFFFFFF"
        line, problem = _yaml_problem(error, text)
        raise ConfigError(f"{where}{line}", "", "YAML", problem) from error
    return made(node, cls, where, base=base)


def made(node: yaml.Node | None, cls: type[T], where: str, path: str = "", base: T | None = None) -> Loaded[T]:
    """`cls` from the YAML node at `path`. Raises ConfigError.

    A field of the type `yaml.Node` keeps its node, for reading later.
    """
    reader = _Reader(where)
    plain = reader.section(cls, node, path, base)
    try:
        value = msgspec.convert(plain, cls)
    except msgspec.ValidationError as error:
        text, _, inside = str(error).partition(" - at `$")
        here, missing = (path + inside.rstrip("`")).removeprefix("."), MISSING.fullmatch(text)
        raise reader.error(_join(here, missing[1]) if missing else here) from error
    here = f"{path}." if path else ""
    return Loaded(value, {key: reader.at(key) or "default" for key, _ in keys(cls, here)}, where)


class _Reader:
    """Converts YAML nodes to plain values of their types; keeps nodes and types by path, for errors."""

    def __init__(self, where: str):
        self.where = where
        self.nodes: dict[str, yaml.Node] = {}
        self.hints: dict[str, Any] = {}

    def at(self, path: str) -> str:
        """File and line of a key; empty where the file does not contain it."""
        return f"{self.where}:{self.nodes[path].start_mark.line + 1}" if path in self.nodes else ""

    def error(self, path: str) -> ConfigError:
        """The error for a value at `path` that is missing or of a wrong type."""
        node, arms = self.nodes.get(path), [arm for arm in _arms(self.hints[path]) if not _is_section(arm.kind)]
        got = "nothing (the key is required)" if node is None else _shown(node)
        if isinstance(node, yaml.ScalarNode) and node.style in {"'", '"'} and arms[0].kind in (bool, int, float):
            got += " (quoted)"
        where = self.at(path) or self.at(path.rpartition(".")[0]) or self.where
        return ConfigError(where, path, " or ".join(arm.expected for arm in arms), got)

    def pairs(self, node: yaml.Node, path: str, names: tuple[str, ...] = ()) -> dict[str, yaml.Node]:
        """The keys of a section; each may occur once and must be one of `names` (none: any)."""
        if node.tag == NULL:
            return {}
        if not isinstance(node, yaml.MappingNode):
            raise ConfigError(self.at(path), path, "a section of keys", _shown(node))
        found: dict[str, yaml.Node] = {}
        for key_node, value in node.value:
            name = str(key_node.value) if isinstance(key_node, yaml.ScalarNode) else _shown(key_node)
            here, where = _join(path, name), f"{self.where}:{key_node.start_mark.line + 1}"
            if names and name not in names:
                raise ConfigError(where, here, f"one of {', '.join(names)}", "an unknown key")
            if name in found:
                raise ConfigError(where, here, "each key once", "a duplicate")
            found[name] = self.nodes[here] = value
        return found

    def section(self, cls: Any, node: yaml.Node | None, path: str, base: Any = None) -> dict[str, Any]:
        hints, found, plain = _hints(cls), dict[str, yaml.Node](), dict[str, Any]()
        if node is not None:
            self.nodes[path] = node
            found = self.pairs(node, path, tuple(hints))
        for name, hint in hints.items():
            here, child, before = _join(path, name), found.get(name), getattr(base, name, None)
            self.hints[here] = hint
            if child is not None and child.tag == NULL and is_nan(getattr(cls, name, None)):
                child = None  # not stated
                del self.nodes[here]
            if _is_section(hint):
                plain[name] = self.section(hint, child, here, before)
            elif child is not None:
                plain[name] = self.value(hint, child, here)
            elif base is not None:
                plain[name] = before
        return plain

    def value(self, hint: Any, node: yaml.Node, path: str) -> Any:
        self.nodes[path], self.hints[path] = node, hint
        kinds = [arm.kind for arm in _arms(hint)]
        if node.tag == NULL and types.NoneType in kinds:
            return None
        kind = next((k for k in kinds if _is_section(k) and isinstance(node, yaml.MappingNode)), kinds[0])
        origin = typing.get_origin(kind)
        if kind is yaml.Node:
            return node
        if _is_section(kind):
            return self.section(kind, node, path)
        if origin is dict:  # its values are taken as text
            texts = self.pairs(node, path)
            self.hints |= {_join(path, name): str for name in texts}
            for name in (name for name, text in texts.items() if not isinstance(text, yaml.ScalarNode)):
                raise self.error(_join(path, name))
            return {name: text.value for name, text in texts.items()}
        if origin is tuple and isinstance(node, yaml.SequenceNode):
            item = typing.get_args(kind)[0]
            return [self.value(item, child, f"{path}[{i}]") for i, child in enumerate(node.value)]
        try:
            return _scalar(kind, node)
        except (KeyError, ValueError):
            raise self.error(path) from None


def is_nan(value: Any) -> bool:
    """Whether a value is NaN, that is, not stated. A key with this default is optional; null means not stated."""
    return isinstance(value, float) and math.isnan(value)


def _scalar(kind: Any, node: yaml.Node) -> bool | int | float | str:
    if not isinstance(node, yaml.ScalarNode) or node.tag == NULL:
        raise ValueError("not a single value")
    text = str(node.value)
    if kind is bool:
        return BOOLEANS[text.lower() if node.tag == BOOL else ""]
    if kind not in (int, float):
        # Line breaks and lone surrogates would reappear in a log, a Zenoh key or a frame name.
        if not text or not text.isprintable():
            raise ValueError("empty or not printable")
        return text
    if node.style or node.tag == BOOL:
        raise ValueError("a quoted or boolean value is not a number")
    # PyYAML reads 2e-5 as a string (YAML 1.1 requires 2.0e-5), but a number is meant.
    number = int(text, 0) if kind is int else float(text)
    if not (abs(number) <= LARGEST_INT if kind is int else math.isfinite(number)):
        raise ValueError("not finite, or beyond 64 bits")
    return number


def _yaml_problem(error: Exception, text: str) -> tuple[str, str]:
    """The line at which PyYAML failed, as ":line" or "" if unknown, and its reason."""
    if isinstance(error, yaml.MarkedYAMLError) and error.problem_mark is not None:
        context = f" ({error.context})" if error.context else ""
        return f":{error.problem_mark.line + 1}", f"an error: {error.problem}{context}"
    if isinstance(error, yaml.reader.ReaderError):
        line = text.count("\n", 0, error.position) + 1
        return f":{line}", f"an error: {error.reason} (U+{error.character:04X})"
    return "", f"an error: {' '.join(str(error).split()) or type(error).__name__}"


def _number(value: float) -> str:
    """The number as text, without an exponent if it is whole."""
    return str(int(value)) if value == int(value) else f"{value:g}"


def _shown(node: yaml.Node) -> str:
    if isinstance(node, yaml.ScalarNode):
        return repr(str(node.value)[:80])
    return f"a list of {len(node.value)}" if isinstance(node, yaml.SequenceNode) else "a section"


def _join(path: str, name: str) -> str:
    return f"{path}.{name}" if path else name
