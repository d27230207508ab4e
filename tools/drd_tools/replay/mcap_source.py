"""Replay of the daemon's recording: the same calls of the same pipeline, in the same order."""

import binascii
import math
import tempfile
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Any, Final

import msgspec
from tqdm import tqdm

from drd.batch.run import no_garbage
from drd.config.keys import Config
from drd.config.schema import ConfigError
from drd.estimation.applied import Constant
from drd.estimation.calibration import Calibration
from drd.estimation.estimate import estimate_of
from drd.estimation.track import MakeTrack, make_track
from drd.pipeline import LARGEST_COMMANDED, Pipeline
from drd.recording.in_force import IN_FORCE
from drd.recording.topics import POSE, RAW_CAN, RAW_EVENTS, RAW_FOG
from drd.samples import CanFrame, Pose, Reason, Validity
from drd.wiring.table import sentences
from drd_tools.recordings.configuration import attached_configuration, config_in_force
from drd_tools.recordings.folder import file_hash
from drd_tools.recordings.mcap_file import McapFile, Recorded, nanoseconds, open_run
from drd_tools.replay import findings
from drd_tools.replay.result import Replayed, packed

NUMBERS: Final = 1 << 32
SET_POSE: Final = ("x_m", "y_m", "heading_rad", "sigma_m", "sigma_rad")


def replay_mcap(
    file: Path,
    *,
    config: Path | None = None,
    calibration: Path | None = None,
    model: Path | None = None,
    new_track: MakeTrack = make_track,
    monitors: bool = False,
) -> Replayed:
    """Replay a recording of `drd run`, with the earlier parts of its run in the same folder.

    Configuration, calibration and model are those of the recording, unless overridden by the given files. The notes
    say what is missing and, if nothing was overridden, whether the poses equal those of the live run, bit for bit.
    `monitors`: add the monitor's findings to them. Raises ConfigError.
    """
    run = open_run(file)
    parts, missing, zero_ns = run.parts, run.missing, run.started_ns
    changed = any(given is not None for given in (config, calibration, model))
    replay, kept = _Replay(changed), findings.Kept()
    with tempfile.TemporaryDirectory() as folder:
        in_force, base = config_in_force(parts[-1], Path(folder), config, calibration, model)
        name = file.stem if model is not None else None
        pipeline = Pipeline(in_force, base, replay.on_pose, [kept], name, new_track)
    with no_garbage():
        replay.run(pipeline, parts)
    counters = pipeline.counters()
    wiring = sentences(kept.judge(pipeline, in_force.robot)) if replay.poses else []
    live = None if changed or missing else replay.findings
    told = _monitored(kept, in_force, pipeline.calibration, live, zero_ns) if monitors else []
    return Replayed(
        file,
        replay.poses,
        in_force,
        pipeline.calibration,
        zero_ns=zero_ns,
        set_ns=replay.set_ns,
        samples={"gyro": counters["fog"].get("samples", 0), "wheels": counters["encoders"]["samples"]},
        counters=counters,
        inputs={part.path.name: file_hash(part.path) for part in parts} | _inputs(config, calibration, model),
        notes=[
            *_missing(parts, missing, replay.lost),
            *replay.notes,
            *([] if changed or missing else [replay.comparison()]),
            *pipeline.model_notes,
            *wiring,
            *told,
        ],
    )


def _monitored(
    kept: findings.Kept, config: Config, calibration: Calibration | None, live: findings.Live | None, zero_ns: int
) -> list[str]:
    """Sentences on the monitor's findings, and on whether the live run had the same."""
    is_watched = config.fog.protocol != "none" and config.model.file is None
    if not is_watched or not (kept.gyro_samples and kept.wheel_samples):
        return [findings.NOT_WATCHED]
    told = findings.monitored(kept.gyro_samples, kept.wheel_samples, config, calibration, live, kept.fixes)
    same = told.comparison(live) if live is not None else ""
    return [*findings.sentences(told, zero_ns), *([same] if same else [])]


