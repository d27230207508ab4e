"""Foxglove's messages, decoded by the classes that Foxglove itself publishes."""

import itertools
import math
from typing import Any

import pytest
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from google.protobuf.descriptor import Descriptor
from hypothesis import given, settings
from hypothesis import strategies as st
from protobuf_messages import message_class

from drd.output.foxglove import BOUND_COLOURS, FIRST_STEP_M, GRID_M, MOST_POINTS, SCHEMA, PoseEncoder, Scene
from drd.samples import Pose, Validity

WALL_NS = 1_700_000_000_123_456_789
SPEED_M_S = 1.0
NAMES = st.text(alphabet=st.characters(exclude_categories=["Cs"]), max_size=200)


def a_pose(t_s: float = 0.0, x_m: float = 1.0, y_m: float = 2.0, **changes: Any) -> Pose:
    values: dict[str, Any] = {
        "t_ns": round(t_s * 1e9),
        "sequence": 1,
        "x_m": x_m,
        "y_m": y_m,
        "heading_rad": 0.5,
        "speed_m_s": SPEED_M_S,
        "rate_rad_s": 0.1,
        "speed_sigma_m_s": 0.01,
        "rate_sigma_rad_s": 0.01,
        "covariance": (0.0,) * 6,
        "position_bound_m": 0.25,
        "validity": Validity.VALID,
        "reasons": (),
    }
    return Pose(**(values | changes))


def path_of(scene: Scene, pose: Pose) -> list[tuple[float, float]]:
    (line,) = SceneUpdate.FromString(scene.encode(pose, WALL_NS)).entities[0].lines
    return [(point.x, point.y) for point in line.points]


def driven(scene: Scene, length_m: float, step_m: float = 0.02) -> Pose:
    """A quarter circle to the left."""
    radius_m = length_m / (0.5 * math.pi)
    for i in range(round(length_m / step_m) + 1):
        angle = i * step_m / radius_m
        pose = a_pose(i * step_m / SPEED_M_S, radius_m * math.sin(angle), radius_m * (1.0 - math.cos(angle)))
        scene.add(pose)
    return pose


def fields(message: Descriptor) -> list[tuple[Any, ...]]:
    return [
        (f.name, f.number, f.type, f.is_repeated, f.message_type and f.message_type.full_name) for f in message.fields
    ]


def test_the_schema_is_that_of_foxgloves_own_package() -> None:
    seen: set[str] = set()

    def compare(ours: Descriptor, theirs: Descriptor) -> None:
        assert fields(ours) == fields(theirs), theirs.full_name
        for enum, known_enum in zip(ours.enum_types, theirs.enum_types, strict=True):
            assert enum.values_by_number.keys() == known_enum.values_by_number.keys()
            assert list(enum.values_by_name) == list(known_enum.values_by_name)
        for field, known in zip(ours.fields, theirs.fields, strict=True):
            one, other = field.message_type, known.message_type
            if one and other and other.full_name not in seen:
                seen.add(other.full_name)
                compare(one, other)

    for theirs in (SceneUpdate, FrameTransform, PoseInFrame):
        name = theirs.DESCRIPTOR.full_name
        compare(message_class(SCHEMA, name).DESCRIPTOR, theirs.DESCRIPTOR)
    assert {"foxglove.LinePrimitive", "foxglove.ModelPrimitive", "google.protobuf.Duration"} <= seen


@given(NAMES, NAMES, st.integers(0, 2**62), st.tuples(*[st.floats(allow_nan=False)] * 2), st.floats(-1e4, 1e4))
@settings(deadline=None)
def test_another_decoder_reads_pose_and_transform(
    frame: str, child: str, wall_ns: int, place: tuple[float, float], heading_rad: float
) -> None:
    encoder = PoseEncoder(frame, child)
    pose = a_pose(0.0, *place, heading_rad=heading_rad)
    in_frame = PoseInFrame.FromString(encoder.in_frame(pose, wall_ns))
    transform = FrameTransform.FromString(encoder.transform(pose, wall_ns))
    assert (in_frame.frame_id, transform.parent_frame_id, transform.child_frame_id) == (frame, frame, child)
    for stamp in (in_frame.timestamp, transform.timestamp):
        assert (stamp.seconds, stamp.nanos) == divmod(wall_ns, 10**9)
    for position, turn in (
        (in_frame.pose.position, in_frame.pose.orientation),
        (transform.translation, transform.rotation),
    ):
        assert (position.x, position.y, position.z) == (*place, 0.0)
        assert (turn.x, turn.y) == (0.0, 0.0)
        assert 1 - 2 * turn.z**2 == pytest.approx(math.cos(heading_rad), abs=1e-11)
        assert 2 * turn.w * turn.z == pytest.approx(math.sin(heading_rad), abs=1e-11)


