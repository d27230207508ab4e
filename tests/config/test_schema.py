import dataclasses
import math
import re
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec import Meta

from drd.config.keys import Config
from drd.config.schema import ConfigError, load, loads, meanings


@dataclass(frozen=True, kw_only=True)
class Inner:
    """A section in a section."""

    ratio: Annotated[float, Meta(ge=0, le=10)] | None = None
    """A ratio"""
    names: tuple[str, ...] = ("a",)
    """Some names"""
    points: Annotated[tuple[str, ...], "end points"] = ()
    file: Annotated[str, "path"] | None = None


@dataclass(frozen=True, kw_only=True)
class Outer:
    """A section."""

    length_m: Annotated[float, "m", Meta(ge=0.1, le=5)]
    """A length, told
    in two lines"""
    count: Annotated[int, Meta(ge=0)] = 3
    free: float = 0.0
    flag: bool = False
    colour: Literal["red", "green"] = "red"
    text: str = "plain"
    inner: Inner = Inner()


@dataclass(frozen=True, kw_only=True)
class File:
    """A file."""

    outer: Outer


def outer(text: str) -> Outer:
    return loads(f"outer: {{length_m: 1, {text}}}", File).value.outer


def refusal(text: str, cls: type[Any] = File) -> ConfigError:
    with pytest.raises(ConfigError) as caught:
        loads(text, cls, "file.yaml")
    return caught.value


YAML_PIECES = st.sampled_from(
    [
        *"-?:,[]{}#&*!|>'\"%@`~.\n \t\\",
        *("  ", ": ", "- ", "---\n", "...\n", "!!", "<<: ", "&a ", "*a", "\\u", "\\U", "\\UFFFFFFFF", "\\ud800"),
        *("robot", "fog", "baud", "output", "listen", "name", "1", "0x", "1e999", ".inf", ".nan", "true", "null"),
        *("!!bool ", "!!int ", "!!binary ", "%YAML 1.1\n", "%TAG ! x\n", "2001-99-99"),
    ]
)
SCALARS = (
    st.none()
    | st.booleans()
    | st.integers()
    | st.integers(10**300, 10**400)
    | st.floats()
    | st.text(max_size=10)
    | st.dates()
    | st.binary(max_size=4)
)
VALUES = st.recursive(
    SCALARS, lambda v: st.lists(v, max_size=3) | st.dictionaries(st.text(max_size=3), v, max_size=3), max_leaves=5
)


@settings(deadline=None, max_examples=300)
@given(st.text() | st.lists(YAML_PIECES | st.text(max_size=2), max_size=20).map("".join))
def test_no_text_raises_anything_but_a_config_error(text: str) -> None:
    with pytest.raises(ConfigError):  # never good: the robot's geometry is required
        loads(text, Config)


@settings(deadline=None, max_examples=200)
@given(
    st.fixed_dictionaries(
        {},
        optional={
            **dict.fromkeys(("length_m", "count", "free", "flag", "colour", "text", "unknown"), VALUES),
            "inner": VALUES | st.fixed_dictionaries({}, optional={"ratio": VALUES, "names": VALUES}),
        },
    )
)
def test_no_value_of_any_key_raises_anything_but_a_config_error(values: dict[str, Any]) -> None:
    try:
        found = loads(yaml.safe_dump({"outer": {"length_m": 1.0} | values}), File).value.outer
    except ConfigError:
        return
    assert 0.1 <= found.length_m <= 5
    assert 0 <= found.count <= 2**64
    assert found.colour in {"red", "green"}
    assert found.text.isprintable()
    assert all(isinstance(name, str) for name in found.inner.names)


@pytest.mark.parametrize(
    "text",
    [
        "free: 1" + "0" * 400,
        "count: 0x" + "f" * 5000,
        "count: 1" + "0" * 5000,
        r'text: "\UFFFFFFFF"',
        r'text: "\ud800"',
        r'text: "two\nlines"',
        'text: ""',
        "free: .nan",
        "free: .inf",
        "free: 1e999",
        "free: 1:30",
        "flag: !!bool maybe so",
        "? &a [*a]\n : 1",
        "inner: {names: [~]}",
        "inner: {names: [[a]]}",
    ],
)
def test_values_that_libraries_stumble_over_are_refused_by_key(text: str) -> None:
    with pytest.raises(ConfigError):
        outer(text)


