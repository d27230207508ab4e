"""`python -m drd_tools.supply`: sbom, licences, audit LOCK."""

import argparse
import json
import sys
from pathlib import Path

from drd_tools.supply.audit import audit
from drd_tools.supply.licences import table
from drd_tools.supply.packages import ROBOT_EXTRAS, Package, installed
from drd_tools.supply.sbom import bill_of_materials


def sections() -> dict[str, list[Package]]:
    """Packages of the daemon, and those that each extra adds, by heading."""
    daemon = installed(extras=())
    found = {"the daemon": [p for name, p in daemon.items() if name != "drd"]}
    for extra in ROBOT_EXTRAS:
        found[f"with `[{extra}]`"] = [p for name, p in installed((extra,)).items() if name not in daemon]
    return found


def main(argv: list[str]) -> int:
    """Print the requested list."""
    parser = argparse.ArgumentParser(prog="python -m drd_tools.supply", description="What runs on a robot.")
    commands = parser.add_subparsers(dest="command", required=True)
    commands.add_parser("sbom", help="bill of materials, CycloneDX JSON, of what is installed here")
    commands.add_parser("licences", help="licences of what a robot may have, Markdown")
    text = "known vulnerabilities of the packages of a lock file; exit code 1: there are some"
    commands.add_parser("audit", help=text).add_argument("lock", type=Path)
    arguments = parser.parse_args(argv)
    if arguments.command == "audit":
        return audit(arguments.lock)
    if arguments.command == "sbom":
        print(json.dumps(bill_of_materials(installed()), indent=1))
    else:
        print(table(sections()), end="")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
