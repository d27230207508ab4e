"""The monitor on simulated drives: what it names, when, and that it is silent where nothing is."""

from dataclasses import replace

import numpy as np
import pytest

from drd.arrays import Array
from drd.batch.monitored import monitor_logs
from drd.batch.samples import gyro_samples, wheel_samples, zero_of
from drd.config.schema import ConfigError
from drd.effects.effect import Symptom
from drd.monitor import wandering
from drd.monitor.findings import Finding, Size, Suspicion
from drd.monitor.first_turns import FirstTurns
from drd.monitor.library import BIAS, OWN, TURN
from drd.monitor.monitor import Monitor
from drd.monitor.noise import RowNoise
from drd.monitor.rows import Rows
from drd.monitor.scatter import USUAL, Scatter
from drd.monitor.segments import COUNTS, Segment, Segments
from drd.monitor.sums import Component, Sums
from drd.monitor.symptoms import Symptoms
from drd.units import NS_PER_S
from drd_tools.recordings.folder import Recording
from drd_tools.replay.nominal import configuration
from drd_tools.simulate.conditions import Conditions, Reference
from drd_tools.simulate.missions import make_drive
from drd_tools.simulate.robot import DEFAULT
from drd_tools.simulate.simulator import simulate
from drd_tools.simulate.truth import make_truth

BEGIN_S = 120.0


def drive(seed: int, seconds: float = 240.0) -> Recording:
    truth = make_truth(make_drive("warehouse", seconds, 10.0), "constant")
    return simulate(truth, DEFAULT, (), Conditions(reference=Reference(is_there=False)), seed).recording


def with_left_tyre(recording: Recording, share: float, begin_s: float = BEGIN_S) -> Recording:
    """From then on the left counter tells more by a share."""
    log = recording.encoders
    assert log.left_counts is not None
    steps = np.diff(log.left_counts, prepend=log.left_counts[0]) * (1.0 + share * (log.time_s >= begin_s))
    return replace(recording, wheels=replace(log, left_counts=np.round(np.cumsum(steps))))


def with_stop(recording: Recording, seconds: float) -> Recording:
    """The right counter stands still for some time, in which the robot drives straight on."""
    log = recording.encoders
    assert log.right_counts is not None
    steps = np.diff(log.right_counts, prepend=log.right_counts[0])
    begin = int(np.flatnonzero((log.time_s > BEGIN_S) & (steps > 0.8 * steps.max()))[0])
    begin_s = float(log.time_s[begin])
    steps[(log.time_s >= begin_s) & (log.time_s < begin_s + seconds)] = 0.0
    return replace(recording, wheels=replace(log, right_counts=np.cumsum(steps)))


def with_bias(recording: Recording, rad_s: float) -> Recording:
    fog = recording.fog
    assert fog is not None
    return replace(recording, fog=replace(fog, rate_rad_s=fog.rate_rad_s + rad_s * (fog.time_s >= BEGIN_S)))


def with_ground(recording: Recording, share: float, begin_s: float) -> Recording:
    """From then on the wheels turn by a share more for the same turn of the robot."""
    log = recording.encoders
    assert log.left_counts is not None
    assert log.right_counts is not None
    left, right = (np.diff(counts, prepend=counts[0]) for counts in (log.left_counts, log.right_counts))
    more = 0.5 * share * (right - left) * (log.time_s >= begin_s)
    fewer, further = np.cumsum(left - more), np.cumsum(right + more)
    return replace(recording, wheels=replace(log, left_counts=np.round(fewer), right_counts=np.round(further)))


def that_stands(recording: Recording, since_s: float) -> Recording:
    """From then on the robot stands, its gyro's noise that of the first ten seconds."""
    fog, log = recording.fog, recording.encoders
    assert fog is not None
    assert log.left_counts is not None
    assert log.right_counts is not None
    moves = log.time_s <= since_s
    left, right = (np.where(moves, counts, counts[moves][-1]) for counts in (log.left_counts, log.right_counts))
    at_rest = np.resize(fog.rate_rad_s[fog.time_s < 9.0], len(fog.time_s))
    rate_rad_s = np.where(fog.time_s <= since_s, fog.rate_rad_s, at_rest)
    return replace(
        recording, fog=replace(fog, rate_rad_s=rate_rad_s), wheels=replace(log, left_counts=left, right_counts=right)
    )


def found(recording: Recording) -> tuple[list[Finding], int]:
    """Findings, and the time in ns at which the recording's time is 0."""
    made = monitor_logs(recording.fog, recording.encoders, configuration(recording))
    return made.findings, made.zero_ns


