"""The audit finds the events that were there, where they were, and none in clean data."""

from dataclasses import replace

import numpy as np
import pytest
from diagnosis_drives import SLALOM, WAREHOUSE, recorded, selected, simulated

from drd.arrays import Array
from drd_tools.diagnose.analysis import analyse
from drd_tools.diagnose.observe.audit import _alike_at_the_top, audit, jumped
from drd_tools.diagnose.observe.events import Event
from drd_tools.diagnose.observe.evidence import gather
from drd_tools.diagnose.selected import Selected
from drd_tools.recordings.folder import Recording
from drd_tools.simulate.conditions import Conditions, Ground

SQUARE = ("square-cw", 200.0)
FLAT = [WAREHOUSE, ("stand", 60.0), ("umbmark-cw", 150.0), ("spins", 200.0)]
ROUGH = Conditions(ground=Ground(bump_per_m=1.0, bump_m=0.005))


def events(recording: Recording) -> list[Event]:
    return audit(recording, gather(recording)).events


@pytest.mark.parametrize("conditions", [Conditions(), Conditions(tails=4.0), Conditions(jitter_s=0.003)])
@pytest.mark.parametrize("drive", [SLALOM, ("eights", 120.0), ("field", 180.0), SQUARE])
def test_clean_data_have_no_events(drive: tuple[str, float], conditions: Conditions) -> None:
    assert [e.selected.id for seed in range(3) for e in events(recorded(drive, seed, conditions=conditions))] == []


@pytest.mark.parametrize("drive", FLAT)
def test_turns_at_a_constant_rate_and_standstill_are_no_events(drive: tuple[str, float]) -> None:
    assert [e.selected.id for seed in range(4) for e in events(recorded(drive, seed))] == []


@pytest.mark.parametrize("drive", [WAREHOUSE, SLALOM])
@pytest.mark.parametrize("side", ["left", "right"])
@pytest.mark.parametrize("length_s", [0.3, 1.0, 4.0])
def test_a_dropout_is_found_with_its_side_and_window(drive: tuple[str, float], side: str, length_s: float) -> None:
    missing = selected("encoder_dropout", side=side, t0=41.0, t1=41.0 + length_s)
    found = events(recorded(drive, 1, missing))
    assert [(e.selected.id, e.selected.values["side"]) for e in found] == [("encoder_dropout", side)]
    ((t0, t1),) = found[0].windows
    assert (t0, t1) == pytest.approx((41.0, 41.0 + length_s), abs=0.06)  # a row of the counters


def test_two_dropouts_are_two_events() -> None:
    missing = [selected("encoder_dropout", side=s, t0=t, t1=t + 1.0) for s, t in (("left", 41.0), ("right", 60.0))]
    found = events(recorded(SLALOM, 1, *missing))
    assert [e.selected.values["side"] for e in found] == ["left", "right"]
    assert [round(e.windows[0][0]) for e in found] == [41, 60]


@pytest.mark.parametrize("seed", range(3))
def test_a_reading_that_many_rows_have_to_the_digit_is_a_limit_whatever_the_wheels_say(seed: int) -> None:
    """With wheels that are late and a tread far off, nothing else tells so little."""
    late = (selected("tread_error", k=0.65), selected("encoder_latency", delay=0.17))
    made = recorded(SLALOM, seed, *late, conditions=Conditions(quantise=False))
    fog = made.fog
    assert fog is not None
    assert events(made) == []
    limit = float(np.quantile(np.abs(fog.rate_rad_s), 0.96))
    clipped = replace(made, fog=replace(fog, rate_rad_s=np.clip(fog.rate_rad_s, -limit, limit)))
    (found,) = events(clipped)
    assert found.selected.id == "gyro_saturation"
    assert found.selected.number("limit") == pytest.approx(limit, rel=1e-6)
    e = audit(clipped, gather(clipped)).evidence
    over = np.abs(np.interp(e.time_s, fog.time_s, fog.rate_rad_s)) > 1.05 * limit
    assert np.isinf(e.gyro_inflation_rad2[over]).all()
    assert np.isinf(e.gyro_inflation_rad2).mean() < 0.3


@pytest.mark.parametrize("drive", FLAT)
def test_a_gyro_whose_noise_is_below_its_resolution_is_not_clipped_in_turns_at_a_constant_rate(
    drive: tuple[str, float],
) -> None:
    made = recorded(drive, 1)
    fog = made.fog
    assert fog is not None
    coarse = np.radians(0.5) * np.round(fog.rate_rad_s / np.radians(0.5))
    assert _alike_at_the_top(replace(fog, rate_rad_s=coarse)) is None


