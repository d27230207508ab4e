"""Real-time dead reckoning for wheeled robots: gyro and wheel encoders in, pose with its uncertainty out.

`run_filter` estimates from arrays, `Estimator` from samples as they arrive; both need only numpy, PyYAML and msgspec.
"""

import importlib
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from drd.batch.poses import Poses, run_filter
    from drd.config.robot import Robot
    from drd.config.schema import ConfigError
    from drd.estimation.estimator import Estimator
    from drd.samples import GyroSample, Pose, WheelSample

__version__ = "0.1.0"
__all__ = ["ConfigError", "Estimator", "GyroSample", "Pose", "Poses", "Robot", "WheelSample", "run_filter"]

# Imported on first use, so that no command waits for modules that it does not need.
HOMES: Final = {
    "ConfigError": "drd.config.schema",
    "Estimator": "drd.estimation.estimator",
    "GyroSample": "drd.samples",
    "Pose": "drd.samples",
    "Poses": "drd.batch.poses",
    "Robot": "drd.config.robot",
    "WheelSample": "drd.samples",
    "run_filter": "drd.batch.poses",
}


if not TYPE_CHECKING:

    def __getattr__(name: str) -> object:
        if name not in HOMES:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        return getattr(importlib.import_module(HOMES[name]), name)

    def __dir__() -> list[str]:
        return sorted({*globals(), *__all__})
