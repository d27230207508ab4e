"""Clocks at their worst: boundaries, leap seconds, slewing, suspension, stopped machines, stamps that jump."""

import dataclasses
import itertools
import math
from collections.abc import Iterator
from pathlib import Path

import msgspec
import pytest
from bench.robot import Arrival, Circle
from hypothesis import given, settings
from hypothesis import strategies as st
from recorded_drive import drive, recordings

from drd.config.keys import Config
from drd.output.messages import pose_dict
from drd.pipeline import Pipeline
from drd.ports.clock import ROUNDING_NS, ReceiveClock
from drd.samples import CanFrame, Pose, Validity
from drd.state import keeper as keeper_module
from drd.state.keeper import LEAST_SLEEP_NS, StateKeeper
from drd.units import NS_PER_MS, NS_PER_S
from drd_tools.replay.mcap_source import replay_mcap
from drd_tools.replay.result import digest

TICK_NS = 50 * NS_PER_MS
SECONDS = 12.0
# Milliseconds in 32 bits end after 49.7 days; nanoseconds in 63 bits and in the 53 of a double after 292 years and
# 104 days.
BOUNDARIES_NS = {"2^31 ms": 2**31 * NS_PER_MS, "2^32 ms": 2**32 * NS_PER_MS, "2^53 ns": 2**53, "2^63 ns": 2**63}
WALL_NS = 1_790_000_000 * NS_PER_S
# Beyond this the bound says "anywhere": variances are limited.
ANYWHERE_M = 30_000.0
# A float of today's seconds, as drivers hand stamps over.
FLOAT_NS = 300


class Run:
    """A pipeline that is fed a circle, stamped by a clock that began at `start_ns`."""

    def __init__(self, config: Config, start_ns: int = 0):
        self.start_ns = start_ns
        self.poses: list[Pose] = []
        self.pipeline = Pipeline(config, Path(), lambda pose, _: self.poses.append(pose))
        self._tick_ns = start_ns

    def feed(self, arrivals: list[Arrival]) -> None:
        for t_ns, data in arrivals:
            self.pass_time(t_ns)
            if isinstance(data, bytes):
                self.pipeline.on_fog_bytes(data, self.start_ns + t_ns)
            else:
                self.pipeline.on_frames([f._replace(t_ns=self.start_ns + f.t_ns) for f in data])

    def pass_time(self, t_ns: int) -> None:
        while self._tick_ns + TICK_NS <= self.start_ns + t_ns:
            self._tick_ns += TICK_NS
            self.pipeline.tick(self._tick_ns)

    def since_start(self) -> list[Pose]:
        """The poses, as if the clock had begun at 0."""
        return [
            dataclasses.replace(
                p,
                t_ns=p.t_ns - self.start_ns,
                reasons=tuple(r._replace(since_ns=r.since_ns - self.start_ns) for r in p.reasons),
            )
            for p in self.poses
        ]


@pytest.fixture(scope="module")
def config(tmp_path_factory: pytest.TempPathFactory) -> Config:
    """A robot whose bias is not measured first: it drives at once."""
    found = drive(tmp_path_factory.mktemp("time"), calibration=False).loaded.value
    at_once = dataclasses.replace(found.estimation.static_bias, duration_s=0.0)
    return dataclasses.replace(found, estimation=dataclasses.replace(found.estimation, static_bias=at_once))


def run(config: Config, start_ns: int, arrivals: list[Arrival]) -> list[Pose]:
    made = Run(config, start_ns)
    made.feed(arrivals)
    return made.since_start()


# ---- boundaries ----------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def early(config: Config) -> list[Pose]:
    """The poses of a robot that was switched on a second ago."""
    return run(config, NS_PER_S, Circle(config).arrivals(SECONDS))


@pytest.mark.parametrize("boundary_ns", BOUNDARIES_NS.values(), ids=BOUNDARIES_NS)
def test_poses_are_the_same_to_the_bit_over_a_boundary_of_the_clock(
    config: Config, early: list[Pose], boundary_ns: int
) -> None:
    poses = run(config, boundary_ns - round(SECONDS / 2) * NS_PER_S, Circle(config).arrivals(SECONDS))
    assert poses == early
    assert poses[-1].validity is Validity.VALID


