"""Constants that the monitor is sure of, adopted by the estimator and restored again, if `monitor.apply` is true."""

import logging
import time
from collections.abc import Callable, Mapping
from typing import Any

import msgspec

from drd.estimation.applied import Constant
from drd.pipeline import Pipeline

log = logging.getLogger(__name__)


class Taking:
    """Keeps the estimator's constants as the monitor determines them, while it is on. Each change is logged."""

    def __init__(self, pipeline: Pipeline, clock_ns: Callable[[], int] = time.monotonic_ns):
        self._pipeline, self._clock_ns = pipeline, clock_ns
        self._is_on = False
        self._refused: set[str] = set()

    def put_in_force(self, is_on: bool) -> None:
        """Switch on or off; off restores all previous values."""
        self._is_on = is_on
        if not is_on:
            for name in list(self._pipeline.estimator.knowledge.applied.taken):
                self._change(name, None, "monitor.apply is off")

    def want(self, wanted: Mapping[str, Constant | None]) -> None:
        """Adopt constants by name; None: restore the previous value; absent: the monitor makes no statement on it."""
        if not self._is_on:
            return
        for name, constant in wanted.items():
            if self._pipeline.estimator.knowledge.applied.taken.get(name) != constant:
                self._change(name, constant, "the monitor no longer finds it")

    def _change(self, name: str, constant: Constant | None, why: str) -> None:
        refusal = self._pipeline.apply(self._clock_ns(), name, constant)
        if refusal is not None:
            if refusal not in self._refused:
                self._refused.add(refusal)
                log.warning("monitor: not adopted: %s", refusal)
        elif constant is None:
            log.info("monitor: previous %s restored: %s", name, why)
        else:
            before = self._pipeline.estimator.knowledge.applied.before[name].value
            log.info("monitor: %s adopted: %.5g, sigma %.2g; was %.5g", name, constant.value, constant.sigma, before)

    def health(self) -> dict[str, Any] | None:
        """Adopted constants and the values that they replaced, by name; None where it is off."""
        if not self._is_on:
            return None
        applied = self._pipeline.estimator.knowledge.applied
        return {
            name: {**msgspec.to_builtins(taken), "before": applied.before[name].value}
            for name, taken in applied.taken.items()
        }
