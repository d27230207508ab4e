"""Wheel encoders: CAN frames in, travel of both wheels out."""

from collections.abc import Callable
from pathlib import Path
from typing import Final

from drd.config.keys import Encoders
from drd.config.schema import ConfigError
from drd.encoders.agilex import Agilex
from drd.encoders.cia406 import Cia406
from drd.encoders.dbc import Dbc
from drd.encoders.layout import Layout
from drd.encoders.odrive import Odrive
from drd.encoders.vesc import Vesc

LAYOUTS: Final[dict[str, Callable[[Encoders, Path], Layout]]] = {
    "cia406": Cia406,
    "agilex": lambda _encoders, _base: Agilex(),
    "odrive": Odrive,
    "vesc": Vesc,
    "dbc": Dbc,
}


def make_layout(encoders: Encoders, base: Path) -> Layout:
    """The configured layout; files are relative to `base`. Raises ConfigError naming the key at fault."""
    layout = LAYOUTS[encoders.layout](encoders, base)
    if encoders.modulus_counts is not None:
        own, got = layout.modulus_counts, str(encoders.modulus_counts)
        if own is None and (layout.reports_speed or encoders.layout == "odrive"):
            raise ConfigError(str(base), "encoders.modulus_counts", "null, since no counts are read", got)
        if own is not None and encoders.modulus_counts > own:
            raise ConfigError(str(base), "encoders.modulus_counts", f"at most {own}, the capacity of the field", got)
        layout.modulus_counts = encoders.modulus_counts
    return layout
