"""`drd run CONFIG`: the daemon."""

from drd.commands import config_argument
from drd.config import load_config
from drd.daemon import run


def main(argv: list[str]) -> int:
    """Run until SIGINT or SIGTERM."""
    parser = config_argument(
        "drd run", "Run the daemon until SIGINT or SIGTERM. Exit codes: 0 ended, 1 failed, 2 bad configuration."
    )
    arguments = parser.parse_args(argv)
    return run(load_config(arguments.config), arguments.config.parent)
