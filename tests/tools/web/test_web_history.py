"""The last hour in memory of a fixed size."""

import numpy as np
from web_robot import pose_payload

from drd_tools.web.history import _EVENTS, COLUMNS, PERIOD_S, SPAN_S, History
from drd_tools.web.messages import Pose, Reason, read_pose

TIME, X = COLUMNS.index("time_s"), COLUMNS.index("x_m")


def pose(x_m: float = 0.0, validity: str = "valid", reasons: tuple[str, ...] = ()) -> Pose:
    made = read_pose(pose_payload(x_m=x_m, validity=validity))
    assert made is not None
    made.reasons = [Reason(source, f"{source} is wrong", 1.0) for source in reasons]
    return made


def test_a_row_holds_the_pose() -> None:
    history = History()
    history.add(5.0, pose(3.25, "degraded"))
    (row,) = history.rows()
    found = dict(zip(COLUMNS, row, strict=True))
    assert found["time_s"] == 5.0
    assert found["x_m"] == 3.25
    assert (found["variance_x_m2"], found["covariance_xy_m2"], found["variance_y_m2"]) == (0.04, 0.01, 0.09)
    assert (found["variance_heading_rad2"], found["bound_m"], found["validity"]) == (1e-4, 0.9, 2)


def test_more_poses_than_rows_are_thinned_evenly() -> None:
    history = History()
    for i in range(1001):
        history.add(0.1 * i, pose())
    times_s = history.rows()[:, TIME]
    assert len(times_s) == 501
    np.testing.assert_allclose(np.diff(times_s), PERIOD_S, atol=1e-9)


def test_after_two_hours_the_last_one_is_there_in_order_and_the_memory_has_not_grown() -> None:
    history = History()
    before = history._ring.nbytes
    for i in range(2 * round(SPAN_S / PERIOD_S) + 17):
        history.add(PERIOD_S * i, pose(float(i)))
    rows = history.rows()
    assert rows[-1, X] == 2 * SPAN_S / PERIOD_S + 16
    assert (np.diff(rows[:, X]) == 1.0).all()
    assert SPAN_S - 2 * PERIOD_S <= rows[-1, TIME] - rows[0, TIME] <= SPAN_S
    assert history._ring.nbytes == before


def test_what_is_older_than_the_hour_is_left_out_after_a_silence() -> None:
    history = History()
    history.add(0.0, pose())
    history.add(SPAN_S + 1.0, pose())
    assert list(history.rows()[:, TIME]) == [SPAN_S + 1.0]


def test_each_change_of_validity_or_sources_is_an_event_and_nothing_else() -> None:
    history = History()
    assert history.add(0.0, pose()) == {"time_s": 0.0, "validity": "valid", "reasons": []}
    assert history.add(1.0, pose()) is None
    event = history.add(2.0, pose(validity="degraded", reasons=("fog",)))
    assert event == {"time_s": 2.0, "validity": "degraded", "reasons": [{"source": "fog", "text": "fog is wrong"}]}
    assert history.add(3.0, pose(validity="degraded", reasons=("fog",))) is None
    assert history.add(4.0, pose(validity="degraded", reasons=("fog", "bias"))) is not None
    assert [e["time_s"] for e in history.events()] == [0.0, 2.0, 4.0]


def test_each_event_has_a_row_and_many_of_them_do_not_delay_the_others() -> None:
    history = History()
    for i in range(40):
        history.add(0.05 * i, pose(validity="valid" if i % 2 else "degraded"))
    assert len(history.rows()) == 40
    for i in range(40, 60):
        history.add(0.05 * i, pose())
    assert len(history.rows()) == 45


def test_events_are_bounded_and_the_one_that_held_an_hour_ago_is_kept() -> None:
    history = History()
    for time_s, validity in ((0.0, "valid"), (10.0, "degraded"), (20.0, "valid"), (SPAN_S + 15.0, "invalid")):
        history.add(time_s, pose(validity=validity))
    assert [e["time_s"] for e in history.events()] == [10.0, 20.0, SPAN_S + 15.0]
    for i in range(3 * _EVENTS):
        history.add(SPAN_S + 20.0 + i, pose(reasons=(f"source {i}",)))
    assert len(history.events()) == _EVENTS
