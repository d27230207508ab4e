"""The program `drd`: one command, with subcommands of the daemon and of the workshop."""

import argparse
import importlib
import logging
import os
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from drd import __version__
from drd.commands import command
from drd.config.schema import ConfigError


@dataclass(frozen=True)
class Command:
    """Where a subcommand lives; only the chosen one is imported."""

    module: str
    summary: str
    extra: str = ""  # optional dependencies that it needs


COMMANDS = {
    "run": Command("drd.commands.run", "run the daemon"),
    "check": Command("drd.commands.check", "check a configuration and, with --live, the wiring"),
    "watch": Command("drd.commands.watch", "watch the pose and the health, live"),
    "foxglove": Command("drd_tools.foxglove_command", "show a running drd in Foxglove, live", "foxglove"),
    "install-service": Command("drd.commands.install_service", "install the daemon as a systemd service"),
    "refused": Command("drd.commands.refused", "list the system calls that the service's sandbox has refused"),
    "emulate": Command("drd_tools.emulate.command", "emulate the hardware: gyro and encoders on a path", "tools"),
    "calibrate": Command("drd_tools.calibrate.command", "calibrate the gyro or the wheels", "tools"),
    "paper": Command("drd_tools.paper.command", "repeat the paper's experiments in simulation", "tools"),
    "import": Command("drd_tools.importing.command", "convert a ROS bag, CAN log or table to a recording", "tools"),
    "simulate": Command("drd_tools.simulate_command", "simulate a drive and record it", "tools"),
    "replay": Command("drd_tools.replay.command", "run the estimator on a recording", "tools"),
    "export": Command("drd_tools.export.command", "export poses as ROS 2 bag, CSV, TUM or Parquet", "tools"),
    "evaluate": Command("drd_tools.evaluate.command", "evaluate poses against a reference", "tools"),
    "explain": Command("drd_tools.explain.command", "break the pose's error budget down by cause", "tools"),
    "compare": Command("drd_tools.compare.command", "compare recorded with simulated increments", "tools"),
    "diagnose": Command("drd_tools.diagnose.command", "find the physics that the nominal model leaves out", "tools"),
    "trial": Command("drd_tools.trial.command", "score the diagnosis on drives with known answers", "tools"),
    "fleet": Command("drd_tools.fleet.command", "diagnose and query thousands of recordings", "fleet"),
    "web": Command("drd_tools.web.command", "show pose, health and a map in the browser; Prometheus metrics", "web"),
    "ros2": Command("drd_tools.ros2.command", "run a ROS 2 node, for middleware other than Zenoh", "ros2"),
    "demo": Command("drd_tools.demo", "run emulator, daemon and watcher together; draw the result", "tools"),
}


class _Formatter(logging.Formatter):
    """One line per record; under systemd prefixed with the priority, which journald strips (sd-daemon(3))."""

    def format(self, record: logging.LogRecord) -> str:
        return _priority(record.levelno) + super().format(record)


def _priority(level: int) -> str:
    if "JOURNAL_STREAM" not in os.environ:
        return ""
    return "<3>" if level >= logging.ERROR else "<4>" if level >= logging.WARNING else "<6>"


def _parser() -> argparse.ArgumentParser:
    width = max(map(len, COMMANDS))
    lines = [
        f"  {name:{width}}  {c.summary}{f' (extra: {c.extra})' if c.extra else ''}" for name, c in COMMANDS.items()
    ]
    text = "Dead reckoning for wheeled robots: gyro and encoders in, pose with its uncertainty out."
    parser = command("drd", text, "commands:\n" + "\n".join(lines) + "\n\n`drd COMMAND --help` explains each.")
    parser.add_argument("--version", action="version", version=f"drd {__version__}")
    parser.add_argument("command", choices=tuple(COMMANDS), metavar="COMMAND", help="one of the commands below")
    parser.add_argument("arguments", nargs=argparse.REMAINDER, metavar="...", help="the command's own arguments")
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Run a subcommand and return its exit code: 0 done, 1 failed, 2 bad usage or configuration."""
    parser = _parser()
    argv = sys.argv[1:] if argv is None else argv
    if not argv:
        parser.print_help(sys.stderr)
        return 2
    chosen = parser.parse_args(argv)
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(_Formatter("level=%(levelname)s %(name)s %(message)s"))
    logging.basicConfig(level=logging.INFO, handlers=[handler])
    # python-can logs each failed attempt to open a bus; the port's state says it once.
    logging.getLogger("can").setLevel(logging.CRITICAL)
    logging.getLogger("numexpr").setLevel(logging.WARNING)  # imported by pandas, it logs its number of threads
    about = COMMANDS[chosen.command]
    try:
        call: Callable[[list[str]], int] = importlib.import_module(about.module).main
        code = call(chosen.arguments)
        sys.stdout.flush()
        return code
    except ModuleNotFoundError as error:
        if not about.extra:
            raise
        print(
            f"drd {chosen.command}: the Python package {error.name} is missing; "
            f"install the extra: pip install 'drd[{about.extra}]'",
            file=sys.stderr,
        )
        return 2
    except ConfigError as error:
        print(f"{_priority(logging.ERROR)}drd {chosen.command}: {error}", file=sys.stderr)
        return 2
    except BrokenPipeError:
        # The reader (head, less) has left. Python would complain once more when it flushes at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except KeyboardInterrupt:
        return 130
