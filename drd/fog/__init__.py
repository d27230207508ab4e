"""Fibre-optic gyros: bytes in, gyro samples out."""

from drd.config.keys import Fog
from drd.fog.dsp17xx import Dsp17xxParser
from drd.fog.dsp3000 import Dsp3000Parser
from drd.fog.ecore import EcoreParser
from drd.fog.protocol import FogProtocol


def make_protocol(fog: Fog) -> FogProtocol:
    """The configured parser. Raises ValueError where the robot has no gyro (protocol none)."""
    parsers: dict[str, type[EcoreParser] | type[Dsp3000Parser] | type[Dsp17xxParser]] = {
        "ecore": EcoreParser,
        "dsp3000": Dsp3000Parser,
        "dsp17xx": Dsp17xxParser,
    }
    if fog.protocol not in parsers:
        raise ValueError(f"no gyro protocol {fog.protocol!r}")
    return parsers[fog.protocol](fog)
