"""What must hold in any world, and what emerges in this one. MuJoCo is an optional extra."""

import dataclasses
import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

pytest.importorskip("mujoco", reason="the extra drd[mujoco] is not installed")

from drd_tools.mujoco_world.ground import Ground
from drd_tools.mujoco_world.measure import Manoeuvre, coulomb_tread_ratio, make_blocks, manoeuvres
from drd_tools.mujoco_world.missions import MISSIONS, Follow, Spin, legs_of
from drd_tools.mujoco_world.vehicle import Vehicle
from drd_tools.mujoco_world.world import Motion, drive, turned_about_own_axis_rad

VEHICLE = Vehicle()
CENTRED = Vehicle(centre_m=(0.0, 0.0, 0.21))


def driven(mission: str, seconds: float, vehicle: Vehicle = VEHICLE, ground: Ground | None = None) -> Motion:
    return drive(vehicle, ground or Ground(), mission, seconds, 2.0, seed=1)


def emerged(motion: Motion, vehicle: Vehicle, kind: str) -> list[Manoeuvre]:
    found = [m for m in manoeuvres(make_blocks(motion, vehicle)) if m.kind.startswith(kind)]
    assert found
    return found


def test_a_straight_drive_is_as_long_as_its_wheels_tell_within_a_per_cent() -> None:
    motion = driven("straight", 22.0)
    told_m = VEHICLE.wheel_radius_m * 0.5 * (motion.left_rad[-1] + motion.right_rad[-1])
    assert motion.x_m[-1] > 15.0
    assert abs(motion.y_m[-1]) < 1e-3
    # Less than told, since a pressed tyre's radius is smaller.
    assert 0.99 < motion.x_m[-1] / told_m < 0.999


@pytest.mark.parametrize("friction", [0.3, 0.8])
@pytest.mark.parametrize("wheelbase_m", [0.3, 0.512])
def test_on_the_spot_the_tread_is_that_of_coulomb_friction(friction: float, wheelbase_m: float) -> None:
    vehicle = dataclasses.replace(CENTRED, wheelbase_m=wheelbase_m)
    motion = driven("spins", 60.0, vehicle, Ground(friction=friction))
    ratio = np.array([m.tread_m / vehicle.track_m for m in emerged(motion, vehicle, "spin")])
    assert np.all(ratio > 1.2)
    # The pressed tyre's smaller radius makes it 0.7 % larger.
    np.testing.assert_allclose(ratio, coulomb_tread_ratio(vehicle), rtol=0.02)


def test_a_load_on_the_rear_wheels_makes_the_tread_smaller_and_moves_the_centre_back() -> None:
    loaded = Vehicle(payload_kg=30.0)
    empty_spin = emerged(driven("umbmark-ccw", 16.0), VEHICLE, "spin")[0]
    spin = emerged(driven("umbmark-ccw", 16.0, loaded), loaded, "spin")[0]
    assert spin.tread_m < 0.96 * empty_spin.tread_m
    assert spin.ahead_m < empty_spin.ahead_m - 0.03


def test_the_slipperier_the_ground_the_further_a_turning_robot_slides_outward() -> None:
    ahead_m = [
        emerged(driven("eights", 15.0, ground=Ground(friction=mu)), VEHICLE, "bend left")[0].ahead_m
        for mu in (0.2, 0.4, 0.8)
    ]
    assert ahead_m[0] > ahead_m[1] + 0.02 > ahead_m[2] + 0.04


def test_mass_alone_hardly_changes_the_tread() -> None:
    heavy = dataclasses.replace(CENTRED, payload_kg=60.0, payload_at_m=CENTRED.centre_m)
    spins = [emerged(driven("umbmark-ccw", 16.0, v), v, "spin")[0] for v in (CENTRED, heavy)]
    # It is the tyres' deflection, 2 mm more of 165 mm, that is left.
    assert spins[1].tread_m == pytest.approx(spins[0].tread_m, rel=0.02)


def test_left_and_right_are_mirror_images() -> None:
    left, right = driven("square-ccw", 20.0), driven("square-cw", 20.0)
    assert left.y_m[-1] > 1.0
    np.testing.assert_allclose(right.x_m, left.x_m, atol=1e-6)
    np.testing.assert_allclose(right.y_m, -left.y_m, atol=1e-6)
    np.testing.assert_allclose(right.left_rad, left.right_rad, atol=1e-6)


