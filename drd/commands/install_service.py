"""`drd install-service NAME`: install the daemon as a systemd service that starts at boot, or uninstall it."""

import argparse
import grp
import os
import re
import shlex
import shutil
import subprocess
import sys
import sysconfig
from pathlib import Path
from typing import Final

import drd
from drd.commands import command, shipped_file
from drd.commands.installation import Installation, say
from drd.commands.locked import install_locked
from drd.config.schema import ConfigError

UNIT: Final = "etc/systemd/system/drd@.service"
MANAGER: Final = "etc/systemd/system.conf.d/drd-log-refused.conf"
DROP_INS: Final = "etc/systemd/system/drd@.service.d"
RULES: Final = "etc/udev/rules.d/99-drd.rules"
CONFIGS: Final = "etc/drd"
# systemd keeps a DynamicUser's state in the second folder and links to it from the first.
STATES: Final = ("var/lib", "var/lib/private")
EXAMPLES: Final = ("canopen", "pioneer-at", "agilex-scout", "odrive")
SERIAL_GROUPS: Final = ("dialout", "uucp")
# Folders that the unit's ProtectHome and PrivateTmp hide from the service.
HIDDEN: Final = ("/home", "/root", "/run/user", "/tmp", "/var/tmp")
PROGRAM_IN_UNIT: Final = "/opt/drd/bin/drd"
# The packages that the daemon needs, with their hashes; `make lock` writes it.
LOCK: Final = "robot.lock"
SHIPPED: Final = "shipped"

DESCRIPTION: Final = """\
Install drd as a systemd service: `drd@NAME` runs with /etc/drd/NAME.yaml in a sandbox under a watchdog and starts at
boot. Needs root, except with --root. Nothing is started or enabled: the commands for that are printed.

Files (under --root):
  /etc/systemd/system/drd@.service    the unit; ExecStart is the drd that you call, from its own Python environment
  /etc/udev/rules.d/99-drd.rules      stable names for the gyro's and the CAN adapter's serial ports, to be edited
  /etc/drd/NAME.yaml                  an example configuration (--example), if there is none yet
  /etc/drd/.installed.json            the files installed, for --uninstall
with --realtime
  /etc/systemd/system/drd@.service.d/realtime.conf    priority, locked memory
with --slcan
  /etc/systemd/system/drd@.service.d/slcan.conf       no CAN sockets: the CAN adapters of all instances are serial ports
with --tls
  /etc/systemd/system/drd@.service.d/tls.conf         hands the private key /etc/drd/tls/robot.key to the service
  /etc/drd/NAME-tls.json5                             certificates and access control, to be edited; see its header
with --log-refused
  /etc/systemd/system.conf.d/drd-log-refused.conf     refused system calls go into the kernel's log,
                                                      for `drd refused`; then systemctl daemon-reexec

--lock FILE first installs the package versions of a lock file into drd's environment with
`pip install --require-hashes`: a package whose hash differs is refused, and then nothing is written. `--lock shipped`
uses the lock file that comes with this drd (Linux on x86_64 and aarch64); `make lock` makes a new one.

Running it again changes nothing; running it with another version of drd updates the files. An existing configuration is
never touched, and neither is any other file that you have changed: its new version is written next to it as FILE.new.
Put your own settings into a drop-in (`systemctl edit drd@NAME`), so that there is nothing to merge.

--uninstall stops and disables all instances and removes what was installed. Configurations, files that you have
changed and state (the stored pose, recordings) are kept and listed; --purge removes them as well.
"""
EPILOG: Final = """\
examples:
  sudo /opt/drd/bin/drd install-service mybot
  sudo /opt/drd/bin/drd install-service scout --example agilex-scout --realtime
  sudo /opt/drd/bin/drd install-service mybot --lock shipped
  drd install-service mybot --root build/package --program /usr/bin/drd
  sudo /opt/drd/bin/drd install-service --uninstall

Exit code: 0 done, 1 a file could not be written or removed, 2 bad usage, or packages that differ from the lock file.
"""