@settings(deadline=None, max_examples=10, derandomize=True)
@given(start_ns=st.integers(NS_PER_S, 2**63))
def test_poses_do_not_depend_on_when_the_machine_was_started(config: Config, start_ns: int) -> None:
    arrivals = Circle(config).arrivals(4.0)
    assert run(config, start_ns, arrivals) == run(config, NS_PER_S, arrivals)


@pytest.mark.parametrize("boundary_ns", BOUNDARIES_NS.values(), ids=BOUNDARIES_NS)
def test_a_pose_is_published_whole_beyond_a_boundary(config: Config, boundary_ns: int) -> None:
    made = Run(config, boundary_ns)
    made.feed(Circle(config).arrivals(0.5))
    values = msgspec.json.decode(msgspec.json.encode(pose_dict(made.poses[-1], WALL_NS)))
    assert values["monotonic_ns"] == made.poses[-1].t_ns > boundary_ns


# ---- the wall clock, by which CAN drivers stamp --------------------------------------------------------------------


class Clocks:
    """Both clocks of a machine, and the drivers' stamps; `slew_ppm`: how fast the wall clock's offset changes."""

    def __init__(self, slew_ppm: float = 0.0, start_ns: int = 1000 * NS_PER_S):
        self.now_ns, self.wall_ns, self._slew = start_ns, WALL_NS, slew_ppm * 1e-6
        self.clock = ReceiveClock(5.0, lambda: self.now_ns, lambda: self.wall_ns)

    def advance(self, ns: int) -> None:
        self.now_ns += ns
        self.wall_ns += ns + round(ns * self._slew)

    def stamps(self, count: int, period_ns: int, age_ns: int) -> Iterator[tuple[int, int]]:
        """When each frame was received, and what the clock says, `age_ns` later."""
        for _ in range(count):
            self.advance(period_ns - age_ns)
            received_ns, stamp_s = self.now_ns, self.wall_ns * 1e-9
            self.advance(age_ns)
            yield received_ns, self.clock.to_monotonic_ns(stamp_s)


@pytest.mark.parametrize("slew_ppm", [-500.0, 500.0])
def test_an_offset_slewed_by_500_ppm_moves_no_stamp_by_more_than_its_age_does(slew_ppm: float) -> None:
    """Ten minutes in which the offset moves by 300 ms: a frame's age of 5 ms is wrong by 2.5 us at most."""
    clocks = Clocks(slew_ppm)
    errors = [abs(found - true) for true, found in clocks.stamps(12_000, TICK_NS, 5 * NS_PER_MS)]
    assert max(errors) <= 5 * NS_PER_MS * 500e-6 + TICK_NS * 500e-6 + ROUNDING_NS
    assert clocks.clock.counters == {"stepped_stamps": 0, "backward_stamps": 0}


@pytest.mark.parametrize("step_ns", [-NS_PER_S, NS_PER_S])
def test_a_leap_second_shifts_no_stamp_by_more_than_its_age(step_ns: int) -> None:
    """Inserted, the wall clock repeats a second; deleted, it leaves one out."""
    clocks, age_ns = Clocks(), 5 * NS_PER_MS
    found = list(clocks.stamps(40, TICK_NS, age_ns))
    clocks.wall_ns += step_ns
    found += clocks.stamps(40, TICK_NS, age_ns)
    assert max(abs(a - b) for a, b in found) <= age_ns
    assert [b for _, b in found] == sorted(b for _, b in found)
    assert max(abs(a - b) for a, b in found[-30:]) <= ROUNDING_NS


@pytest.mark.parametrize("boundary_ns", BOUNDARIES_NS.values(), ids=BOUNDARIES_NS)
def test_stamps_are_mapped_over_a_boundary_of_the_clock(boundary_ns: int) -> None:
    clocks = Clocks(start_ns=boundary_ns - NS_PER_S)
    # A double of 2^63 ns has steps of 2 us.
    assert max(abs(a - b) for a, b in clocks.stamps(40, TICK_NS, NS_PER_MS)) <= ROUNDING_NS + FLOAT_NS
    assert not any(clocks.clock.counters.values())


JUMPS = st.sampled_from([0.0, -1e-3, 1.0, -1.0, 30.0, -30.0, 1e9, -1e9, math.inf, -math.inf, math.nan, "zero"])