def test_patches_have_their_own_friction_and_bumps_shake_the_robot() -> None:
    plain = driven("eights", 25.0)
    patched = driven("eights", 25.0, ground=Ground(patch_friction=0.3))
    assert set(np.unique(plain.friction)) == {0.8}
    assert patched.friction.min() < 0.5
    assert patched.friction.max() == pytest.approx(0.8)
    assert np.abs(patched.lateral_m_s).max() > 2.0 * np.abs(plain.lateral_m_s).max()
    bumpy = driven("eights", 25.0, ground=Ground(bumps_per_m=3.0))
    # A gyro fixed to a body that rolls and pitches does not sum up the heading.
    assert np.ptp(bumpy.gyro_rad - bumpy.heading_rad) > 10.0 * np.ptp(plain.gyro_rad - plain.heading_rad)


def test_the_same_arguments_give_the_same_bits() -> None:
    ground = Ground(patch_friction=0.4, bumps_per_m=1.0)
    one, two = driven("circles", 15.0, ground=ground), driven("circles", 15.0, ground=ground)
    for column in dataclasses.fields(Motion):
        np.testing.assert_array_equal(getattr(one, column.name), getattr(two, column.name))
    other = drive(VEHICLE, ground, "circles", 15.0, 2.0, seed=2)
    assert np.any(other.x_m != one.x_m)


@pytest.mark.parametrize("mission", MISSIONS)
def test_a_lap_ends_where_it_begins(mission: str) -> None:
    heading, end = 0.0, np.zeros(2)
    for leg in MISSIONS[mission].lap():
        if isinstance(leg, Spin):
            heading += leg.angle_rad
        elif isinstance(leg, Follow):
            np.testing.assert_allclose(leg.path_m[0], end, atol=1e-3)
            begin = np.diff(leg.path_m[:2], axis=0)[0]
            np.testing.assert_allclose(begin / np.hypot(*begin), (np.cos(heading), np.sin(heading)), atol=0.03)
            turns = np.unwrap(np.arctan2(*np.diff(leg.path_m, axis=0).T[::-1]))
            heading, end = heading + turns[-1] - turns[0], leg.path_m[-1]
    np.testing.assert_allclose(end, 0.0, atol=1e-3)
    assert np.cos(heading) == pytest.approx(1.0, abs=1e-3)


def test_one_lap_ends_and_endless_laps_do_not() -> None:
    lap = MISSIONS["eights"].lap()
    assert len(list(legs_of("eights", 2.0, endless=False))) == len(lap) + 2
    assert len(list(itertools.islice(legs_of("eights", 2.0, endless=True), 100))) == 100


@given(track_m=st.floats(0.2, 2.0), ratio=st.floats(0.2, 2.0))
@settings(deadline=None)
def test_with_narrow_tyres_coulomb_friction_has_a_closed_form(track_m: float, ratio: float) -> None:
    vehicle = Vehicle(track_m=track_m, wheelbase_m=ratio * track_m, tyre_width_m=0.0)
    # F u c = F w a a: lengthwise slide u = w a^2 / c.
    assert coulomb_tread_ratio(vehicle) == pytest.approx(1.0 + ratio**2, rel=1e-9)


@given(st.lists(st.tuples(*[st.floats(-0.5, 0.5)] * 3), min_size=1, max_size=20))
@settings(deadline=None)
def test_a_gyro_sums_up_the_rotation_about_its_own_axis(turns: list[tuple[float, float, float]]) -> None:
    quaternion = np.array([1.0, 0.0, 0.0, 0.0])
    all_of_them = [quaternion]
    for turn in turns:
        angle = float(np.linalg.norm(turn))
        axis = np.array(turn) / angle if angle else np.zeros(3)
        c, (x, y, z) = np.cos(0.5 * angle), np.sin(0.5 * angle) * axis
        a, b, d, e = quaternion
        quaternion = np.array([
            a * c - b * x - d * y - e * z,
            a * x + b * c + d * z - e * y,
            a * y - b * z + d * c + e * x,
            a * z + b * y - d * x + e * c,
        ])  # fmt: skip
        all_of_them.append(quaternion)
    wanted = np.concatenate(([0.0], np.cumsum([turn[2] for turn in turns])))
    np.testing.assert_allclose(turned_about_own_axis_rad(np.array(all_of_them)), wanted, atol=1e-7)
