"""Bytes and frames in, poses out: the daemon without its ports, publishers and clock. Replay runs this same object."""

import logging
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec

from drd.config.keys import Config, Encoders, Fog
from drd.effects.compensation import Compensation
from drd.effects.model import Model, check_geometry, load_model
from drd.encoders.stream import EncoderStream
from drd.estimation.applied import Constant
from drd.estimation.basis import basis_of, changes, learned_anew
from drd.estimation.calibration import Calibration, load_calibration
from drd.estimation.estimate import Estimate
from drd.estimation.estimator import Estimator
from drd.estimation.health import Reasons
from drd.estimation.learned_values import learned_values, steering_text
from drd.estimation.track import MakeTrack, make_track
from drd.fog.stream import FogStream
from drd.samples import CanFrame, GyroSample, Pose, Side, WheelSample
from drd.units import NS_PER_S, RAD_PER_DEG, S_PER_NS

log = logging.getLogger(__name__)

# Metres or radians of a pose from outside; beyond, doubles no longer resolve a step of the robot.
LARGEST_COMMANDED = 1e7
# Each side, the other side, and source and text of the reason set by its silence.
SILENT_SIDES = (
    (Side.LEFT, Side.RIGHT, "encoders.left", "the left counter is silent"),
    (Side.RIGHT, Side.LEFT, "encoders.right", "the right counter is silent"),
)


class Observer:
    """Receives each input and decoded sample before the estimator does: the recorder, the wiring check.

    The methods do nothing here: a subclass overrides those that it needs.
    """

    def fog_bytes(self, data: bytes, arrival_ns: int) -> None:
        """Bytes from the gyro's serial line."""

    def frames(self, frames: Sequence[CanFrame]) -> None:
        """Frames from the bus."""

    def gyro(self, sample: GyroSample) -> None:
        """A gyro sample."""

    def wheels(self, sample: WheelSample) -> None:
        """A sample of both wheels."""

    def event(self, name: str, now_ns: int, **values: Any) -> None:
        """Any other call that can change the estimate."""


def _fog_decoding(config: Config) -> tuple[Fog, float]:
    """The keys that the gyro's decoding depends on; those of the port are blanked."""
    fog = replace(config.fog, port="", baud=0, low_latency=False, silent_after_s=0.0)
    return fog, config.robot.max_acceleration_deg_s2


def _encoder_decoding(config: Config) -> tuple[Encoders, tuple[float, ...]]:
    """The keys that the encoders' decoding depends on; those of the port and the name of a file are blanked."""
    e, r = config.encoders, config.robot
    e = replace(e, interface="", channel="", bitrate=None, open_delay_s=0.0, queue_frames=0, silent_after_s=0.0)
    e = replace(e, dbc=replace(e.dbc, file=None))
    return e, (r.wheel_radius_m, r.left_scale, r.right_scale, r.max_speed_m_s)