def test_times_before_1970_and_values_that_are_not_finite_are_encoded_all_the_same() -> None:
    pose = a_pose(0.0, math.inf, math.nan, heading_rad=math.inf, position_bound_m=math.inf)
    transform = FrameTransform.FromString(PoseEncoder("a", "b").transform(pose, -1))
    assert (transform.timestamp.seconds, transform.timestamp.nanos) == (-1, 999_999_999)
    assert math.isnan(transform.rotation.w)
    scene = Scene("a", "b")
    scene.add(pose)
    assert path_of(scene, pose) == []
    scene.add(a_pose(0.0, 1e308, -1e308))
    assert len(path_of(scene, pose)) == 1


def test_the_scene_has_the_path_in_the_fixed_frame_and_the_bound_around_the_robot() -> None:
    scene = Scene("odom", "base_link")
    for i in range(3):
        scene.add(a_pose(float(i), 0.5 * i, -0.25 * i))
    path, bound = SceneUpdate.FromString(scene.encode(a_pose(2.0, 1.0, -0.5), WALL_NS)).entities
    assert (path.frame_id, path.id, path.frame_locked) == ("odom", "path", False)
    assert [(p.x, p.y, p.z) for p in path.lines[0].points] == [(0.0, 0.0, 0.0), (0.5, -0.25, 0.0), (1.0, -0.5, 0.0)]
    assert (path.lines[0].type, path.lines[0].scale_invariant, path.lines[0].color.a) == (0, True, 1.0)
    assert (bound.frame_id, bound.id, bound.frame_locked) == ("base_link", "bound", True)
    assert {(entity.timestamp.ToNanoseconds(), entity.lifetime.seconds) for entity in (path, bound)} == {(WALL_NS, 0)}
    (disc,) = bound.cylinders
    assert (disc.size.x, disc.size.y, disc.bottom_scale, disc.top_scale) == (0.5, 0.5, 1.0, 1.0)
    assert {shape.pose.orientation.w for shape in (disc, path.lines[0])} == {1.0}


@pytest.mark.parametrize("validity", Validity)
def test_the_discs_colour_is_that_of_the_validity(validity: Validity) -> None:
    data = Scene("odom", "base_link").encode(a_pose(validity=validity), WALL_NS)
    colour = SceneUpdate.FromString(data).entities[1].cylinders[0].color
    assert (colour.r, colour.g, colour.b, colour.a) == BOUND_COLOURS[validity]


def test_a_short_path_has_every_step_of_it() -> None:
    scene = Scene("odom", "base_link")
    points = path_of(scene, driven(scene, 20.0))
    steps = [math.dist(a, b) for a, b in itertools.pairwise(points)]
    assert points[0] == (0.0, 0.0)
    assert min(steps) > FIRST_STEP_M - 2 * GRID_M
    assert max(steps) < FIRST_STEP_M + 0.02 + 2 * GRID_M


def test_a_long_path_is_thinned_from_its_beginning_to_its_end() -> None:
    scene = Scene("odom", "base_link")
    pose = driven(scene, 300.0)
    points = path_of(scene, pose)
    steps = [math.dist(a, b) for a, b in itertools.pairwise(points)]
    assert MOST_POINTS / 3 < len(points) <= MOST_POINTS
    assert points[0] == (0.0, 0.0)
    assert math.dist(points[-1], (pose.x_m, pose.y_m)) < 1.0
    assert max(steps) < 4 * 300.0 / MOST_POINTS
    radius_m = 300.0 / (0.5 * math.pi)
    assert max(abs(math.dist(p, (0.0, radius_m)) - radius_m) for p in points) < 2 * GRID_M


def test_a_robot_that_stands_adds_no_point() -> None:
    scene = Scene("odom", "base_link")
    for i in range(100):
        scene.add(a_pose(0.05 * i, 0.01 * math.sin(i), 0.0, speed_m_s=0.0))
    assert len(path_of(scene, a_pose())) == 1


def test_after_a_jump_the_path_begins_anew() -> None:
    scene = Scene("odom", "base_link")
    driven(scene, 300.0)
    at = a_pose(300.05, -7.0, 3.0)
    scene.add(at)
    assert path_of(scene, at) == [(-7.0, 3.0)]
    for i in range(1, 11):
        scene.add(a_pose(300.05 + 0.1 * i, -7.0 + 0.1 * i, 3.0))
    assert len(path_of(scene, at)) == 11


def test_poses_that_come_late_are_no_jump() -> None:
    scene = Scene("odom", "base_link")
    scene.add(a_pose(0.0, 0.0, 0.0))
    scene.add(a_pose(10.0, 8.0, 0.0))
    assert path_of(scene, a_pose()) == [(0.0, 0.0), (8.0, 0.0)]
