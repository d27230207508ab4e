"""Replay of the neutral recording folder: its rows become the samples that the daemon would have made."""

from functools import partial
from pathlib import Path
from typing import Final

from tqdm import tqdm

from drd.batch.run import filter_logs
from drd.batch.samples import check_times, gyro_samples, wheel_samples, zero_of
from drd.config.keys import Config
from drd.estimation.track import MakeTrack, make_track
from drd.units import NS_PER_S
from drd_tools.recordings.folder import Recording, file_hash
from drd_tools.replay import findings
from drd_tools.replay.nominal import in_force, with_configured_model
from drd_tools.replay.result import Replayed

PROGRESS: Final = partial(tqdm, desc="replay", unit=" samples", disable=None, leave=False, delay=1.0)


def replay_folder(
    recording: Recording,
    config: Path | None = None,
    calibration: Path | None = None,
    new_track: MakeTrack = make_track,
    *,
    monitors: bool = False,
) -> Replayed:
    """Estimate from a recording folder that was read. Raises ConfigError.

    The configuration is that of robot.yaml, see `nominal`, overridden by the two files. `new_track`: see
    Estimator. `monitors`: add the monitor's findings to the notes.
    """
    in_use, gyro_calibration = in_force(recording, config, calibration)
    recording = with_configured_model(recording, in_use)
    fog, encoders, folder = recording.fog, recording.encoders, recording.folder
    check_times(fog, encoders, (str(folder / "fog.csv"), str(folder / "encoders.csv")))
    late_ns = _latencies_ns(recording, in_use)
    told = [findings.NOT_WATCHED] if monitors else []
    if monitors and fog is not None and in_use.fog.protocol != "none" and not recording.terms:
        zero_ns = zero_of(fog, encoders)
        samples = gyro_samples(fog, in_use, zero_ns)[0], wheel_samples(encoders, in_use, zero_ns)[0]
        told = findings.sentences(findings.monitored(*samples, in_use, gyro_calibration), zero_ns)
    terms, zero_s = recording.terms, recording.zero_s
    made = filter_logs(fog, encoders, in_use, gyro_calibration, terms, late_ns, new_track, PROGRESS, zero_s)
    return Replayed(
        folder,
        made.poses,
        in_use,
        gyro_calibration,
        made.zero_ns,
        made.began_ns,
        made.samples,
        made.counters,
        recording.sha256 | ({str(recording.model): file_hash(recording.model)} if recording.model else {}),
        [*recording.notes, *made.notes, *told],
    )


def _latencies_ns(recording: Recording, config: Config) -> tuple[int, int]:
    """Latency of the rows, of the gyro and of the wheels.

    Samples that the daemon recorded are already corrected for the latencies then in force, so only the difference
    remains.
    """
    before = recording.config
    known_s = (0.0, 0.0) if before is None else (before.fog.latency_s, before.encoders.latency_s)
    late_s = (config.fog.latency_s - known_s[0], config.encoders.latency_s - known_s[1])
    return round(late_s[0] * NS_PER_S), round(late_s[1] * NS_PER_S)
