"""Drive as blocks of time along which the bound is computed, with the noise learned in its replay."""

from dataclasses import dataclass
from typing import Any, Final, NamedTuple

from drd.batch.run import filter_logs
from drd.batch.samples import resolution_m
from drd.config.keys import Config
from drd.config.schema import ConfigError
from drd.estimation.filter import Filter
from drd.estimation.noise import NoiseProfile
from drd.estimation.state import Sigmas
from drd.estimation.track import Track, make_track
from drd_tools.recordings.folder import Recording

# Linear steps of this length are accurate enough: a turn of 0.1 rad shortens a chord by 0.04 %; at rest only the bias
# moves.
MOVING_S: Final = 0.25
STANDING_S: Final = 1.0
TURN_RAD: Final = 0.1


class Block(NamedTuple):
    """Motion in one interval of time. Travel is corrected for the learned scale errors."""

    dt_s: float
    left_m: float
    right_m: float
    turn_rad: float

    @property
    def is_rest(self) -> bool:
        """Whether both wheels are at rest, so that the wheels' heading has no noise."""
        return self.left_m == 0.0 and self.right_m == 0.0


@dataclass(frozen=True)
class Drive:
    """Blocks in order of time. `gyro_hz` is 0 without a gyro; `noise`: as learned during the drive."""

    blocks: list[Block]
    tread_m: float
    gyro_hz: float
    noise: NoiseProfile
    resolution_m: float

    @property
    def distance_m(self) -> float:
        """Length of the path."""
        return sum(0.5 * abs(b.left_m + b.right_m) for b in self.blocks)


class _Watched(Filter):
    """Filter that records the input of each step, and its change of the pose's heading."""

    def __init__(self, *args: Any):
        self.steps: list[Block] = []
        super().__init__(*args)

    def predict(self, dt_s: float, left_m: float, right_m: float, *args: Any, **kwargs: Any) -> None:
        """Predict, and record the step."""
        before_rad = self.heading_rad
        super().predict(dt_s, left_m, right_m, *args, **kwargs)
        self.steps.append(Block(dt_s, left_m, right_m, self.heading_rad - before_rad))


def replayed_drive(recording: Recording, config: Config) -> Drive:
    """Replay a drive with the daemon's own estimator. Raises ConfigError if nothing can be replayed."""
    watched: list[_Watched] = []

    def new_track(config: Config, sigmas: Sigmas, noise: NoiseProfile) -> Track:
        def watch(*args: Any) -> _Watched:
            watched.append(_Watched(*args))
            return watched[-1]

        return make_track(config, sigmas, noise, watch)

    made, kf = filter_logs(recording.fog, recording.encoders, config, new_track=new_track), watched[0]
    if not kf.steps:
        raise ConfigError(str(recording.folder), "", "a recording that gives poses", "none")
    n = kf.nominal
    right, left = 1.0 - n.scale_right, 1.0 - n.scale_left
    steps = [Block(s.dt_s, left * s.left_m, right * s.right_m, s.turn_rad) for s in kf.steps]
    gyro_hz = config.fog.rate_hz if made.samples["gyro"] else 0.0
    count_m = resolution_m(recording.encoders, config) if recording.encoders.left_counts is not None else 0.0
    return Drive(blocks_of(steps), n.tread_m, gyro_hz, kf.noise, count_m)


def blocks_of(steps: list[Block]) -> list[Block]:
    """Sum steps to blocks, none of which contains both rest and motion. At rest there is no turn."""
    blocks: list[Block] = []
    for step in steps:
        s = step._replace(turn_rad=0.0) if step.is_rest else step
        last = blocks[-1] if blocks else None
        longest_s = STANDING_S if s.is_rest else MOVING_S
        if (
            last is None
            or last.is_rest != s.is_rest
            or last.dt_s + s.dt_s > longest_s
            or abs(last.turn_rad + s.turn_rad) > TURN_RAD
        ):
            blocks.append(s)
        else:
            blocks[-1] = Block(*(a + b for a, b in zip(last, s, strict=True)))
    return blocks