def names(finding: Finding) -> set[str]:
    return {finding.effect, *(name for name, _ in finding.also_fits)}


@pytest.mark.parametrize("seed", range(3))
def test_nothing_is_named_where_nothing_is(seed: int) -> None:
    findings, _ = found(drive(seed, 180.0))
    assert findings == []


def test_a_tyre_that_is_smaller_is_named_with_its_begin_and_size() -> None:
    findings, zero_ns = found(with_left_tyre(drive(2), 0.01))
    assert len(findings) == 1
    assert "wheel_radius_error" in names(findings[0])
    assert abs((findings[0].since_ns - zero_ns) / NS_PER_S - BEGIN_S) < 15.0
    assert (findings[0].named_ns - zero_ns) / NS_PER_S < BEGIN_S + 60.0
    told = next(p for p in findings[0].parameters.values() if isinstance(p, Size) and p.std > 0.0)
    assert told.low < told.value < told.high
    assert 0.5 < sum(p for _, p in findings[0].also_fits) + findings[0].probability <= 1.0 + 1e-9
    # That slip may end meanwhile, and has not, is no evidence for it; it fits by nothing else.
    fits = {findings[0].effect: findings[0].probability, **dict(findings[0].also_fits)}
    assert fits.get("surface_slip", 0.0) < 1.5 * fits["wheel_radius_error"]


@pytest.mark.parametrize("seed", [0, 2, 5])
def test_other_ground_from_the_last_second_of_a_turn_on_is_named_after_the_next_turn(seed: int) -> None:
    recording = drive(seed, 180.0)
    assert recording.fog is not None
    time_s, turns = recording.fog.time_s, np.abs(recording.fog.rate_rad_s) > 0.15
    ends_s = time_s[:-1][turns[:-1] & ~turns[1:]]
    end_s, next_s = ends_s[ends_s > BEGIN_S][:2].tolist()
    on_ground, told = with_ground(recording, 0.15, end_s - 0.8), dict[str, float]()

    def watch(monitor: Monitor) -> None:
        told.update({monitor.hypotheses[k.hypothesis].id: k.named_s for k in monitor.known})

    monitor_logs(on_ground.fog, on_ground.encoders, configuration(on_ground), watch)
    assert set(told) <= {"terrain_tread", "tread_error", "gyro_scale_error", "turn_scrub"}
    assert next_s - 8.0 < min(told.values()) < next_s + 10.0


def test_a_finding_keeps_its_name_while_another_one_waits_for_a_second_turn() -> None:
    recording = with_ground(with_left_tyre(drive(0, 130.0), 0.03, 15.0), 0.15, 70.8)
    names_at = dict[float, str]()

    def watch(monitor: Monitor) -> None:
        if monitor.known and 80.0 <= monitor.now_s <= 96.0:
            names_at[monitor.now_s] = monitor.hypotheses[monitor.known[0].hypothesis].id

    monitor_logs(recording.fog, recording.encoders, configuration(recording), watch)
    assert len(names_at) > 3
    assert len(set(names_at.values())) == 1


def test_what_no_name_is_sure_of_yet_is_suspected_and_no_longer_once_it_is_named() -> None:
    recording, told = with_left_tyre(drive(3), 0.004), list[tuple[Suspicion | None, int]]()

    def watch(monitor: Monitor) -> None:
        suspected = monitor.suspected()
        if not told or (suspected is not None, len(monitor.known)) != (told[-1][0] is not None, told[-1][1]):
            told.append((suspected, len(monitor.known)))

    zero_ns = monitor_logs(recording.fog, recording.encoders, configuration(recording), watch).zero_ns
    assert [(s is not None, named) for s, named in told] == [(False, 0), (True, 0), (False, 1)]
    suspected = told[1][0]
    assert suspected is not None
    assert abs((suspected.since_ns - zero_ns) / NS_PER_S - BEGIN_S) < 2.0 * suspected.since_std_s < 100.0
    assert 0.5 < suspected.probability <= 1.0
    assert "wheel_radius_error" in dict(suspected.names)
    assert sum(p for _, p in suspected.names) <= suspected.probability + 1e-9
    assert "wheel_radius_error (0." in suspected.text


