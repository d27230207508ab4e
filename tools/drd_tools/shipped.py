"""Files that come with drd."""

from pathlib import Path

from drd.commands import shipped_file


def shipped_config(name: str) -> Path:
    """Find a configuration in `config/`."""
    return shipped_file("config", name)