def main(argv: list[str]) -> int:
    """Install or uninstall; print each file and what to type next."""
    parser = _parser()
    arguments = parser.parse_args(argv)
    if arguments.purge and not arguments.uninstall:
        parser.error("--purge goes with --uninstall")
    if arguments.uninstall and arguments.name is not None:
        parser.error("--uninstall takes all instances out; it needs no NAME")
    if not arguments.uninstall and arguments.name is None:
        parser.error("NAME is missing: which robot base is it?")
    if arguments.lock is not None and (arguments.uninstall or arguments.root != "/"):
        parser.error("--lock goes with an installation into the running system")
    root = Path(arguments.root).absolute()
    try:
        if arguments.uninstall:
            _uninstall(root, arguments.purge)
        else:
            _install(root, arguments)
    except OSError as error:
        hint = "; it needs root" if isinstance(error, PermissionError) else ""
        print(f"drd install-service: {error.filename}: {error.strerror}{hint}", file=sys.stderr)
        return 1
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = command("drd install-service", DESCRIPTION, EPILOG)
    add = parser.add_argument
    add("name", nargs="?", type=_instance, metavar="NAME", help="name of the instance and of its configuration")
    text = "which example becomes /etc/drd/NAME.yaml where there is none (default: %(default)s)"
    add("--example", choices=EXAMPLES, default=EXAMPLES[0], help=text)
    add("--realtime", action="store_true", help="also install the drop-in for real-time scheduling")
    text = "also install the drop-in that denies CAN sockets, for serial CAN adapters"
    add("--slcan", action="store_true", help=text)
    add("--tls", action="store_true", help="also install the drop-in and the Zenoh configuration for certificates")
    text = "make systemd log the system calls that sandboxes refuse, for `drd refused`"
    add("--log-refused", action="store_true", help=text)
    add("--program", metavar="FILE", help="program for ExecStart (default: the drd of this Python environment)")
    text = f"install the packages of this lock file first, hashes checked ({SHIPPED!r}: the one of this drd)"
    add("--lock", metavar="FILE", help=text)
    add("--root", default="/", metavar="DIR", help="install below this folder, e.g. to build a package (default: /)")
    text = "stop and disable drd@*, remove what was installed, keep your files"
    add("--uninstall", action="store_true", help=text)
    text = "with --uninstall: also remove installed configurations, changed files and state (recordings!)"
    add("--purge", action="store_true", help=text)
    return parser


def _instance(text: str) -> str:
    if not re.fullmatch(r"[A-Za-z0-9_][A-Za-z0-9_.-]*", text):
        raise argparse.ArgumentTypeError(f"letters, digits, '_', '.' and '-' make a name, got {text!r}")
    return text


def _install(root: Path, arguments: argparse.Namespace) -> None:
    name, program = arguments.name, _program(arguments.program, root)
    config, group = f"{CONFIGS}/{name}.yaml", _serial_group(root)
    if arguments.lock is not None:
        install_locked(program, shipped_file("systemd", LOCK) if arguments.lock == SHIPPED else Path(arguments.lock))
    with Installation.read(root) as files:
        files.put(UNIT, _unit(program, group), f"starts {program}")
        files.put(RULES, _rules(group), "edit it: your gyro's serial number")
        files.put_once(config, _shipped("config", f"{arguments.example}.yaml"), f"edit it: this is {arguments.example}")
        for option in ("realtime", "slcan", "tls"):
            if getattr(arguments, option) or f"{DROP_INS}/{option}.conf" in files.files:
                files.put(f"{DROP_INS}/{option}.conf", _shipped("systemd", f"{option}.conf"))
        if arguments.log_refused or MANAGER in files.files:
            files.put(MANAGER, _shipped("systemd", "log-refused.conf"), "then systemctl daemon-reexec")
        if arguments.tls:
            text = _shipped("config", "zenoh-tls.json5").replace("drd@mybot.service", f"drd@{name}.service")
            files.put_once(f"{CONFIGS}/{name}-tls.json5", text, "edit it: its head says how")
    if root != Path("/"):
        return
    print("\nnext, when the files say what your robot is:")
    print(f"  {shlex.quote(program)} check /{config}")
    print("  udevadm control --reload && udevadm trigger")
    print(f"  systemctl daemon-reload && systemctl enable --now drd@{name}")
    print(f"  systemctl status drd@{name}")


