"""Options shared by several tools, for `parents` of their parsers."""

import argparse
import math
from pathlib import Path
from typing import Any

from drd.commands import number, whole


def _parent() -> tuple[argparse.ArgumentParser, Any]:
    parser = argparse.ArgumentParser(add_help=False)
    return parser, parser.add_argument


def kept(required: bool = True) -> argparse.ArgumentParser:
    """--output or --draw, for commands that save their results: see report/saved.py."""
    parser, _ = _parent()
    add: Any = parser.add_mutually_exclusive_group(required=required).add_argument
    add("--output", type=Path, metavar="DIR", help="folder for results.json, report.html and pictures")
    add("--draw", type=Path, metavar="DIR", help="only print, report and draw the results that DIR holds")
    return parser


def model() -> argparse.ArgumentParser:
    """--model, for recording folders."""
    parser, add = _parent()
    text = "model file: keys of robot.yaml that replace the folder's, and effects"
    add("--model", type=Path, metavar="FILE", help=text)
    return parser


def replayed() -> argparse.ArgumentParser:
    """--config, --calibration and --model, which replace the recording's own."""
    parser, add = _parent()
    text = "daemon configuration or a part; what it states replaces the recording's"
    add("--config", type=Path, metavar="FILE", help=text)
    add("--calibration", type=Path, metavar="FILE", help="calibration of the gyro (drd calibrate gyro)")
    return argparse.ArgumentParser(add_help=False, parents=[parser, model()])


def listen(port: int) -> argparse.ArgumentParser:
    """--listen HOST:PORT of a server, as host (an IPv6 address in brackets) and port; `port`: the default's."""
    parser, add = _parent()
    text = f"where to serve; port 0: any free one (default: 127.0.0.1:{port})"
    add("--listen", type=_address, default=("127.0.0.1", port), metavar="HOST:PORT", help=text)
    return parser


def _address(text: str) -> tuple[str, int]:
    host, _, port = text.rpartition(":")
    if not host or not port.isdecimal() or int(port) > 0xFFFF or (":" in host and not host.startswith("[")):
        raise argparse.ArgumentTypeError(f"expected HOST:PORT, as in 127.0.0.1:8080 or [::1]:8080, got {text!r}")
    return host, int(port)


def reference_sigma() -> argparse.ArgumentParser:
    """--reference-sigma, two numbers."""
    parser, add = _parent()
    text = "standard deviations of the reference's coordinates and heading (default: robot.yaml's)"
    add("--reference-sigma", nargs=2, type=number(0.0), metavar=("M", "DEG"), help=text)
    return parser


def reference_lag() -> argparse.ArgumentParser:
    """--reference-lag, seconds; NaN: auto."""
    parser, add = _parent()
    text = "how late the reference is, s; auto: what the headings show (default: 0)"
    add("--reference-lag", type=_lag, default=0.0, metavar="S|auto", help=text)
    return parser


def _lag(text: str) -> float:
    return math.nan if text == "auto" else number()(text)


def seed(what: str, default: int = 0) -> argparse.ArgumentParser:
    """--seed N, the seed of `what`."""
    parser, add = _parent()
    add("--seed", type=whole(0), default=default, metavar="N", help=f"seed of {what} (default {default})")
    return parser