def test_a_dead_band_is_named_with_its_size_and_is_no_other_bias_while_the_robot_stands() -> None:
    recording, band_rad_s = that_stands(drive(5, 420.0), 240.0), 0.004
    fog = recording.fog
    assert fog is not None
    rate = np.where((fog.time_s > BEGIN_S) & (np.abs(fog.rate_rad_s) < band_rad_s), 0.0, fog.rate_rad_s)
    findings, zero_ns = found(replace(recording, fog=replace(fog, rate_rad_s=rate)))
    assert [f.effect for f in findings] == ["gyro_deadband"]
    told = findings[0].parameters["band"]
    assert isinstance(told, Size)
    assert told.low < np.degrees(band_rad_s) < told.high
    assert abs((findings[0].since_ns - zero_ns) / NS_PER_S - BEGIN_S) < 10.0
    assert findings[0].until_ns is None


def test_a_gyro_that_says_nothing_but_zero_has_no_dead_band() -> None:
    recording = drive(5, 300.0)
    fog = recording.fog
    assert fog is not None
    dead = replace(recording, fog=replace(fog, rate_rad_s=np.where(fog.time_s > 60.0, 0.0, fog.rate_rad_s)))
    made = monitor_logs(dead.fog, dead.encoders, configuration(dead))
    assert "gyro_deadband" not in {f.effect for f in made.findings}
    assert not made.monitor.is_judging


def test_few_counts_in_a_turn_are_watched_as_well() -> None:
    recording = drive(0, 60.0)
    nominal = replace(recording.nominal, counts_per_revolution=6.0)
    log = recording.encoders
    assert log.left_counts is not None
    assert log.right_counts is not None
    left, right = (np.floor(counts * 6.0 / 20000.0) for counts in (log.left_counts, log.right_counts))
    coarse = replace(recording, nominal=nominal, wheels=replace(log, left_counts=left, right_counts=right))
    assert found(coarse)[0] == []


def test_one_heading_does_not_tell_whether_a_bias_depends_on_it() -> None:
    findings, _ = found(with_bias(that_stands(drive(3, 200.0), BEGIN_S - 10.0), 5e-4))
    (finding,) = findings
    probabilities = {finding.effect: finding.probability, **dict(finding.also_fits)}
    step, by_heading = (probabilities[name] for name in ("gyro_bias_step", "gyro_heading_dependent_bias"))
    assert min(step, by_heading) > 0.3


def test_a_bias_that_jumps_is_named_and_no_wheel_is() -> None:
    findings, zero_ns = found(with_bias(drive(3), 5e-4))
    assert [f.effect for f in findings] == ["gyro_bias_step"]
    told = findings[0].parameters["b"]
    assert isinstance(told, Size)
    assert abs(told.value - np.degrees(5e-4)) < 4.0 * told.std + 0.002
    assert abs((findings[0].since_ns - zero_ns) / NS_PER_S - BEGIN_S) < 30.0
    assert "wheel_radius_error" not in names(findings[0])


def test_a_counter_that_stops_is_named_at_once_and_nothing_else() -> None:
    findings, _ = found(with_stop(drive(4), 4.0))
    assert [f.effect for f in findings] == ["encoder_dropout"]
    assert findings[0].since_ns < findings[0].named_ns < findings[0].since_ns + 3 * NS_PER_S
    assert findings[0].parameters["side"] == "right"


def test_the_same_samples_give_the_same_findings_in_whatever_order_the_sensors_come() -> None:
    recording = with_left_tyre(drive(5), 0.01)
    config, zero_ns = configuration(recording), zero_of(recording.fog, recording.encoders)
    wheels, _, _ = wheel_samples(recording.encoders, config, zero_ns)
    gyro, _ = gyro_samples(recording.fog, config, zero_ns)
    monitor = Monitor(config)
    # The wheels half a second late, as after a busy moment.
    monitor.wheels(wheels[0])
    at = 1
    for sample in gyro:
        monitor.gyro(sample)
        while at < len(wheels) and wheels[at].t_ns < sample.t_ns - NS_PER_S // 2:
            monitor.wheels(wheels[at])
            at += 1
    for rest in wheels[at:]:
        monitor.wheels(rest)
    assert monitor.findings() == monitor_logs(recording.fog, recording.encoders, config).findings
    assert monitor.findings()


def test_what_needs_the_position_is_said() -> None:
    monitor = Monitor(configuration(drive(0, 60.0)))
    told = {n.effect: n.because for n in monitor.not_observable()}
    assert {"lateral_slip_turning", "wheel_radius_speed"} <= told.keys()
    assert all(told.values())


def test_a_log_without_a_gyro_is_refused() -> None:
    recording = drive(0, 60.0)
    with pytest.raises(ConfigError, match="gyro"):
        monitor_logs(None, recording.encoders, configuration(recording))