class Pipeline:
    """Takes inputs with their CLOCK_MONOTONIC arrival times, and calls `on_pose(pose, input_ns)`.

    `input_ns`: arrival time of the input that brought the pose. `base`: folder that relative paths in the
    configuration start from. Each of `observers` receives, in order, every call that can change the estimate and the
    decoded samples: a replay makes the same calls. `recording`: the run's name in the model's provenance, if known.
    `new_track`: see Estimator. Raises ConfigError if a file named in the configuration cannot be used.
    """

    def __init__(
        self,
        config: Config,
        base: Path,
        on_pose: Callable[[Pose, int], None],
        observers: Sequence[Observer] = (),
        recording: str | None = None,
        new_track: MakeTrack = make_track,
    ):
        self._new_track = new_track
        self._config, self._on_pose, self._observers = config, on_pose, observers
        file = config.calibration.file
        self.calibration: Calibration | None = load_calibration(base / file) if file else None
        has_gyro = config.fog.protocol != "none"
        self.model: Model | None = load_model(base / config.model.file) if config.model.file else None
        self.model_notes: list[str] = []
        self._compensation = self._make_compensation(recording) if self.model else None
        self.fog = FogStream(config.fog, config.robot.max_acceleration_deg_s2 * RAD_PER_DEG) if has_gyro else None
        self.encoders = EncoderStream(config.encoders, config.robot, base)
        self.estimator = self._make_estimator(config, self.calibration)
        self.reasons = self.estimator.reasons
        estimates_scale, from_file = self.estimator.estimates_gyro_scale, self.encoders.from_file
        self.basis = basis_of(config, self.calibration, self.model, estimates_scale, from_file)
        self._side_silent_ns = round(config.encoders.silent_after_s * NS_PER_S)

    def _make_compensation(self, recording: str | None) -> Compensation | None:
        """Compensation for the model's effects that hold in this run."""
        assert self.model is not None
        check_geometry(self.model, self._config)
        terms, self.model_notes = self.model.holds_in(recording)
        for note in self.model_notes:
            log.warning("%s: %s", self._config.model.file, note)
        return Compensation(terms, self._config.robot, self._config.fog.protocol != "none") if terms else None

    def _make_estimator(
        self, config: Config, calibration: Calibration | None, reasons: Reasons | None = None
    ) -> Estimator:
        resolution_m, compensation = self.encoders.resolution_m, self._compensation
        publish_on = config.output.publish_on
        return Estimator(config, calibration, resolution_m, compensation, reasons, self._new_track, publish_on)

    def resume(self, now_ns: int, estimate: Estimate, bias_known: bool) -> None:
        """Continue from an estimate made before a restart or suspend of the machine. `bias_known`: its bias holds."""
        self._record("resume", now_ns, estimate=estimate.plain(), bias_known=bias_known)
        self.estimator.resume(estimate, bias_known)

    def reload(self, now_ns: int, fresh: "Pipeline", files: Mapping[str, str]) -> list[str]:
        """Continue with the configuration of `fresh`, a pipeline without input so far. Returns what is learned again.

        Pose, covariance and all learned values that still apply are kept, and so is a decoder whose configuration is
        unchanged; a new one waits for its first samples, as after a gap. `files`: the texts of the new files, from
        which a replay makes `fresh`.
        """
        self._record("reload", now_ns, files=dict(files))
        old, new = self._config, fresh._config
        if _fog_decoding(old) != _fog_decoding(new):
            self.fog = fresh.fog
        same_file = self.encoders.from_file == fresh.encoders.from_file
        if not same_file or _encoder_decoding(old) != _encoder_decoding(new):
            self.encoders = fresh.encoders
        other = changes(self.basis, fresh.basis)
        same_model = self.basis.wheels == fresh.basis.wheels and old.fog.protocol == new.fog.protocol
        if not same_model:
            self._compensation = fresh._compensation
        estimator = self._make_estimator(new, fresh.calibration, self.reasons)
        estimator.take_over(self.estimator, not other.wheels, not other.gyro, not other.lag, same_model)
        self._config, self.estimator, self.basis = new, estimator, fresh.basis
        self.calibration, self.model, self.model_notes = fresh.calibration, fresh.model, fresh.model_notes
        self._side_silent_ns = fresh._side_silent_ns
        return learned_anew(other)

    def on_fog_bytes(self, data: bytes, arrival_ns: int) -> None:
        """Bytes from the gyro's serial line."""
        if self.fog is None:
            return
        for observer in self._observers:
            observer.fog_bytes(data, arrival_ns)
        self._notice_stall(arrival_ns)
        for sample in self.fog.feed(data, arrival_ns):
            for observer in self._observers:
                observer.gyro(sample)
            self._emit(self.estimator.add_gyro(sample), arrival_ns)

    def on_frames(self, frames: Sequence[CanFrame]) -> None:
        """Frames from the bus."""
        for observer in self._observers:
            observer.frames(frames)
        if frames:
            self._notice_stall(frames[-1].t_ns)
        for frame in frames:
            for sample in self.encoders.feed(frame):
                for observer in self._observers:
                    observer.wheels(sample)
                self._emit(self.estimator.add_wheels(sample), frame.t_ns)

    def tick(self, now_ns: int) -> None:
        """Let time pass, whether or not anything arrives."""
        self._record("tick", now_ns)
        self._notice_stall(now_ns)
        last, first_ns = self.encoders.last_ns, self.encoders.first_ns or now_ns
        for side, other_side, source, text in SILENT_SIDES:
            mine, other = last[side], last[other_side]
            # After a start or reload one side is heard first. If both are silent, the estimator's own reason says so.
            heard_ns = first_ns if mine is None else mine
            dead = other is not None and now_ns - other < self._side_silent_ns < now_ns - heard_ns
            self.reasons.update(source, text if dead else None, now_ns)
        self._emit(self.estimator.tick(now_ns), now_ns)

    def _notice_stall(self, now_ns: int) -> None:
        """Detect a stall of the host before an input is used: more delayed input may follow."""
        if self.fog is not None and self.estimator.is_stall(now_ns):
            self.fog.stalled()
            self.estimator.stalled()

    def port_state(self, source: str, text: str | None, now_ns: int) -> None:
        """Turn a port's fault (None: it is open) into a reason; either way restart its parser."""
        self._record("port_state", now_ns, source=source, text=text)
        self.reasons.update(source, text, now_ns)
        if source == "fog.port" and self.fog is not None:
            self.fog.restart()
        elif source == "encoders.port":
            self.encoders.restart()

    def set_pose(
        self, now_ns: int, x_m: float, y_m: float, heading_rad: float, sigma_m: float, sigma_rad: float
    ) -> None:
        """Set the pose from outside, with its standard deviations."""
        values = {"x_m": x_m, "y_m": y_m, "heading_rad": heading_rad, "sigma_m": sigma_m, "sigma_rad": sigma_rad}
        self._record("set_pose", now_ns, **values)
        self.estimator.set_pose(**values)

    def apply(self, now_ns: int, name: str, constant: Constant | None) -> str | None:
        """Adopt a constant that the monitor has found or, if None, restore the previous value; returns why not."""
        self._record("apply", now_ns, what=name, constant=None if constant is None else msgspec.to_builtins(constant))
        return self.estimator.apply(name, constant)

    def reset(self, now_ns: int) -> None:
        """Return to the origin."""
        self._record("reset", now_ns)
        self.estimator.reset()

    def calibrate_bias(self, now_ns: int) -> str | None:
        """Measure the gyro's bias again; returns why not."""
        self._record("calibrate_bias", now_ns)
        return self.estimator.calibrate_bias()

    def _record(self, event: str, now_ns: int, **values: Any) -> None:
        for observer in self._observers:
            observer.event(event, now_ns, **values)

    def _emit(self, pose: Pose | None, input_ns: int) -> None:
        if pose is not None:
            self._on_pose(pose, input_ns)

    def counters(self) -> dict[str, dict[str, int]]:
        """All counters, by part."""
        return {
            "fog": dict(self.fog.counters) if self.fog is not None else {},
            "encoders": self.encoders.counters,
            "estimator": dict(self.estimator.counters),
        }

    def health(self, now_ns: int) -> dict[str, Any]:
        """Health of the pipeline: validity, reasons, rates, temperature, and what the filter has learned."""
        return {
            "robot": self._config.robot.name,
            "validity": self.reasons.validity.value,
            "reasons": [
                {
                    "source": r.source,
                    "text": r.text,
                    "since_s": (now_ns - r.since_ns) * S_PER_NS if r.since_ns else None,
                }
                for r in self.reasons.active()
            ],
            "fog_rate_hz": self.fog.rate_hz if self.fog is not None else None,
            "fog_temperature_c": self.fog.temperature_c if self.fog is not None else None,
            "bias_measurement": self.estimator.bias.state.value,
            "drive": steering_text(self.estimator.knowledge.steering.drive),
            "learned": learned_values(self.estimator, self._config),
            "counters": self.counters(),
        }
