"""The monitor as a separate process: samples come in on standard input, a socket, and reports go out on it.

It ends when the daemon closes the socket, and on any error, which it reports; the daemon starts it again.
"""

import contextlib
import gc
import os
import resource
import signal
import socket
import sys
import time
import traceback
from pathlib import Path
from typing import Final

import msgspec

from drd.monitor.applying import Applying
from drd.monitor.lasting import LastingMonitor
from drd.monitor.wear import is_wear
from drd.samples import GyroSample, WheelSample
from drd.service.monitor_channel import CLOCK, FIX, GAP, GYRO, LARGEST_PACKET_BYTES, RECORD, Report, Setup
from drd.units import S_PER_NS

# Limit of private memory; it uses 60 MiB at the start, and Python and numpy need more for short times.
MEMORY_BYTES: Final = 192 << 20
BYTES_PER_MB: Final = 1e6
LAST_PRIORITY: Final = 19
POLICY_FIELD: Final = 38  # in /proc/self/stat, counted after the name; proc(5) has it as number 41
# Marks a wheel sample as the first after unseen motion, whose length does not matter to the monitor.
UNSEEN_S: Final = 1e-9


class Feed:
    """Passes records to a monitor as samples; `take` returns whether the monitor has completed a block."""

    def __init__(self, setup: Setup):
        self._lasting = LastingMonitor(setup.config, setup.memory, setup.wall_zero_ns, setup.began_ns)
        self.monitor = self._lasting.monitor
        self._applying = Applying()
        self._calibration = setup.calibration
        self._is_new = False
        self.samples = self.gaps = 0

    def take(self, packet: bytes) -> bool:
        """Pass on the records of one packet. Raises anything that the monitor raises."""
        before_s = self.monitor.now_s
        for kind, t_ns, a, b, c, d in RECORD.iter_unpack(packet):
            if kind == GAP:
                self.gaps += 1
                self._is_new = True
            elif kind == FIX:
                self.monitor.fix(t_ns, a, b, c)
            elif kind == CLOCK:
                self._lasting.clock(t_ns)
            elif kind == GYRO:
                self.samples += 1
                if self._calibration is not None:
                    b = self._calibration.correct(GyroSample(t_ns, a, b, c)).rate_rad_s  # noqa: PLW2901
                self.monitor.gyro(GyroSample(t_ns, a, b, c))
            else:
                self.samples += 1
                # The monitor sees a gap of the gyro in the stamps; one of the wheels must be marked.
                self.monitor.wheels(WheelSample(t_ns, a, b, c, max(d, UNSEEN_S) if self._is_new else d))
                self._is_new = False
        return self.monitor.now_s != before_s

    def report(self, notes: list[str]) -> Report:
        """The report on the samples so far."""
        findings = self._lasting.findings()
        self._applying.look(self.monitor, [f for f in findings if not is_wear(f)])
        return Report(
            findings=findings,
            suspected=self.monitor.suspected(),
            not_observable=self.monitor.not_observable(),
            is_judging=self.monitor.is_judging,
            tread_wanders=self.monitor.wanders,
            day=self._lasting.day,
            known=self._lasting.known,
            began_ns=self.monitor.zero_ns,
            wanted=self._applying.wanted,
            samples=self.samples,
            gaps=self.gaps,
            cpu_s=time.process_time_ns() * S_PER_NS,
            memory_mb=resident_bytes() / BYTES_PER_MB,
            notes=notes,
        )


def resident_bytes() -> int:
    """Memory of this process; getrusage would report the peak of the daemon, which started it."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize()


def step_back() -> list[str]:
    """Take the lowest priority for processor and memory; return the requests that the system refused.

    Raises PermissionError if it has the daemon's real-time priority and cannot give it up.
    """
    notes = []
    # Read from a file, since the sandbox refuses the system call.
    policy = int(Path("/proc/self/stat").read_text().rpartition(")")[2].split()[POLICY_FIELD])
    if policy & ~os.SCHED_RESET_ON_FORK in (os.SCHED_FIFO, os.SCHED_RR):
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    try:
        os.setpriority(os.PRIO_PROCESS, 0, LAST_PRIORITY)  # os.nice would query the old one, which the sandbox refuses
    except OSError as error:
        notes.append(f"low priority refused: {error.strerror}; SystemCallFilter=setpriority in a drop-in allows it")
    with contextlib.suppress(OSError, ValueError):  # ValueError: a lower limit is in force
        resource.setrlimit(resource.RLIMIT_DATA, (MEMORY_BYTES, MEMORY_BYTES))
    with contextlib.suppress(OSError):  # to be killed before any other process
        Path("/proc/self/oom_score_adj").write_text("1000")
    return notes


def serve(channel: socket.socket) -> None:
    """Take samples and send reports until the other end is closed. Raises any error."""
    notes = step_back()
    feed = Feed(msgspec.json.decode(channel.recv(LARGEST_PACKET_BYTES), type=Setup))
    gc.freeze()
    channel.send(msgspec.json.encode(feed.report(notes)))
    while packet := channel.recv(LARGEST_PACKET_BYTES):
        if feed.take(packet):
            channel.send(msgspec.json.encode(feed.report(notes)))


def main() -> int:
    """Serve the daemon; exit code 0 after it has closed the channel, 1 after an error."""
    # It must not end before the daemon does, but a terminal and systemd signal both at once.
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    with socket.socket(fileno=os.dup(0)) as channel:
        try:
            serve(channel)
        except (BrokenPipeError, ConnectionResetError):
            return 0
        except Exception as error:
            at = traceback.extract_tb(error.__traceback__)[-1]
            text = f"{type(error).__name__}: {str(error)[:200]} ({Path(at.filename).name}:{at.lineno})"
            with contextlib.suppress(OSError):
                channel.send(msgspec.json.encode(Report(error=text)))
            return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