def test_a_day_is_held_in_few_segments_and_the_newest_are_short() -> None:
    segments = Segments(lambda products: products)
    for k in range(43_200):
        segments.add(2.0 * k, 2.0 * k + 2.0, float(k), np.ones((2, 2)), {600.0 * 60.0})
    assert len(segments.all) <= sum(COUNTS) + len(COUNTS)
    assert segments.all[-1].end_s - segments.all[-1].begin_s == 2.0
    assert all(a.end_s == b.begin_s for a, b in zip(segments.all, segments.all[1:], strict=False))


def test_the_segments_beside_the_begin_of_what_was_found_stay_as_short_as_they_are() -> None:
    segments = Segments(lambda products: products)
    for k in range(600):
        segments.add(2.0 * k, 2.0 * k + 2.0, 0.0, np.ones((2, 2)), {402.0})
    assert {400.0, 402.0, 404.0} <= set(segments.begins_s)
    assert len(segments.all) <= sum(COUNTS) + 3


def test_of_what_was_found_hours_ago_begin_and_end_stay_until_it_is_taken_back() -> None:
    segments, pinned = Segments(lambda products: products), {600.0, 720.0}
    for k in range(10_000):
        segments.add(2.0 * k, 2.0 * k + 2.0, float(k), np.ones((2, 2)), pinned if k > 320 else set())
    assert pinned <= set(segments.begins_s)
    kept = [s for s in segments.all if 600.0 <= s.begin_s < 720.0]
    assert sum(float(s.products[0, 0]) for s in kept) == 60.0  # all blocks of the two minutes, none faded
    most = sum(COUNTS) + 3 * len(pinned)
    assert len(segments.all) <= most
    for k in range(10_000, 12_000):
        segments.add(2.0 * k, 2.0 * k + 2.0, float(k), np.ones((2, 2)), set())
    assert len(segments.all) <= sum(COUNTS) + len(COUNTS)
    assert not pinned & set(segments.begins_s)


def learned(treads: Array) -> Scatter:
    """What is learned of blocks of 20 rows of white noise, in each of which the tread is off by so much."""
    random, scatter = np.random.default_rng(1), Scatter()
    for off in treads:
        x = random.normal(0.0, 30.0, (20, OWN))
        rest = off * x[:, TURN] + random.normal(0.0, 1.0, 20)
        scatter.learn(x.T @ x, x.T @ rest, np.array([0, 0, 20]))
    return scatter


def test_a_tread_that_scatters_is_told_from_white_noise_and_from_one_that_changes_once_or_for_a_time() -> None:
    steady, once = learned(np.zeros(60)), learned(np.repeat([0.0, 0.05], 30))
    for_a_time = learned(np.repeat([0.0, 0.2, 0.0], [24, 12, 24]))
    wandering = learned(np.random.default_rng(2).normal(0.0, 0.05, 60))
    assert (np.sqrt(steady.variances) < 2.0 * USUAL).all()
    assert np.sqrt(once.variances[TURN]) < 2.0 * USUAL[TURN]
    assert np.sqrt(for_a_time.variances[TURN]) < 2.0 * USUAL[TURN]
    assert np.sqrt(wandering.variances[TURN]) == pytest.approx(0.05, rel=0.25)


