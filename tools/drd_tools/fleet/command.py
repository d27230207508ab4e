"""`drd fleet`: what to do decides which command runs."""

import argparse
import importlib
import logging
from collections.abc import Callable
from typing import Final

from drd.commands import command

ACTIONS: Final = {
    "update": ("drd_tools.fleet.update_command", "analyse the recordings that are new or have changed"),
    "query": ("drd_tools.fleet.query_command", "tables of the store, filtered or by SQL"),
    "report": ("drd_tools.fleet.report_command", "one page: what changed, since when, whose fault, what to inspect"),
    "prior": ("drd_tools.fleet.prior_command", "a robot's model.yaml, from its own history and the fleet's"),
    "simulate": ("drd_tools.fleet.simulate_command", "a fleet whose history is known"),
}


def main(argv: list[str]) -> int:
    """Hand over to the action's own command; returns its exit code."""
    width = max(map(len, ACTIONS))
    actions = "\n".join(f"  {name:{width}}  {summary}" for name, (_, summary) in ACTIONS.items())
    epilog = f"actions:\n{actions}\n\n`drd fleet ACTION --help` explains each."
    parser = command("drd fleet", "Diagnose thousands of recordings, and keep what they say as tables.", epilog)
    parser.add_argument("action", choices=tuple(ACTIONS), metavar="ACTION", help="one of the actions below")
    parser.add_argument("arguments", nargs=argparse.REMAINDER, metavar="...", help="the action's own arguments")
    chosen = parser.parse_args(argv)
    # pandas, which pyarrow loads where it is there, announces its threads.
    logging.getLogger("numexpr").setLevel(logging.WARNING)
    call: Callable[[list[str]], int] = importlib.import_module(ACTIONS[chosen.action][0]).main
    return call(chosen.arguments)