@pytest.mark.parametrize("limit", [0.4, 0.55])
def test_clipping_is_found_where_the_robot_turned_faster(limit: float) -> None:
    run = simulated(SLALOM, 1, selected("gyro_saturation", limit=limit))
    (found,) = events(run.recording)
    assert found.selected.id == "gyro_saturation"
    assert found.selected.number("limit") == pytest.approx(limit, rel=1e-3)
    times, faster = run.truth.middle_s, np.abs(run.truth.rate_rad_s) > limit * 1.01
    inside = np.zeros(len(times), bool)
    for t0, t1 in found.windows:
        within = (times >= t0) & (times <= t1)
        assert faster[within].any()
        inside |= within
    assert inside[faster].mean() > 0.99


@pytest.mark.parametrize(
    "missing",
    [selected("gyro_saturation", limit=0.3), selected("encoder_dropout", side="right", t0=41.02, t1=47.04)],
    ids=lambda c: c.id,
)
def test_an_event_leaves_nothing_else_to_be_found(missing: Selected) -> None:
    """Neither where it clips half of all turns, nor where it begins and ends within a row of the counters."""
    for seed in range(3):
        found = analyse(recorded(("eights", 150.0), seed, missing))
        assert [f.effect for f in found.conclusion.causes] == [missing.id]
        assert all(0.8 < (ratio or 0.0) < 1.25 for ratio in found.noise_ratios().values())


def test_steps_at_a_dropout_are_doubted_and_others_are_not() -> None:
    recording = recorded(SQUARE, 1, selected("encoder_dropout", side="left", t0=41.0, t1=42.0))
    e = audit(recording, gather(recording)).evidence
    assert e is not None
    inside = (e.time_s > 41.0 + 0.05) & (e.time_s < 42.0 + 0.05)
    assert (e.left_inflation_m2[inside] > 0.1**2).all()
    assert (e.left_inflation_m2[~inside] > 0.0).mean() < 0.01
    assert (e.right_inflation_m2 > 0.0).mean() < 0.01


def moved(recording: Recording, by: Array, kept: Array | None = None) -> Recording:
    """With other positions of the reference, (m, 2), and only the rows `kept` (m,)."""
    r, rows = recording.reference, slice(None) if kept is None else kept > 0.0
    assert r is not None
    columns = r.time_s, r.x_m + by[:, 0], r.y_m + by[:, 1], r.heading_rad
    time_s, x_m, y_m, heading_rad = (column[rows] for column in columns)
    return replace(recording, reference=replace(r, time_s=time_s, x_m=x_m, y_m=y_m, heading_rad=heading_rad))


def test_a_jump_of_the_reference_is_one_and_a_gap_or_more_noise_than_stated_is_none() -> None:
    made = recorded(SLALOM, 1)
    assert made.reference is not None
    at_s = made.reference.time_s
    still, noise = np.zeros((len(at_s), 2)), np.random.default_rng(1).normal(0.0, 0.06, (len(at_s), 2))
    step = still + (at_s > 50.0)[:, None]
    gap = np.where((at_s > 30.0) & (at_s < 50.0), 0.0, 1.0)
    counts = [
        np.count_nonzero(jumped(audit(r, gather(r)).evidence))
        for r in (made, moved(made, step), moved(made, still, gap), moved(made, noise), moved(made, noise + 2.0 * step))
    ]
    assert counts == [0, 1, 0, 0, 1]


def test_speeds_that_spike_both_ways_are_noise_and_hide_no_turn() -> None:
    made = recorded(SLALOM, 1)
    log, random = made.encoders, np.random.default_rng(1)
    assert log.left_counts is not None
    spikes = 200.0 * random.choice([-1.0, 1.0], len(log.time_s)) * (random.random(len(log.time_s)) < 0.02)
    spiked = replace(made, wheels=replace(log, left_counts=log.left_counts + np.cumsum(np.round(spikes))))
    found = audit(spiked, gather(spiked))
    assert found.events == []
    assert found.evidence.left_inflation_m2.max() == 0.0


@pytest.mark.parametrize(
    "drive",
    [
        SQUARE,
        SLALOM,
    ],
)
def test_bumps_are_found_by_their_one_sidedness(drive: tuple[str, float]) -> None:
    found = events(recorded(drive, 1, conditions=ROUGH))
    assert [e.selected.id for e in found] == ["bump_counts"]
    # Bumps below 5 sigma of the slip are not seen one by one.
    assert 0.003 < found[0].selected.number("travel_per_m") < 0.006