def _uninstall(root: Path, purge: bool) -> None:
    with Installation.read(root) as files:
        # A configuration from before is not in the list of installed files, but its instance has a state.
        configs = [*map(Path, files.files), *(root / CONFIGS).glob("*.yaml")]
        instances = sorted({f.stem for f in configs if f.match(f"{CONFIGS}/*.yaml")})
        states = [root / folder / f"drd-{name}" for folder in STATES for name in instances]
        if not files.files and not (purge and any(map(os.path.lexists, states))):
            print(f"nothing is installed under {root} (by this command)")
            return
        _stop(root)
        files.remove(lambda f: f.startswith(f"{CONFIGS}/"), purge)
        for folder in states:
            _remove_state(folder, purge)
    if _is_live(root):
        _run("systemctl", "daemon-reload")
        _run("udevadm", "control", "--reload")


def _remove_state(folder: Path, purge: bool) -> None:
    if folder.is_symlink():
        if purge:
            folder.unlink()
    elif folder.is_dir():
        if purge:
            shutil.rmtree(folder)
        say("removed" if purge else "kept", folder, "" if purge else "state and recordings; --purge removes it")


def _stop(root: Path) -> None:
    """Stop and disable all instances; where systemd does not run, only remove the links that enable them."""
    units = root / "etc/systemd/system"
    enabled = sorted(link for link in units.glob("*.wants/drd@*.service") if link.is_symlink())
    if _is_live(root):
        _run("systemctl", "stop", "drd@*.service")
        if enabled:
            _run("systemctl", "disable", *(link.name for link in enabled))
    for link in enabled:
        link.unlink(missing_ok=True)


def _is_live(root: Path) -> bool:
    return root == Path("/") and Path("/run/systemd/system").is_dir()


def _run(*command: str) -> None:
    """Run a system command; a failure is printed, not raised."""
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=60.0)
    except (OSError, subprocess.TimeoutExpired) as error:
        print(f"{shlex.join(command)}: {error}")
        return
    if done.returncode:
        print(f"{shlex.join(command)}: {done.stderr.strip() or f'exit code {done.returncode}'}")


def _program(given: str | None, root: Path) -> str:
    """Program for ExecStart. Raises ConfigError where the service could not run it."""
    program = Path(given) if given is not None else Path(sysconfig.get_path("scripts")) / "drd"
    if not program.is_absolute() or not re.fullmatch(r"[\w./+@-]+", str(program)):
        raise _unfit("an absolute path of letters, digits and ./+@_-", repr(str(program)))
    if root == Path("/"):
        if not program.is_file():
            raise _unfit("the installed program", f"{program}, which is not there")
        places = [program, program.resolve()]
        if given is None:  # its Python and its package may be elsewhere: pyenv, an editable installation
            places += [Path(sys.base_prefix).resolve(), Path(drd.__file__).resolve()]
        hidden = [place for place in places if any(place.is_relative_to(folder) for folder in HIDDEN)]
        if hidden:
            got = f"{hidden[0]}, which the service does not see (ProtectHome, PrivateTmp)"
            raise _unfit("a drd and a Python outside of people's folders, such as in /opt/drd", got)
    return str(program)


def _unfit(expected: str, got: str) -> ConfigError:
    return ConfigError("drd@.service", "ExecStart", expected, got)


def _unit(program: str, group: str) -> str:
    """The shipped unit with this program and this group."""
    text = _shipped("systemd", "drd@.service")
    assert f"ExecStart={PROGRAM_IN_UNIT} " in text  # ensured by a test
    text = text.replace(f"ExecStart={PROGRAM_IN_UNIT} ", f"ExecStart={program} ")
    return text.replace(f"SupplementaryGroups={SERIAL_GROUPS[0]}\n", f"SupplementaryGroups={group}\n")


def _rules(group: str) -> str:
    return _shipped("systemd", "99-drd.rules").replace(f'GROUP="{SERIAL_GROUPS[0]}"', f'GROUP="{group}"')


def _serial_group(root: Path) -> str:
    """Group of serial ports; on the running system, the one that exists there."""
    if root != Path("/"):
        return SERIAL_GROUPS[0]
    known = {g.gr_name for g in grp.getgrall()}
    return next((name for name in SERIAL_GROUPS if name in known), SERIAL_GROUPS[0])


def _shipped(folder: str, name: str) -> str:
    return shipped_file(folder, name).read_text(encoding="utf-8")
