"""Files that come with drd."""

from pathlib import Path

import drd


def shipped_config(name: str) -> Path:
    """A configuration of `config/`: in a checkout beside the package, in an installation among its data."""
    package = Path(drd.__file__).parent
    beside = package.parent / "config" / name
    return beside if beside.exists() else package / "data" / "config" / name
