"""Notifications of a Type=notify service to systemd (sd_notify(3)); none without systemd."""

import os
import socket
import time
from collections.abc import Mapping

from drd.units import NS_PER_US


class Notifier:
    """Sends state to $NOTIFY_SOCKET. Errors are counted, never raised; without the variable nothing is sent."""

    def __init__(self, environment: Mapping[str, str] = os.environ):
        self.counters = {"notify_errors": 0}
        address = environment.get("NOTIFY_SOCKET", "")
        # A leading @ stands for the zero byte of Linux's abstract names.
        self._address = "\0" + address[1:] if address.startswith("@") else address
        self.watchdog_period_s = _watchdog_period_s(environment)

    def ready(self, status: str) -> None:
        """Report that start-up is complete: units ordered after this one may start."""
        self._send(f"READY=1\nSTATUS={_line(status)}")

    def status(self, text: str) -> None:
        """Set the line that `systemctl status` shows."""
        self._send(f"STATUS={_line(text)}")

    def watchdog(self) -> None:
        """Report that the loop is alive; to be sent from it at least every `watchdog_period_s`."""
        self._send("WATCHDOG=1")

    def reloading(self) -> None:
        """Report that the configuration is being reloaded; `ready` ends it. Type=notify-reload requires the time."""
        self._send(f"RELOADING=1\nMONOTONIC_USEC={time.monotonic_ns() // NS_PER_US}")

    def stopping(self) -> None:
        """Report that the daemon is shutting down of its own accord."""
        self._send("STOPPING=1")

    def _send(self, text: str) -> None:
        if not self._address:
            return
        try:
            with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK) as s:
                s.sendto(text.encode("utf-8", "replace"), self._address)
        except (OSError, ValueError):
            self.counters["notify_errors"] += 1


def _watchdog_period_s(environment: Mapping[str, str]) -> float | None:
    """Half of $WATCHDOG_USEC, as sd_watchdog_enabled(3) advises; None: no watchdog, or one for another process."""
    try:
        if int(environment.get("WATCHDOG_PID", os.getpid())) != os.getpid():
            return None
        period_s = int(environment["WATCHDOG_USEC"]) * 0.5e-6
    except (KeyError, ValueError):
        return None
    return period_s if period_s > 0 else None


def _line(text: str) -> str:
    """The text as one line, since a line break would start another assignment."""
    return " ".join(text.splitlines())
