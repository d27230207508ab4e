"""`drd run CONFIG`: the daemon."""

from typing import Final

from drd.commands import command, config_argument, placed
from drd.config.file import load_config
from drd.service.daemon import run

DESCRIPTION: Final = """\
Run the daemon: read the gyro and the wheel encoders that CONFIG names, estimate the pose, and publish it over Zenoh. A
device that is missing, is pulled or falls silent ends nothing: the pose says so, and the device is opened again.

It runs in the foreground and logs to standard error; under systemd (drd install-service) it says when it is ready, what
its state is, and feeds the watchdog. SIGINT (Ctrl-C) and SIGTERM end it; SIGHUP (systemctl reload) has it read CONFIG
again, and a CONFIG that is wrong then leaves the old one in force.
"""
EPILOG: Final = """\
examples:
  drd check mybot.yaml && drd run mybot.yaml
  drd watch                                    in another terminal: the pose, live
  drd run /etc/drd/mybot.yaml 2> drd.log

Every key of CONFIG is explained in the example configurations, and by `drd check --explain CONFIG`.
Exit code: 0 ended by a signal, 1 failed, 2 CONFIG or a file that it names cannot be used.
"""


def main(argv: list[str]) -> int:
    """Run until SIGINT or SIGTERM."""
    arguments = command("drd run", DESCRIPTION, EPILOG, [config_argument()]).parse_args(argv)
    loaded = load_config(arguments.config)
    with placed(loaded):
        return run(loaded, arguments.config.parent)
