"""The state of a running daemon: restored at the start, and saved at the right moments."""

import logging
import os
import time
from dataclasses import replace
from typing import Any, Final

from drd.config.keys import Config
from drd.pipeline import Pipeline
from drd.state.restart import has_clock_chip, warm_restart
from drd.state.saved import Moment, Saved, decoded, encoded, moment_now, this_boot
from drd.state.sealed import StateError
from drd.state.store import Store, state_file
from drd.units import NS_PER_S

log = logging.getLogger(__name__)

# A shorter suspension is no longer than the waits of a busy machine.
LEAST_SLEEP_NS: Final = NS_PER_S
# In place of a boot id, for moments within this run.
THIS_RUN: Final = "this run"


class StateKeeper:
    """Lets a pipeline continue from its robot's saved state, and saves the state from then on.

    It is saved every `state.period_s`, when the robot starts to move (so that "at rest" in a file is true however the
    daemon ends), and at the end. A suspended machine did not watch its robot: CLOCK_MONOTONIC, which times all sensors,
    stood still, and only CLOCK_BOOTTIME shows it. The pipeline then continues as after a restart.
    """

    def __init__(self, config: Config, pipeline: Pipeline):
        self._config, self._pipeline = config, pipeline
        self._store = Store(file, encoded, decoded) if (file := state_file(config)) is not None else None
        self._boot_id = this_boot(os.environ)
        self._due_ns = 0
        self._said_at_rest = False
        self._asleep_ns = asleep_ns()
        self.start_text = "cold start"
        self._start: dict[str, Any] = {"kind": "cold", "off_s": None}

    def begin(self, now_ns: int) -> None:
        """Read the state and let the pipeline continue from it. Call before the first input."""
        if self._store is None:
            return
        try:
            saved = self._store.load()
            if saved is None:
                self.start_text = "cold start, no state yet"
        except StateError as error:
            saved, self.start_text = None, f"cold start, the state was refused: {error}"
        if saved is not None:
            restart = warm_restart(saved, moment_now(self._boot_id), self._config, self._pipeline, has_clock_chip())
            self._pipeline.resume(now_ns, restart.estimate, restart.bias_known)
            self._start = {"kind": "warm", "off_s": restart.off_s}
            self.start_text = restart.text
        log.log(logging.WARNING if "refused" in self.start_text else logging.INFO, "start=%s", self.start_text)
        self._store.start()

    def put_in_force(self, config: Config) -> None:
        """Continue with another configuration; the file stays the same."""
        self._config = config

    def tick(self, now_ns: int) -> None:
        """Save the state when due, and detect that the machine was suspended. Call often."""
        before_ns, self._asleep_ns = self._asleep_ns, asleep_ns()
        slept_ns = self._asleep_ns - before_ns
        if slept_ns > LEAST_SLEEP_NS:
            self._wake(now_ns, slept_ns)
        if self._store is None:
            return
        departed = self._said_at_rest and not self._pipeline.estimator.at_rest
        if departed or now_ns >= self._due_ns:
            self._put(now_ns)

    def close(self, deadline_s: float) -> bool:
        """Write the last state; False if the disk did not take it in time."""
        if self._store is None:
            return True
        self._put(time.monotonic_ns())
        return self._store.close(deadline_s)

    def _wake(self, now_ns: int, slept_ns: int) -> None:
        estimate = self._pipeline.estimator.estimate(in_place=True)
        if estimate is None:
            return
        then, now = Moment(0, 0, THIS_RUN), Moment(0, slept_ns, THIS_RUN)
        saved = Saved(estimate, then, self._pipeline.basis, self._config.robot.name)
        # `state.pose: origin` is for robots that are always switched on at one place; this one was not switched off.
        config = replace(self._config, state=replace(self._config.state, pose="continue"))
        restart = warm_restart(saved, now, config, self._pipeline, clock_chip=False)
        self._pipeline.resume(now_ns, restart.estimate, restart.bias_known)
        self._due_ns = now_ns
        log.warning("the machine was suspended: %s", restart.text)

    def _put(self, now_ns: int) -> None:
        assert self._store is not None
        estimate = self._pipeline.estimator.estimate()
        if estimate is None:
            return
        self._due_ns = now_ns + round(self._config.state.period_s * NS_PER_S)
        self._said_at_rest = estimate.at_rest
        moment = moment_now(self._boot_id)
        self._store.put(Saved(estimate, moment, self._pipeline.basis, self._config.robot.name))

    @property
    def is_told(self) -> bool:
        """Whether there was a state at the start, usable or not."""
        return self._start["kind"] == "warm" or (self._store is not None and self._store.counters["refused"] > 0)

    @property
    def trouble(self) -> str | None:
        """Why the state may not survive; None: all is well."""
        return self._store.trouble if self._store is not None else None

    def health(self) -> dict[str, Any] | None:
        """How the daemon started, and the state of saving; None where no state is kept."""
        if self._store is None:
            return None
        return {"start": self._start | {"text": self.start_text}, **self._store.health()}


def asleep_ns() -> int:
    """Total suspended time of this boot, ns: CLOCK_BOOTTIME includes it, CLOCK_MONOTONIC does not."""
    return time.clock_gettime_ns(time.CLOCK_BOOTTIME) - time.clock_gettime_ns(time.CLOCK_MONOTONIC)