class _Replay:
    """Poses of a replay and those of the live run. `changed`: not with the recorded configuration."""

    def __init__(self, changed: bool) -> None:
        self._changed = changed
        self.notes: list[str] = []
        self.poses: list[Pose] = []
        self.live: list[Pose] = []
        self.findings = findings.Live()
        self.lost = 0
        self.set_ns: list[int] = []
        self._is_set = False

    def on_pose(self, pose: Pose, _: int) -> None:
        self.poses.append(pose)
        if self._is_set:
            self.set_ns.append(pose.t_ns)
        self._is_set = False

    def run(self, pipeline: Pipeline, parts: Sequence[McapFile]) -> None:
        """Repeat the live run's calls."""
        for recorded in self._in_order(parts):
            try:
                made = call(pipeline, recorded) if recorded.topic in (RAW_FOG, RAW_CAN, RAW_EVENTS) else None
                if self._changed and recorded.topic == RAW_EVENTS:
                    made = self._as_changed(recorded.value()["event"], made)
                if recorded.topic == POSE:
                    self.live.append(recorded_pose(recorded.value()))
                elif recorded.topic == findings.TOPIC:
                    self.findings.take(recorded.value())
            except (KeyError, OverflowError, TypeError, ValueError) as error:
                where = f"{parts[-1].path}, {recorded.topic}, number {recorded.number}"
                raise ConfigError(where, "", "what drd writes there", repr(error)) from error
            if made is not None:
                made()
                self._is_set |= recorded.topic == RAW_EVENTS and recorded.value()["event"] in findings.FIXES

    def _as_changed(self, event: str, made: Callable[[], object] | None) -> Callable[[], object] | None:
        """Adapt an event whose meaning changes with the configuration."""
        if event == "reload":
            self.notes.append("the live run was given a new configuration on the way; here one holds throughout")
            return None
        if event == "apply":
            self.notes.append("constants that the live run took from its monitor are left out: they were its own's")
            return None
        if event == "resume":
            self.notes.append(
                "the run began with a warm restart: with what was learned with the recorded configuration"
            )
        return made

    def _in_order(self, parts: Sequence[McapFile]) -> Iterator[Recorded]:
        """All messages; count gaps in their numbers."""
        number = None
        recordeds = chain.from_iterable(part.messages() for part in parts)
        for recorded in tqdm(recordeds, "replay", unit=" messages", disable=None, leave=False):
            if number is not None:
                self.lost += max(0, (recorded.number - number) % NUMBERS - 1)
            number = recorded.number
            yield recorded

    def comparison(self) -> str:
        """Sentence on whether replay and live run agree. A cut file may lack the last pose that was published."""
        live, poses = self.live, self.poses
        for i, (a, b) in enumerate(zip(live, poses, strict=False)):
            if bits(a) != bits(b):
                return f"the replay differs from the live run from pose {i + 1} of {len(live)} on"
        if not 0 <= len(poses) - len(live) <= 1:
            return f"the replay has {len(poses)} poses, the live run recorded {len(live)}"
        return f"the {len(live)} poses of the live run are repeated to the bit"


def call(pipeline: Pipeline, recorded: Recorded) -> Callable[[], object] | None:
    """Call of the pipeline that a message of a raw topic represents; None for an unknown one.

    Raises KeyError, OverflowError, TypeError or ValueError for a payload that drd did not write.
    """
    value = recorded.value()
    if recorded.topic == RAW_FOG:
        data = binascii.a2b_base64(value["data"], strict_mode=True)
        return partial(pipeline.on_fog_bytes, data, nanoseconds(value["monotonic_ns"]))
    if recorded.topic == RAW_CAN:
        return partial(pipeline.on_frames, [_frame(row) for row in value["frames"]])
    return _event(pipeline, value)


