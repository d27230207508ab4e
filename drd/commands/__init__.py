"""Subcommands of the daemon, and code shared with the tools' subcommands, which are in a package of their own."""

import argparse
import importlib
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import drd
from drd.config.schema import ConfigError, Loaded


def command(
    prog: str, description: str, epilog: str, parents: Sequence[argparse.ArgumentParser] = ()
) -> argparse.ArgumentParser:
    """Make a parser that prints description and epilog (examples, exit codes) as written."""
    form = argparse.RawDescriptionHelpFormatter
    return argparse.ArgumentParser(prog, description=description, epilog=epilog, parents=parents, formatter_class=form)


def hand_over(prog: str, description: str, word: str, ways: Mapping[str, tuple[str, str]], argv: list[str]) -> int:
    """Run the command named by the first argument, a `word`; `ways`: module and summary of each."""
    width = max(map(len, ways))
    listed = "\n".join(f"  {name:{width}}  {summary}" for name, (_, summary) in ways.items())
    epilog = f"{word}s:\n{listed}\n\n`{prog} {word.upper()} --help` explains each."
    parser = command(prog, description, epilog)
    parser.add_argument(word, choices=tuple(ways), metavar=word.upper(), help=f"one of the {word}s below")
    parser.add_argument("arguments", nargs=argparse.REMAINDER, metavar="...", help=f"the {word}'s own arguments")
    chosen = parser.parse_args(argv)
    call: Callable[[list[str]], int] = importlib.import_module(ways[getattr(chosen, word)][0]).main
    return call(chosen.arguments)


def config_argument() -> argparse.ArgumentParser:
    """The argument CONFIG, for `parents`."""
    parser = argparse.ArgumentParser(add_help=False)
    parser.add_argument("config", type=Path, metavar="CONFIG", help="configuration file (YAML); see config/")
    return parser


def number(low: float = -math.inf, high: float = math.inf, *, above: bool = False) -> Callable[[str], float]:
    """Make an option type: a finite number from `low` to `high`; `above`: more than `low`."""
    if high < math.inf:
        wanted = f"a number from {low:g} to {high:g}"
    else:
        wanted = f"a number {'above' if above else 'of at least'} {low:g}" if low > -math.inf else "a finite number"

    def parsed(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not (low <= value <= high and math.isfinite(value)) or (above and value == low):
            raise argparse.ArgumentTypeError(f"expected {wanted}, got {text!r}")
        return value

    return parsed


def whole(low: int) -> Callable[[str], int]:
    """Make an option type: a whole number of at least `low`, which is 0 or more."""

    def parsed(text: str) -> int:
        if not text.isdecimal() or int(text) < low:
            raise argparse.ArgumentTypeError(f"expected a whole number of at least {low}, got {text!r}")
        return int(text)

    return parsed


@contextmanager
def writing(path: Path | None, what: str = "a folder to write to") -> Iterator[None]:
    """Raise ConfigError for an OSError inside: `path`, of kind `what`, cannot be written."""
    try:
        yield
    except BrokenPipeError:
        raise  # not the folder's error: the reader of the output has gone
    except OSError as error:
        raise ConfigError(str(path), "", what, str(error.strerror)) from error


@contextmanager
def placed(loaded: Loaded[Any]) -> Iterator[None]:
    """Add file and line to a ConfigError: parts of the daemon know a key's path but not its file."""
    try:
        yield
    except ConfigError as error:
        if error.path in loaded.origins:
            raise ConfigError(loaded.place(error.path), error.path, error.expected, error.got) from error
        raise


def shipped_file(folder: str, name: str) -> Path:
    """Path of a file that comes with drd: beside the package in a checkout, in its data when installed."""
    package = Path(drd.__file__).parent
    beside = package.parent / folder / name
    return beside if beside.exists() else package / "data" / folder / name
