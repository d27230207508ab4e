"""Memory that stays: blocks that live on after a filter step, and after an estimator cycle."""

import gc
import tracemalloc
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Final, NamedTuple

import drd
from bench.report import Figure, Report
from bench.robot import Circle, config_text, replay
from drd.config.keys import Config, Noise
from drd.config.schema import loads
from drd.estimation.filter import Filter
from drd.estimation.noise import make_noise
from drd.estimation.state import Sigmas
from drd.pipeline import Pipeline
from drd.samples import Pose

FILTER_STEPS: Final = 10_000
CYCLE_S: Final = 0.1  # one gyro sample, two wheel samples


class Growth(NamedTuple):
    """What was allocated by code of the package drd and lives on."""

    blocks: int
    size_bytes: int


def run(quick: bool) -> Report:
    """Measure both."""
    cycles = 200 if quick else 10_000
    step, cycle = filter_growth(FILTER_STEPS), pipeline_growth(cycles)
    return Report(
        f"allocation: what lives on after {FILTER_STEPS} filter steps and {cycles} estimator cycles",
        "0 a step: the filter works in the memory that it was made with; a cycle's must not grow with their number",
        (
            Figure("filter, blocks", step.blocks / FILTER_STEPS, "per step"),
            Figure("filter, bytes", step.size_bytes / FILTER_STEPS, "per step"),
            Figure("pipeline, blocks", cycle.blocks / cycles, "per cycle"),
            Figure("pipeline, bytes", cycle.size_bytes / cycles, "per cycle"),
        ),
    )


def filter_growth(steps: int) -> Growth:
    """Of `steps` steps, each a prediction and an update."""

    def begin() -> Callable[[], None]:
        sigmas = Sigmas(0.0, 0.0, 0.005, 0.01, 0.005, 3e-4)
        kf = Filter(0.6, sigmas, make_noise("physical", Noise(), 0.6))

        def work(count: int) -> None:
            for _ in range(count):
                kf.predict(0.05, 0.02, 0.03, 0.333)
                kf.update(0.333)

        work(1_000)
        return partial(work, steps)

    return _growth(begin)


def pipeline_growth(cycles: int, on_pose: Callable[[Pose, int], None] = lambda *_: None) -> Growth:
    """Of `cycles` cycles from bytes and frames to the pose, after as many that fill the bounded buffers."""

    def begin() -> Callable[[], None]:
        config = loads(config_text(Path("/nowhere"), "tcp/127.0.0.1:0"), Config).value
        pipeline = Pipeline(config, Path(), on_pose)
        arrivals = Circle(config).arrivals(2 * cycles * CYCLE_S)
        half = len(arrivals) // 2
        replay(pipeline, arrivals[:half])
        return partial(replay, pipeline, arrivals[half:])

    return _growth(begin)


def _growth(begin: Callable[[], Callable[[], None]]) -> Growth:
    """`begin` makes everything, warms it up and returns the work that is measured."""
    gc.collect()  # empties the free lists, too: a block of theirs would be used again without being seen
    tracemalloc.start()
    try:
        work = begin()
        before = _living()
        work()
        after = _living()
    finally:
        tracemalloc.stop()
    return Growth(after.blocks - before.blocks, after.size_bytes - before.size_bytes)


def _living() -> Growth:
    gc.collect()
    package = tracemalloc.Filter(True, str(Path(drd.__file__).parent / "*"))
    traces = tracemalloc.take_snapshot().filter_traces([package]).traces
    return Growth(len(traces), sum(trace.size for trace in traces))