def _event(pipeline: Pipeline, value: dict[str, Any]) -> Callable[[], object] | None:
    name, now_ns = str(value["event"]), nanoseconds(value["monotonic_ns"])
    if name == "port_state":
        text = value["text"]
        return partial(pipeline.port_state, str(value["source"]), None if text is None else str(text), now_ns)
    if name == "set_pose":
        return partial(pipeline.set_pose, now_ns, **{name: _commanded(value[name]) for name in SET_POSE})
    if name == "apply":
        constant = value["constant"]
        taken = None if constant is None else msgspec.convert(constant, Constant)
        return partial(pipeline.apply, now_ns, str(value["what"]), taken)
    if name == "resume":
        return partial(pipeline.resume, now_ns, estimate_of(value["estimate"]), bool(value["bias_known"]))
    if name == "reload":
        files = dict(value["files"])
        if IN_FORCE not in files:
            raise KeyError(IN_FORCE)
        return partial(_reload, pipeline, now_ns, {str(k): str(v) for k, v in files.items()})
    calls = {"tick": pipeline.tick, "reset": pipeline.reset, "calibrate_bias": pipeline.calibrate_bias}
    return partial(calls[name], now_ns) if name in calls else None


def _reload(pipeline: Pipeline, now_ns: int, files: dict[str, str]) -> None:
    with tempfile.TemporaryDirectory() as folder:
        attached = {name: text.encode() for name, text in files.items()}
        config = attached_configuration(attached, Path(folder), f"reload, {IN_FORCE}")
        fresh = Pipeline(config, Path(folder), lambda *_: None)
    pipeline.reload(now_ns, fresh, files)


def _frame(row: dict[str, Any]) -> CanFrame:
    can_id, data = int(row["can_id"]), binascii.a2b_base64(row["data"], strict_mode=True)
    return CanFrame(nanoseconds(row["monotonic_ns"]), can_id, bool(row["extended"]), data)


def _commanded(value: Any) -> float:
    """Check a number as the daemon does, which rejects larger ones."""
    if not abs(value) <= LARGEST_COMMANDED:
        raise ValueError(f"expected at most {LARGEST_COMMANDED:g}, got {value!r:.40}")
    return float(value)


def recorded_pose(value: dict[str, Any]) -> Pose:
    """Decode the pose in a message of POSE, bit for bit."""
    (xx, xy, xh), (_, yy, yh), (_, _, hh) = value["covariance_m_rad"]
    names = ("x_m", "y_m", "heading_rad", "speed_m_s", "rate_rad_s", "speed_sigma_m_s", "rate_sigma_rad_s")
    return Pose(
        t_ns=nanoseconds(value["monotonic_ns"]),
        sequence=value["sequence"],
        **{name: _number(value[name]) for name in names},
        covariance=(_number(xx), _number(xy), _number(xh), _number(yy), _number(yh), _number(hh)),
        position_bound_m=_number(value["position_bound_99_m"]),
        validity=Validity(value["validity"]),
        reasons=tuple(Reason(r["source"], r["text"], r["since_ns"]) for r in value["reasons"]),
    )


def _number(value: float | None) -> float:
    return math.nan if value is None else value


def bits(pose: Pose) -> tuple[bytes, Validity, tuple[Reason, ...]]:
    """Key of a pose, equal for two poses only if they agree in every bit."""
    return packed(pose), pose.validity, pose.reasons


def _missing(parts: Sequence[McapFile], missing: Sequence[int], lost: int) -> list[str]:
    """Sentences on data missing from the replay."""
    notes = [f"{part.path.name}: {part.sentence()}" for part in parts if part.is_cut]
    if missing:
        what = f"part {missing[0]}" if len(missing) == 1 else f"{len(missing)} parts, {missing[0]} to {missing[-1]},"
        notes.append(f"{what} of the run is not there: the replay is not the live run, it begins from nothing")
    if lost:
        notes.append(f"{lost} entries are missing: what was lost or cut is not replayed")
    return notes


def _inputs(*files: Path | None) -> dict[str, str]:
    return {str(file): file_hash(file) for file in files if file is not None}
