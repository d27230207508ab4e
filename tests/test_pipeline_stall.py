"""A host that stands still: what waited in its buffers is used, in whatever parts it comes."""

from pathlib import Path

import pytest
from bench.robot import Circle
from recorded_drive import drive

from drd.pipeline import Pipeline
from drd.samples import CanFrame
from drd.units import NS_PER_MS, NS_PER_S

BEGIN_NS, LENGTH_NS = 8 * NS_PER_S, 900 * NS_PER_MS


@pytest.mark.parametrize("first_packets", [1, 4])
def test_a_stall_of_the_host_costs_no_gyro_sample(tmp_path: Path, first_packets: int) -> None:
    """Ticks and reading pause. Afterwards part of the gyro's bytes is read, then the wheels' frames, then the rest."""
    config = drive(tmp_path, calibration=False).loaded.value
    pipeline = Pipeline(config, tmp_path, lambda *_: None)
    packet, waiting, frames = 0, b"", list[CanFrame]()
    tick_ns = start_ns = -1
    for t_ns, data in Circle(config).arrivals(12.0):
        start_ns = t_ns if start_ns < 0 else start_ns
        since_ns = t_ns - start_ns - BEGIN_NS
        if 0 <= since_ns < LENGTH_NS:
            if isinstance(data, bytes):
                packet, waiting = len(data), waiting + data
            else:
                frames.extend(data)
            continue
        if since_ns >= LENGTH_NS and waiting:
            pipeline.on_fog_bytes(waiting[: first_packets * packet], t_ns)
            pipeline.on_frames(frames)
            pipeline.tick(t_ns + NS_PER_MS)
            pipeline.on_fog_bytes(waiting[first_packets * packet :], t_ns + 2 * NS_PER_MS)
            waiting, tick_ns = b"", t_ns + 2 * NS_PER_MS
        while tick_ns < t_ns:
            tick_ns = max(tick_ns + 50 * NS_PER_MS, start_ns)
            pipeline.tick(tick_ns)
        if isinstance(data, bytes):
            pipeline.on_fog_bytes(data, t_ns)
        else:
            pipeline.on_frames(data)
    counters = pipeline.counters()
    assert counters["fog"]["lost_packets"] == counters["fog"]["clock_relocks"] == 0
    assert counters["estimator"]["gyro_gaps"] == counters["estimator"]["late_gyro"] == 0


def test_a_side_is_silent_only_after_its_time(tmp_path: Path) -> None:
    """One of the two is always the first, also after a reload: a tick between them shows no silence of the other."""
    config = drive(tmp_path, calibration=False).loaded.value
    pipeline, first_ns, side = Pipeline(config, tmp_path, lambda *_: None), 0, -1
    silent = set[str]()
    for t_ns, data in Circle(config).arrivals(4.0):
        if isinstance(data, bytes):
            continue
        side = data[0].can_id if side < 0 else side
        alone = [frame for frame in data if frame.can_id == side]
        pipeline.on_frames(alone)
        first_ns = first_ns or t_ns
        pipeline.tick(t_ns + NS_PER_MS)
        silent = {r.source for r in pipeline.reasons.active()} & {"encoders.left", "encoders.right"}
        assert bool(silent) == (t_ns + NS_PER_MS - first_ns > config.encoders.silent_after_s * NS_PER_S)
    assert len(silent) == 1