@settings(deadline=None, max_examples=200, derandomize=True)
@given(st.lists(st.tuples(JUMPS, st.integers(0, 20)), min_size=1, max_size=40))
def test_hardware_stamps_that_jump_never_run_backward_nor_lie_in_the_future(jumps: list[tuple[object, int]]) -> None:
    clocks, last_ns = Clocks(), 0
    for jump, wait_ms in jumps:
        clocks.advance(wait_ms * NS_PER_MS)
        stamp_s = 0.0 if isinstance(jump, str) else clocks.wall_ns * 1e-9 + float(str(jump))
        found = clocks.clock.to_monotonic_ns(stamp_s)
        assert last_ns <= found <= clocks.now_ns
        # At most as old as a stamp may be: what is older counts as received now.
        assert found >= clocks.now_ns - 5 * NS_PER_S - ROUNDING_NS
        last_ns = found


@pytest.mark.parametrize("jump_s", [-3600.0, -1.0, 1.0, 3600.0, None], ids=str)
def test_a_pose_survives_hardware_stamps_that_jump(config: Config, jump_s: float | None) -> None:
    """From the sixth second on every second stamp is off (None: zero); such frames count as received now."""
    clocks, made, number = Clocks(start_ns=NS_PER_S), Run(config, NS_PER_S), itertools.count()
    plain = Run(config, NS_PER_S)
    arrivals = Circle(config).arrivals(SECONDS)
    plain.feed(arrivals)
    stamped = []
    for t_ns, data in arrivals:
        clocks.advance(NS_PER_S + t_ns - clocks.now_ns)
        if isinstance(data, list):
            stamp_s = clocks.wall_ns * 1e-9
            if t_ns > 6 * NS_PER_S and next(number) % 2:
                stamp_s = 0.0 if jump_s is None else stamp_s + jump_s
            received_ns = clocks.clock.to_monotonic_ns(stamp_s) - NS_PER_S
            data = [f._replace(t_ns=received_ns) for f in data]  # noqa: PLW2901
        stamped.append(Arrival(t_ns, data))
    made.feed(stamped)
    got = made.poses[-1]
    (true,) = [pose for pose in plain.poses if pose.t_ns == got.t_ns]
    assert got.t_ns >= plain.poses[-1].t_ns - TICK_NS
    assert got.validity is Validity.VALID
    assert math.hypot(got.x_m - true.x_m, got.y_m - true.y_m) < 1e-3
    assert clocks.clock.counters["backward_stamps" if jump_s == -1.0 else "stepped_stamps"] == 60


# ---- a machine that did not see its robot --------------------------------------------------------------------------


def kept(config: Config, made: Run, monkeypatch: pytest.MonkeyPatch) -> tuple[StateKeeper, list[int]]:
    """The state's keeper, with how long the machine has been suspended in all (a list of one)."""
    asleep = [7 * NS_PER_S]
    monkeypatch.setattr(keeper_module, "asleep_ns", lambda: asleep[0])
    keeper = StateKeeper(config, made.pipeline)
    keeper.tick(made.start_ns)
    return keeper, asleep


@pytest.mark.parametrize("slept_s", [60, 3600, 30 * 86_400])
def test_after_a_suspension_the_pose_is_worth_what_it_is_after_a_restart(
    config: Config, monkeypatch: pytest.MonkeyPatch, slept_s: int
) -> None:
    """It drove when the machine fell asleep: the bound grows by what it may have driven, and the pose is not valid."""
    made = Run(config, NS_PER_S)
    keeper, asleep = kept(config, made, monkeypatch)
    arrivals = Circle(config).arrivals(SECONDS)
    made.feed([a for a in arrivals if a.t_ns <= 8 * NS_PER_S])
    keeper.tick(9 * NS_PER_S)
    before = made.poses[-1]
    assert before.validity is Validity.VALID
    asleep[0] += slept_s * NS_PER_S
    keeper.tick(9 * NS_PER_S + TICK_NS)
    made.feed([a for a in arrivals if a.t_ns > 8 * NS_PER_S])
    after = made.poses[-1]
    assert after.validity is not Validity.VALID
    assert after.position_bound_m > before.position_bound_m + min(0.5 * slept_s, ANYWHERE_M)
    assert math.isfinite(after.position_bound_m)


