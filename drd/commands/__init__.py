"""Subcommands of the daemon; the workshop's are in its own package."""

import argparse
from pathlib import Path


def config_argument(prog: str, description: str) -> argparse.ArgumentParser:
    """A parser with the argument CONFIG, which most commands take."""
    parser = argparse.ArgumentParser(prog=prog, description=description)
    parser.add_argument("config", type=Path, metavar="CONFIG", help="configuration file (YAML); see config/")
    return parser
