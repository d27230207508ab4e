"""A gyro that has lost packets while the host stood still: how wrong may the heading be. (18)"""

from typing import Literal

import pytest

from drd.config import keys
from drd.config.keys import Config
from drd.estimation.estimate import initial_sigmas
from drd.estimation.noise import make_noise
from drd.estimation.stall import Stall
from drd.estimation.track import Track, make_track
from drd.fog import make_protocol
from drd.samples import CalibratedRate
from drd.units import NS_PER_S

Protocol = Literal["ecore", "dsp3000", "dsp17xx"]
TREAD_M, PARTED_RAD = 0.6, 0.1


def stalled(protocol: Protocol = "dsp3000", fastest_rad_s: float = 1.0) -> tuple[Stall, Track]:
    """In a stall at 1 s, in which the wheels have turned by PARTED_RAD and the gyro by nothing."""
    config = Config(robot=keys.Robot(wheel_radius_m=0.1, tread_m=TREAD_M), fog=keys.Fog(protocol=protocol))
    track = make_track(config, initial_sigmas(config, False), make_noise("physical", keys.Noise(), TREAD_M))
    stall = Stall(config)
    assert heard(stall, track, 1.0, 0.0, 0.5, is_stalled=True) == 0.0
    stall.turns(fastest_rad_s)
    turn_by_wheels(track, PARTED_RAD)
    return stall, track


def heard(stall: Stall, track: Track, t_s: float, gap_s: float, behind_s: float, is_stalled: bool) -> float:
    """A sample of a gyro that stands; returns the growth of the heading's variance, rad^2."""
    before = track.kf.heading_variance_rad2
    stall.gyro(track, CalibratedRate(round(t_s * NS_PER_S), 0.1, 0.0, 0.0), gap_s, behind_s, is_stalled)
    return track.kf.heading_variance_rad2 - before


def turn_by_wheels(track: Track, turn_rad: float) -> None:
    track.hindsight.moved(0.0, turn_rad * TREAD_M, 0.0)


@pytest.mark.parametrize("protocol", ["ecore", "dsp3000", "dsp17xx"])
@pytest.mark.parametrize(("fastest_rad_s", "wrong_rad"), [(0.5, PARTED_RAD), (0.2, 0.2 * 0.3)])
def test_what_both_part_is_in_the_heading_while_the_gyro_is_behind_unless_its_packets_have_numbers(
    protocol: Protocol, fastest_rad_s: float, wrong_rad: float
) -> None:
    stall, track = stalled(protocol, fastest_rad_s)
    growth = heard(stall, track, 1.1, 0.0, 0.3, is_stalled=False)
    is_numbered = make_protocol(keys.Fog(protocol=protocol)).sequence_modulus is not None
    assert growth == pytest.approx(0.0 if is_numbered else wrong_rad**2)
    assert heard(stall, track, 1.2, 0.0, 0.3, is_stalled=False) == 0.0  # counted once


def test_the_doubt_ends_with_the_gap_that_shows_the_loss_or_after_two_seconds() -> None:
    stall, track = stalled()
    assert heard(stall, track, 1.5, 0.4, 0.0, is_stalled=False) == pytest.approx(PARTED_RAD**2)
    turn_by_wheels(track, PARTED_RAD)
    assert heard(stall, track, 2.0, 0.4, 0.0, is_stalled=False) == 0.0
    heard(stall, track, 3.0, 0.0, 0.5, is_stalled=True)
    heard(stall, track, 5.1, 0.0, 0.0, is_stalled=False)
    turn_by_wheels(track, PARTED_RAD)
    assert heard(stall, track, 5.2, 0.4, 0.0, is_stalled=False) == 0.0


def test_a_pose_that_is_set_has_no_part_of_what_was_turned_before() -> None:
    stall, track = stalled()
    stall.pose_was_set(track)
    assert heard(stall, track, 1.5, 0.4, 0.0, is_stalled=False) == 0.0