@pytest.mark.parametrize("reloads", [False, True])
def test_a_robot_that_was_suspended_is_not_at_the_origin_whatever_a_restart_makes_of_its_pose(
    config: Config, monkeypatch: pytest.MonkeyPatch, reloads: bool
) -> None:
    made = Run(config, NS_PER_S)
    estimation = dataclasses.replace(config.estimation, invalid_after_s=100.0)
    state = dataclasses.replace(config.state, pose="origin")
    origin = dataclasses.replace(config, state=state, estimation=estimation)
    keeper, asleep = kept(config if reloads else origin, made, monkeypatch)
    if reloads:
        keeper.put_in_force(origin)
    made.feed([a for a in Circle(config).arrivals(SECONDS) if a.t_ns <= 8 * NS_PER_S])
    before = made.pipeline.estimator.newest()
    asleep[0] += 50 * NS_PER_S
    keeper.tick(9 * NS_PER_S)
    estimate = made.pipeline.estimator.estimate()
    assert estimate is not None
    assert not estimate.lost  # after 50 s of 100
    # Nor has it travelled again what waits for the gyro.
    assert made.pipeline.estimator.newest() == pytest.approx(before, abs=1e-9)
    assert math.hypot(*before[:2]) > 0.3


def test_a_run_with_a_suspension_is_replayed_to_the_bit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    live, asleep = drive(tmp_path), [0]
    monkeypatch.setattr(keeper_module, "asleep_ns", lambda: asleep[0])
    live.start()
    keeper = StateKeeper(live.loaded.value, live.pipeline)

    def suspend(count: int) -> None:
        asleep[0] = 600 * NS_PER_S if count >= 200 else 0
        keeper.tick(live.poses[-1].t_ns if live.poses else 1)

    live.run(SECONDS, suspend)
    assert live.recorder.close(5.0)
    (file,) = recordings(tmp_path)
    assert replay_mcap(file).digest() == digest(live.poses)
    assert live.poses[-1].position_bound_m > 100.0


def test_a_busy_machine_is_not_taken_for_a_suspended_one(config: Config, monkeypatch: pytest.MonkeyPatch) -> None:
    made = Run(config, NS_PER_S)
    keeper, asleep = kept(config, made, monkeypatch)
    arrivals = Circle(config).arrivals(SECONDS)
    made.feed([a for a in arrivals if a.t_ns <= 8 * NS_PER_S])
    asleep[0] += LEAST_SLEEP_NS
    keeper.tick(9 * NS_PER_S)
    made.feed([a for a in arrivals if a.t_ns > 8 * NS_PER_S])
    assert made.since_start() == run(config, NS_PER_S, arrivals)


def test_a_suspension_before_the_first_sample_changes_nothing(config: Config, monkeypatch: pytest.MonkeyPatch) -> None:
    made = Run(config, NS_PER_S)
    keeper, asleep = kept(config, made, monkeypatch)
    asleep[0] += 3600 * NS_PER_S
    keeper.tick(NS_PER_S)
    arrivals = Circle(config).arrivals(4.0)
    made.feed(arrivals)
    assert made.since_start() == run(config, NS_PER_S, arrivals)


@pytest.mark.parametrize("stopped_s", [0.2, 5.0, 3600.0])
def test_a_stopped_virtual_machine_gives_no_false_motion(config: Config, stopped_s: float) -> None:
    """No clock of the machine tells; the robot drove on. Its counters have jumped: no motion is made of it.

    Where the jump is within the robot's top speed for one period, it is motion, and true.
    """
    made, stopped_ns = Run(config, NS_PER_S), round(stopped_s * NS_PER_S)
    arrivals = Circle(config).arrivals(8.0 + min(stopped_s, 10.0) + 4.0)
    begin_ns, end_ns = 8 * NS_PER_S, 8 * NS_PER_S + min(stopped_ns, 10 * NS_PER_S)
    seen = []
    for t_ns, data in arrivals:
        if begin_ns <= t_ns < end_ns:
            continue
        late_ns = end_ns - begin_ns if t_ns >= end_ns else 0
        if isinstance(data, list):
            data = [CanFrame(f.t_ns - late_ns, *f[1:]) for f in data]  # noqa: PLW2901
        seen.append(Arrival(t_ns - late_ns, data))
    made.feed(seen)
    speeds = [p.speed_m_s for p in made.poses]
    assert max(speeds) <= config.robot.max_speed_m_s
    assert all(math.isfinite(p.x_m) for p in made.poses)
    steps = [math.hypot(b.x_m - a.x_m, b.y_m - a.y_m) for a, b in itertools.pairwise(made.poses)]
    assert max(steps) <= config.robot.max_speed_m_s * 0.3
    assert made.poses[-1].speed_m_s == pytest.approx(0.5, abs=0.05)
