"""Constants that the monitor is sure of, into the estimator and out again, as `monitor.apply` asks for."""

import logging
import time
from collections.abc import Callable, Mapping
from typing import Any

import msgspec

from drd.estimation.applied import Constant
from drd.pipeline import Pipeline

log = logging.getLogger(__name__)


class Taking:
    """Keeps the estimator's constants as the monitor wants them, while it is on. Each change is logged."""

    def __init__(self, pipeline: Pipeline, clock_ns: Callable[[], int] = time.monotonic_ns):
        self._pipeline, self._clock_ns = pipeline, clock_ns
        self._is_on = False
        self._refused: set[str] = set()

    def put_in_force(self, is_on: bool) -> None:
        """Switch on or off; off gives back all that was taken."""
        self._is_on = is_on
        if not is_on:
            for name in list(self._pipeline.estimator.knowledge.applied.taken):
                self._change(name, None, "monitor.apply is off")

    def want(self, wanted: Mapping[str, Constant | None]) -> None:
        """Take constants by name; None: give it back; absent: the monitor has nothing to say of it."""
        if not self._is_on:
            return
        for name, constant in wanted.items():
            if self._pipeline.estimator.knowledge.applied.taken.get(name) != constant:
                self._change(name, constant, "the monitor does not find it any more")

    def _change(self, name: str, constant: Constant | None, why: str) -> None:
        refusal = self._pipeline.apply(self._clock_ns(), name, constant)
        if refusal is not None:
            if refusal not in self._refused:
                self._refused.add(refusal)
                log.warning("monitor: not taken: %s", refusal)
        elif constant is None:
            log.info("monitor: %s given back: %s", name, why)
        else:
            before = self._pipeline.estimator.knowledge.applied.before[name].value
            log.info("monitor: %s taken: %.5g, sigma %.2g; before %.5g", name, constant.value, constant.sigma, before)

    def health(self) -> dict[str, Any] | None:
        """Constants that are in force and what was there before, by name; None where it is off."""
        if not self._is_on:
            return None
        applied = self._pipeline.estimator.knowledge.applied
        return {
            name: {**msgspec.to_builtins(taken), "before": applied.before[name].value}
            for name, taken in applied.taken.items()
        }
