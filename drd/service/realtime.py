"""Scheduling of the daemon: garbage collection, memory locking, priority. Refusals are reported, not raised."""

import ctypes
import gc
import os
import resource

from drd.config.keys import Realtime

_MCL_CURRENT_FUTURE = 1 | 2  # MCL_CURRENT | MCL_FUTURE of <sys/mman.h>


def apply(realtime: Realtime) -> list[str]:
    """Put `realtime` into force for this process; call after start-up, from the thread that runs the event loop.

    Returns one message for each key that the system refused: key, reason, remedy. Never raises.
    """
    if realtime.freeze_gc:
        gc.collect()
        gc.freeze()
    refused: list[str] = []
    if realtime.lock_memory and (reason := _lock_memory()):
        refused.append(
            f"realtime.lock_memory: {reason}. Give the service LimitMEMLOCK=infinity and SystemCallFilter=@memlock, as "
            "realtime.conf does (ulimit -l unlimited in a shell), or set the key to false"
        )
    if realtime.fifo_priority and (reason := _fifo(realtime.fifo_priority)):
        refused.append(
            f"realtime.fifo_priority: SCHED_FIFO {realtime.fifo_priority} refused: {reason}. Give the service "
            f"LimitRTPRIO={realtime.fifo_priority} or more, RestrictRealtime=no and SystemCallFilter=@resources, as "
            "realtime.conf does, or set the key to 0"
        )
    return refused


def _lock_memory() -> str:
    """Why memory could not be locked; empty: it is locked."""
    # Under a finite limit mlockall may succeed, and MCL_FUTURE then turns a later allocation into a MemoryError.
    limit, _ = resource.getrlimit(resource.RLIMIT_MEMLOCK)
    if limit != resource.RLIM_INFINITY:
        return f"only {limit // 1024} KiB may be locked"
    try:
        if ctypes.CDLL(None, use_errno=True).mlockall(_MCL_CURRENT_FUTURE) == 0:
            return ""
    except (OSError, AttributeError) as error:
        return f"mlockall is missing: {error}"
    return f"mlockall refused: {os.strerror(ctypes.get_errno())}"


def _fifo(priority: int) -> str:
    """Why the priority was refused; empty: it is in force, for this thread but none that it starts later."""
    try:
        # Where the service manager has given SCHED_FIFO to all threads, the ports' workers keep it: one sends SYNC.
        for_later_threads = 0 if os.sched_getscheduler(0) == os.SCHED_FIFO else os.SCHED_RESET_ON_FORK
        os.sched_setscheduler(0, os.SCHED_FIFO | for_later_threads, os.sched_param(priority))
    except OSError as error:
        return error.strerror or str(error)
    return ""
