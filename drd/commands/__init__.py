"""Subcommands of the daemon; the workshop's are in its own package."""

import argparse
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from drd.config.schema import ConfigError, Loaded


def config_argument(prog: str, description: str) -> argparse.ArgumentParser:
    """A parser with the argument CONFIG, which most commands take."""
    parser = argparse.ArgumentParser(prog=prog, description=description)
    parser.add_argument("config", type=Path, metavar="CONFIG", help="configuration file (YAML); see config/")
    return parser


@contextmanager
def placed(loaded: Loaded[Any]) -> Iterator[None]:
    """Parts of the daemon know a key's path but not its file: a ConfigError of theirs gets file and line here."""
    try:
        yield
    except ConfigError as error:
        if error.path in loaded.origins:
            raise ConfigError(loaded.place(error.path), error.path, error.expected, error.got) from error
        raise
