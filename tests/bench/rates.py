"""How many times faster than life the pipeline runs, from bytes and frames to poses, without ports and network."""

from functools import partial
from pathlib import Path
from statistics import median

from bench.report import Figure, Refused, Report
from bench.robot import Circle, config_text, replay
from bench.timing import seconds
from drd.config.keys import Config
from drd.config.schema import loads
from drd.pipeline import Pipeline
from drd.samples import Pose


def run(quick: bool) -> Report:
    """Replay a drive several times."""
    driven_s, repeats = (5.0, 2) if quick else (300.0, 5)
    config = loads(config_text(Path("/nowhere"), "tcp/127.0.0.1:0"), Config).value
    arrivals = Circle(config).arrivals(driven_s)
    taken_s = []
    for _ in range(repeats):
        poses: list[Pose] = []
        pipeline = Pipeline(config, Path(), partial(_keep, poses))
        taken_s.append(seconds(partial(replay, pipeline, arrivals)))
        counters = pipeline.counters()
        samples = counters["fog"]["samples"] + counters["encoders"]["samples"]
        if counters["estimator"]["rejected"] or len(poses) < 0.9 * counters["encoders"]["samples"]:
            raise Refused(f"rates: the estimator did not run as it should: {counters['estimator']}")
    taken = median(taken_s)
    return Report(
        "rates: gyro at 10 Hz and encoders at 20 Hz, replayed",
        "times real time: how many such robots one core could estimate for",
        (
            Figure("speed", driven_s / taken, "x life"),
            Figure("samples", samples / taken, "1/s"),
            Figure("poses", len(poses) / taken, "1/s"),
        ),
    )


def _keep(poses: list[Pose], pose: Pose, _: int) -> None:
    poses.append(pose)