@pytest.mark.parametrize("wanders", [True, False])
def test_a_tread_that_wanders_over_the_way_is_told_from_one_that_has_changed_once(wanders: bool) -> None:
    random, n, step_m, sigma, std = np.random.default_rng(4), 60, 0.5, 0.02, 0.007
    tread = np.repeat([0.0, sigma], n // 2)
    if wanders:
        kept = np.exp(-1.0)  # of half a metre
        for k, drawn in enumerate(random.normal(0.0, sigma, n)):
            tread[k] = kept * tread[k - 1] + np.sqrt(1.0 - kept**2) * drawn if k else drawn
    segments = []
    for k, off in enumerate(tread + random.normal(0.0, std, n)):
        products = np.zeros((OWN + 1, OWN + 1))
        products[TURN, [TURN, -1]] = products[[TURN, -1], TURN] = np.array([1.0, off]) / std**2
        segments.append(Segment(2.0 * k, 2.0 * k + 2.0, 0.0, 0, products, True, step_m * k, step_m))
    once = Component({TURN: 1.0}, 0.1, n // 2, n)
    nats = [
        wandering.nats(Sums(segments, 0.0, {TURN: 0.02}, False, parts), lambda gain: gain) for parts in ([], [once])
    ]
    assert (nats[1] > 10.0) == wanders
    assert (nats[0] > nats[1] + 10.0) != wanders


def test_products_with_scatter_are_those_of_rows_whitened_with_it() -> None:
    random, scatter = np.random.default_rng(3), learned(np.random.default_rng(2).normal(0.0, 0.05, 60))
    z = random.normal(0.0, 10.0, (20, 9))
    own = z[:, :OWN]
    noise = np.eye(20) + (own * (scatter.variances * (np.arange(OWN) != TURN))) @ own.T
    assert scatter.white(z.T @ z) == pytest.approx(z.T @ np.linalg.solve(noise, z), rel=1e-6, abs=1e-6)


def test_a_row_that_turns_nearly_alone_and_is_far_off_is_an_outlier_and_no_tread() -> None:
    x, rest = np.zeros((20, OWN)), np.random.default_rng(6).normal(0.0, 1.0, 20)
    x[:, 0], x[:4, TURN] = 0.1, (60.0, 35.0, 20.0, 10.0)
    rest[0] = 12.0
    weights = RowNoise().weights(x, rest, np.ones(20), np.ones(20, int), np.ones(20, bool))
    assert weights[0] < 0.3
    rest = 0.2 * x[:, TURN]
    assert RowNoise().weights(x, rest, np.ones(20), np.ones(20, int), np.ones(20, bool)).tolist() == [1.0] * 20


def test_a_row_at_rest_alone_is_no_new_bias_and_several_are() -> None:
    """In a short stop the rows beside it may still creep, so that one alone is at rest."""
    x, kind = np.full((20, OWN), 0.0), np.ones(20, int)
    x[:, BIAS], x[:, TURN] = 0.01, 0.3
    for rows in (1, 4):
        x[:rows, BIAS], x[:rows, TURN], kind[:rows] = 1.0, 0.0, 0
        rest = np.where(kind == 0, 8.0, 0.0)
        weights = RowNoise().weights(x, rest, np.ones(20), kind, np.ones(20, bool))
        assert (weights[:rows] < 0.3).all() if rows == 1 else (weights == 1.0).all()


def test_a_robot_of_which_something_else_is_believed_keeps_the_noise_that_its_gyro_has_at_rest() -> None:
    random, before = np.random.default_rng(5), RowNoise()
    n = 60
    x, kind = random.normal(size=(n, OWN)), np.repeat([0, 1, 2], n // 3)
    before.weights(x, random.normal(0.0, 5.0, n), np.ones(n), kind, np.ones(n, bool))
    after = RowNoise(True, before)
    assert after.scale[0] == before.scale[0] > 2.0
    assert after.scale[1:].tolist() == [1.0, 1.0]


@pytest.mark.parametrize("is_limited", [True, False])
def test_a_limit_of_the_gyro_is_told_from_a_steady_turn_on_ground_of_another_tread(is_limited: bool) -> None:
    """Both have readings that are alike to the last digit while the wheels turn faster."""
    times_s = 0.1 * np.arange(80)
    rates = np.interp(times_s, (1.2, 2.0, 5.0, 6.0), (0.0, 0.6, 0.6, 0.0))
    gyro, wheels = (np.minimum(rates, 0.5), rates) if is_limited else (rates, 1.2 * rates)
    symptoms, none = Symptoms(0.5), np.zeros(32)
    for begin in range(0, 60, 20):
        part = slice(begin, begin + 32)
        distances_m = 0.1 * wheels[part] * 0.25
        end_s, steps_s = np.asarray(times_s[part], float), np.full(32, 0.1)
        is_good = np.ones(32, bool)
        rows = Rows(end_s, steps_s, 0.1 * gyro[part], none, -distances_m, distances_m, none, none, is_good, 12, 0, none)
        symptoms.look(rows, 0.1 * wheels[part], 1.0, 0.0, np.full(32, 1e-6), 1e-5)
    found = symptoms.seen.get((Symptom.CLIPPED, ""))
    assert (found is not None and found.sure) == is_limited
    assert found is None or found.size == pytest.approx(0.5)


def test_a_robot_that_creeps_through_its_first_two_minutes_shows_that_it_skids_and_one_that_stands_nothing() -> None:
    creeps = 0.01 * np.sin(0.05 * np.arange(1300))
    told = FirstTurns().add(1.8 * creeps, creeps)
    assert told is not None
    assert told.lag_s == 0.0
    assert told.tread == pytest.approx(1.8, rel=0.01)
    stands = FirstTurns()
    assert stands.add(np.zeros(1300), np.zeros(1300)) is None
    assert stands.is_over
