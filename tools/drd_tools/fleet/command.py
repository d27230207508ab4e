"""`drd fleet`: hand over to the command of an action."""

import logging
from typing import Final

from drd.commands import hand_over

ACTIONS: Final = {
    "update": ("drd_tools.fleet.update_command", "analyse the recordings that are new or have changed"),
    "query": ("drd_tools.fleet.query_command", "tables of the store, filtered or by SQL"),
    "report": ("drd_tools.fleet.report_command", "one page: what changed, since when, the cause, what to inspect"),
    "prior": ("drd_tools.fleet.prior_command", "model.yaml of a robot, from its own history and the fleet's"),
    "simulate": ("drd_tools.fleet.simulate_command", "simulate a fleet with a known history"),
}


def main(argv: list[str]) -> int:
    """Hand over to the action's own command; returns its exit code."""
    # pyarrow loads pandas if it is installed, which logs its number of threads.
    logging.getLogger("numexpr").setLevel(logging.WARNING)
    description = "Diagnose thousands of recordings and keep the results as tables."
    return hand_over("drd fleet", description, "action", ACTIONS, argv)