def test_nesting_without_end_is_refused() -> None:
    assert refusal("[" * 20_000).expected == "YAML"
    assert refusal("outer: &o {inner: *o, length_m: 1}").path == "outer.inner.inner"


@settings(deadline=None)
@given(st.floats(0.1, 5), st.integers(0, 2**64), st.booleans(), st.floats(allow_nan=False, allow_infinity=False))
def test_good_values_are_read_as_they_were_written(length: float, count: int, flag: bool, free: float) -> None:
    expected = Outer(length_m=length, count=count, flag=flag, free=free, inner=Inner(ratio=length, names=("x", "y")))
    text = yaml.safe_dump(dataclasses.asdict(File(outer=expected)) | {}, default_flow_style=False)
    text = text.replace("!!python/tuple", "")
    assert loads(text, File).value.outer == expected


@pytest.mark.parametrize(
    ("text", "value"), [("2e-5", 2e-5), ("1E3", 1000.0), ("2.5e-1", 0.25), ("7", 7.0), ("-.5", -0.5)]
)
def test_numbers_need_no_dot_before_their_exponent(text: str, value: float) -> None:
    assert outer(f"free: {text}").free == value


@pytest.mark.parametrize("text", ["'5'", '"5"', "true", "yes", "five", "[5]", "{a: 5}", "", "~"])
@pytest.mark.parametrize("name", ["free", "count"])
def test_only_a_bare_number_is_a_number(name: str, text: str) -> None:
    with pytest.raises(ConfigError) as caught:
        outer(f"{name}: {text}")
    assert caught.value.path == f"outer.{name}"


def test_a_block_of_text_is_not_a_number() -> None:
    assert refusal("outer:\n  length_m: |\n    1\n").path == "outer.length_m"


def test_a_fraction_is_no_whole_number() -> None:
    with pytest.raises(ConfigError, match="expected a whole number from 0"):
        outer("count: 2.0")


@pytest.mark.parametrize(("text", "value"), [("true", True), ("No", False), ("on", True)])
def test_yaml_words_for_true_and_false_are_booleans(text: str, value: bool) -> None:
    assert outer(f"flag: {text}").flag is value


@pytest.mark.parametrize("text", ["'true'", "1", "truth"])
def test_other_words_are_no_booleans(text: str) -> None:
    with pytest.raises(ConfigError, match="expected true or false"):
        outer(f"flag: {text}")


@pytest.mark.parametrize(("text", "value"), [("5", "5"), ("yes", "yes"), ("'5'", "5"), ("1.0", "1.0")])
def test_a_text_is_taken_as_it_is_written(text: str, value: str) -> None:
    assert outer(f"text: {text}").text == value


def test_null_is_a_value_only_where_it_is_allowed() -> None:
    assert outer("inner: {ratio: null}").inner.ratio is None
    with pytest.raises(ConfigError, match="expected a text"):
        outer("text: null")


def test_an_empty_section_is_all_defaults() -> None:
    assert loads("outer:\n  length_m: 1\n  inner:\n", File).value.outer == Outer(length_m=1.0)


@pytest.mark.parametrize("value", ["0.0999", "5.01", "-1"])
def test_limits_belong_to_the_range_and_nothing_beyond(value: str) -> None:
    assert loads("outer: {length_m: 0.1}", File).value.outer.length_m == 0.1
    assert loads("outer: {length_m: 5}", File).value.outer.length_m == 5.0
    assert refusal(f"outer: {{length_m: {value}}}").expected == "a number in m from 0.1 to 5"


