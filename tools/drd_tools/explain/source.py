"""Recording to explain, replayed by the daemon's own classes, whatever its format."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from drd.batch.samples import zero_of
from drd_tools.explain.interval import Interval
from drd_tools.explain.tap import tapped_track
from drd_tools.limit.limit import Limit, limit_of
from drd_tools.recordings.daemon_log import read_daemon_log
from drd_tools.recordings.folder import read_recording
from drd_tools.recordings.mcap_file import open_mcap
from drd_tools.replay.folder_source import replay_folder
from drd_tools.replay.mcap_source import replay_mcap
from drd_tools.replay.nominal import in_force, with_model
from drd_tools.replay.result import Replayed


@dataclass(frozen=True)
class Source:
    """A recording: its time 0 on the filter's clock, its wheels' first and last time (infinite: not known yet).

    `replay` computes the poses, `limit` the smallest error that any estimator could achieve.
    """

    path: Path
    zero_ns: int
    first_s: float
    last_s: float
    has_reference: bool
    replay: Callable[..., Replayed]
    limit: Callable[[], Limit]

    def run(self, interval: Interval) -> Replayed:
        """Replay, with `interval` observing each step of the filter. Raises ConfigError."""
        replayed = self.replay(new_track=partial(tapped_track, interval))
        assert replayed.zero_ns == self.zero_ns
        if interval.clock is not None:
            interval.finish(interval.clock.kf)
        return replayed


def open_source(path: Path, config: Path | None, calibration: Path | None, model: Path | None) -> Source:
    """Open a recording, with files as `drd replay` takes them. Raises ConfigError."""
    if path.suffix == ".mcap" and not path.is_dir():
        began = open_mcap(path).information.get("started_monotonic_ns", "")
        zero_ns = int(began) if began.isdecimal() else 0
        replay = partial(replay_mcap, path, config=config, calibration=calibration, model=model)
        return Source(path, zero_ns, -math.inf, math.inf, False, replay, lambda: limit_of(read_daemon_log(path)))
    recording = read_recording(path)
    if model is not None:
        recording = with_model(recording, model)
    zero_ns = zero_of(recording.fog, recording.encoders)
    reference = recording.reference
    return Source(
        path,
        zero_ns,
        float(recording.encoders.time_s[0]),
        float(recording.encoders.time_s[-1]),
        reference is not None and len(reference.time_s) > 1,
        partial(replay_folder, recording, config, calibration),
        lambda: limit_of(recording, in_force(recording, config, None)[0]),
    )
