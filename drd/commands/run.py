"""`drd run CONFIG`: the daemon."""

from drd.commands import config_argument, placed
from drd.config_file import load_config
from drd.daemon import run


def main(argv: list[str]) -> int:
    """Run until SIGINT or SIGTERM."""
    parser = config_argument(
        "drd run", "Run the daemon until SIGINT or SIGTERM. Exit codes: 0 ended, 1 failed, 2 bad configuration."
    )
    arguments = parser.parse_args(argv)
    loaded = load_config(arguments.config)
    with placed(loaded):
        return run(loaded, arguments.config.parent)