@pytest.mark.parametrize(
    ("text", "where", "path", "expected", "got"),
    [
        ("outer:\n  length_m: 9", "file.yaml:2", "outer.length_m", "a number in m from 0.1 to 5", "'9'"),
        ("outer: {}", "file.yaml:1", "outer.length_m", "a number in m from 0.1 to 5", "nothing (the key is required)"),
        ("outer: {length_m: 1, colour: blue}", "file.yaml:1", "outer.colour", "one of red, green", "'blue'"),
        ("outer:\n\n  lenght_m: 1", "file.yaml:3", "outer.lenght_m", "one of length_m, count, free", "an unknown key"),
        ("outer: {length_m: 1,\n length_m: 2}", "file.yaml:2", "outer.length_m", "each key once", "a duplicate"),
        ("outer: 5", "file.yaml:1", "outer", "a section of keys", "'5'"),
        ("outer: {length_m: 1, inner: [1]}", "file.yaml:1", "outer.inner", "a section of keys", "a list"),
        ("outer: {length_m: 1, inner: {ratio: x}}", "file.yaml:1", "outer.inner.ratio", "or null", "'x'"),
        ("outer: {length_m: 1, inner: {names: a}}", "file.yaml:1", "outer.inner.names", "a list of texts", "'a'"),
        ("- outer", "file.yaml:1", "", "a section of keys", "a list"),
        ("outer: {length_m: 1, inner: {points: a}}", "file.yaml:1", "outer.inner.points", "a list of end points", "a"),
        ("outer: {length_m: 1, inner: {file: [a]}}", "file.yaml:1", "outer.inner.file", "a path or null", "a list"),
        ("outer:\n  length_m: '1'", "file.yaml:2", "outer.length_m", "a number in m from 0.1 to 5", "'1' (quoted)"),
        ('outer: {length_m: 1, flag: "on"}', "file.yaml:1", "outer.flag", "true or false", "'on' (quoted)"),
        (
            "outer: {length_m: 1, count: -1}",
            "file.yaml:1",
            "outer.count",
            "a whole number from 0 to 18446744073709551616",
            "'-1'",
        ),
        ("{1: 2", "file.yaml:1", "", "YAML", "an error: expected ',' or '}', but got '<stream end>' (while parsing"),
        ("outer:\n  a: b: c\n", "file.yaml:2", "", "YAML", "an error: mapping values are not allowed here"),
        ("outer:\n\ttext: a\n", "file.yaml:2", "", "YAML", r"an error: found character '\t' that cannot start any"),
        ("outer:\n\n  text: \x00", "file.yaml:3", "", "YAML", "an error: special characters are not allowed (U+0000)"),
    ],
)
def test_an_error_names_file_line_key_what_was_expected_and_what_was_found(
    text: str, where: str, path: str, expected: str, got: str
) -> None:
    error = refusal(text)
    assert (error.where, error.path) == (where, path)
    assert expected in error.expected
    assert got in error.got
    assert str(error) == f"{where}: {f'{path}: ' if path else ''}expected {error.expected}, got {error.got}"


def test_each_value_has_its_origin() -> None:
    loaded = loads("outer:\n  length_m: 1\n  inner:\n    names:\n      - b\n", File, "file.yaml")
    assert loaded.origins == {
        "outer.length_m": "file.yaml:2",
        "outer.count": "default",
        "outer.free": "default",
        "outer.flag": "default",
        "outer.colour": "default",
        "outer.text": "default",
        "outer.inner.ratio": "default",
        "outer.inner.names": "file.yaml:5",
        "outer.inner.points": "default",
        "outer.inner.file": "default",
    }


def test_a_file_that_cannot_be_read_is_a_config_error(tmp_path: Path) -> None:
    latin = tmp_path / "latin.yaml"
    latin.write_bytes(b"outer: {length_m: 1, text: \xe9}")
    for file in (tmp_path, tmp_path / "absent.yaml", latin):
        with pytest.raises(ConfigError, match=re.escape(str(file))):
            load(file, File)


def test_a_file_that_is_absent_is_named_once(tmp_path: Path) -> None:
    file = tmp_path / "absent.yaml"
    with pytest.raises(ConfigError) as caught:
        load(file, File)
    assert str(caught.value) == (f"{file}: expected a readable UTF-8 text file, got No such file or directory")


@given(st.floats(0.1, 5.0), st.integers(0, 100), st.booleans())
def test_what_a_text_does_not_state_is_as_in_its_base(length_m: float, count: int, states_count: bool) -> None:
    base = File(outer=Outer(length_m=length_m, text="kept", inner=Inner(ratio=7.0)))
    text = f"outer: {{count: {count}, inner: {{file: a}}}}" if states_count else "outer: {inner: {file: a}}"
    loaded = loads(text, File, "file.yaml", base)
    inner = dataclasses.replace(base.outer.inner, file="a")
    expected = dataclasses.replace(base.outer, inner=inner, count=count if states_count else base.outer.count)
    assert loaded.value.outer == expected
    assert loaded.origins["outer.inner.file"] == "file.yaml:1"
    assert loaded.origins["outer.length_m"] == "default"


