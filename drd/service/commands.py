"""Check commands from outside and pass them to the pipeline."""

import math
import time
from collections.abc import Mapping
from typing import Any

from drd.output.messages import Refused
from drd.output.queries import Handler
from drd.pipeline import LARGEST_COMMANDED, Pipeline


class Commands:
    """Handlers, by name, of the queries that change the state; each raises Refused."""

    def __init__(self, pipeline: Pipeline):
        self._pipeline = pipeline
        self.handlers: Mapping[str, Handler] = {
            "set_pose": self._set_pose,
            "reset": self._reset,
            "calibrate_bias": self._calibrate_bias,
        }

    def _set_pose(self, request: dict[str, Any]) -> dict[str, Any]:
        known = {"x_m": None, "y_m": None, "heading_rad": None, "sigma_m": 0.0, "sigma_rad": 0.0}
        unknown = sorted(set(request) - set(known))
        if unknown:
            raise Refused(f"{unknown[0]}: expected one of {', '.join(known)}, got an unknown key")
        values = {}
        for name, default in known.items():
            value = request.get(name, default)
            if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
                raise Refused(f"{name}: expected a finite number, got {value!r}")
            if name.startswith("sigma") and value < 0:
                raise Refused(f"{name}: expected a number of at least 0, got {value!r}")
            if abs(value) > LARGEST_COMMANDED:
                raise Refused(f"{name}: expected at most {LARGEST_COMMANDED:g}, got {value!r}")
            values[name] = float(value)
        self._pipeline.set_pose(time.monotonic_ns(), **values)
        return values

    def _reset(self, _: dict[str, Any]) -> dict[str, Any]:
        self._pipeline.reset(time.monotonic_ns())
        return {"reset": True}

    def _calibrate_bias(self, _: dict[str, Any]) -> dict[str, Any]:
        if (refusal := self._pipeline.calibrate_bias(time.monotonic_ns())) is not None:
            raise Refused(refusal)
        return {"measuring_s": self._pipeline.estimator.bias.duration_s}