@dataclass(frozen=True, kw_only=True)
class Mixed:
    """Lists, free texts, a number or a section, and a part that is read later."""

    ends: tuple[float, float] = (0.0, 1.0)
    rows: Annotated[tuple[tuple[float, float], ...], "rows of 2 numbers", Meta(max_length=2)] = ()
    texts: dict[str, str] = field(default_factory=dict)
    amount: Annotated[float, "m", Meta(ge=0)] | Inner | None = None
    later: yaml.Node | None = None


@pytest.mark.parametrize(
    ("text", "where", "path", "expected", "got"),
    [
        ("ends: [1]", "file.yaml:1", "ends", "2 finite numbers", "a list of 1"),
        ("ends: [1,\n .inf]", "file.yaml:2", "ends[1]", "a number", "'.inf'"),
        ("rows: [[1, 2], [1, 2], [1, 2]]", "file.yaml:1", "rows", "a list of rows of 2 numbers", "a list of 3"),
        ("rows:\n- [1, 2]\n- [1]", "file.yaml:3", "rows[1]", "2 finite numbers", "a list of 1"),
        ("texts:\n  a: b\n  c: [d]", "file.yaml:3", "texts.c", "a text", "a list of 1"),
        ("texts: {a: b, a: c}", "file.yaml:1", "texts.a", "each key once", "a duplicate"),
        ("amount: -1", "file.yaml:1", "amount", "a number in m from 0 or null", "'-1'"),
        ("amount:\n  ratio: 11", "file.yaml:2", "amount.ratio", "a number from 0 to 10 or null", "'11'"),
    ],
)
def test_lists_free_texts_and_alternatives_are_named_as_exactly(
    text: str, where: str, path: str, expected: str, got: str
) -> None:
    error = refusal(text, Mixed)
    assert (error.where, error.path, error.expected, error.got) == (where, path, expected, got)


def test_lists_free_texts_and_alternatives_are_read() -> None:
    made = loads("{ends: [1, 2e1], rows: [[3, 4]], texts: {a: 01, b: ''}, amount: {ratio: 2}, later: [x]}", Mixed).value
    assert (made.ends, made.rows, made.texts) == ((1.0, 20.0), ((3.0, 4.0),), {"a": "01", "b": ""})
    assert made.amount == Inner(ratio=2.0)
    assert isinstance(made.later, yaml.SequenceNode)
    assert loads("amount: 2", Mixed).value.amount == 2.0


@settings(deadline=None, max_examples=300)
@given(st.fixed_dictionaries({}, optional=dict.fromkeys(("ends", "rows", "texts", "amount", "later"), VALUES)))
def test_no_value_of_any_form_raises_anything_but_a_config_error(values: dict[str, Any]) -> None:
    with suppress(ConfigError):
        made = loads(yaml.safe_dump(values), Mixed).value
        assert all(map(math.isfinite, made.ends))
        assert all(isinstance(text, str) for text in made.texts.values())


@settings(deadline=None, max_examples=200)
@given(st.binary(max_size=60) | st.text(max_size=30).map(lambda t: t.encode("utf-16")))
def test_a_file_of_any_bytes_raises_nothing_but_a_config_error(tmp_path_factory: Any, data: bytes) -> None:
    file = tmp_path_factory.getbasetemp() / "any.yaml"
    file.write_bytes(data)
    with suppress(ConfigError):
        load(file, Mixed)


def test_merges_are_unknown_keys_and_an_alias_is_what_it_stands_for() -> None:
    assert refusal("outer: {length_m: 1, <<: {count: 2}}").path == "outer.<<"
    assert loads("{ends: &e [1, 2], rows: [*e, *e]}", Mixed).value.rows == ((1.0, 2.0), (1.0, 2.0))


def test_the_string_below_a_key_says_what_it_means() -> None:
    said = meanings(File)
    assert said["outer.length_m"] == "A length, told in two lines"
    assert said["outer.inner.names"] == "Some names"
    assert "outer.inner.file" not in said
