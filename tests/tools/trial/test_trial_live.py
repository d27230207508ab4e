"""The blind trial of the monitor: drawn again to the bit, sized as asked, scored and written."""

from pathlib import Path

import msgspec
import numpy as np
import pytest

from drd_tools.trial import live, live_cases, live_figures
from drd_tools.trial.command import main
from drd_tools.trial.live import Kept, LiveRow, Said
from drd_tools.trial.score import calibration_error, exact_error


def row(kind: str, said: list[Said], d: float = 12.0) -> LiveRow:
    case = live_cases.Case(f"{kind}-d12-000", kind, d, 0)
    return LiveRow(case=case, begin_s=100.0, limit_s=180.0, hours=0.1, said=said)


def test_each_effect_is_drawn_at_each_distance_and_each_null_as_often_as_asked() -> None:
    cases = live_cases.cases(2, 3, 0)
    assert sum(c.kind == "plain" for c in cases) == 3
    assert [c.d for c in cases if c.kind == "tread_error"] == [8.0, 12.0, 25.0] * 2
    assert not any(c.kind in ("lateral_slip_turning", "gyro_warmup") for c in cases)
    assert len({c.name for c in cases}) == len(cases)


def test_a_case_is_drawn_again_to_the_bit_and_has_the_distance_that_is_asked_for() -> None:
    case = live_cases.Case("wheel_radius_error-d25-000", "wheel_radius_error", 25.0, 7)
    one, two = live_cases.drawn(case), live_cases.drawn(case)
    assert one is not None
    assert two is not None
    assert one.values == two.values
    assert one.recording.encoders.left_counts is not None
    assert two.recording.encoders.left_counts is not None
    assert (one.recording.encoders.left_counts == two.recording.encoders.left_counts).all()
    assert one.begin_s is not None
    assert one.begin_s < one.limit_s


@pytest.mark.parametrize(
    ("name", "kind", "seed"),
    [
        ("null-asphalt-032", "asphalt", 751),
        ("null-asphalt-020", "asphalt", 712),
        ("null-asphalt-121", "asphalt", 781),  # in a long turn on the spot it looks like a bias
        ("null-stressed-045", "stressed", 781),  # one reading far off in a moment's stop
    ],
)
def test_a_tread_that_wanders_and_a_reading_far_off_are_no_effect(name: str, kind: str, seed: int) -> None:
    assert live.judged(live_cases.Case(name, kind, 0.0, seed)).said == []


@pytest.mark.parametrize("name", ["null-floors-004", "null-floors-005"])
def test_a_floor_that_begins_and_ends_within_segments_leaves_nothing_else_to_name(name: str) -> None:
    (said,) = live.judged(live_cases.Case(name, "floors", 0.0, 760)).said
    assert not said.is_wrong


def test_only_what_was_right_all_the_time_counts_and_only_in_time() -> None:
    right = Said("tread_error", (), 0.9, 150.0, 102.0, False)
    late = Said("terrain_tread", ("tread_error",), 0.6, 300.0, 110.0, False)
    wrong = Said("gyro_lag", (), 0.9, 150.0, 102.0, True)
    rows = [
        row("tread_error", [right]),
        row("tread_error", [late]),
        row("tread_error", [wrong]),
        row("tread_error", []),
    ]
    by_d = live_figures.tables(rows)[0].rows[0]
    assert by_d[:3] == ["d=12", "4", "0.25"]
    assert by_d[5] == "0.25"
    assert by_d[6] == "0.50"
    assert by_d[8] == "1"
    assert len(live_figures.lines(rows)) == 3


def test_the_command_writes_results_that_are_read_again(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["--live", "1", "--only", "encoder_dropout-*", "--seed", "3", "--jobs", "1", "--output", str(tmp_path)]
    assert main(arguments) == 0
    told = msgspec.json.decode((tmp_path / "live.jsonl").read_bytes(), type=LiveRow)
    assert told.right is not None
    assert told.right.effect == "encoder_dropout"
    assert "events" in capsys.readouterr().out
    assert (tmp_path / "live.html").exists()


def test_the_modes_of_the_trial_do_not_mix(tmp_path: Path) -> None:
    with pytest.raises(SystemExit):
        main(["--live", "1", "--each", "1", "--output", str(tmp_path)])


def test_what_is_told_as_unknown_in_time_counts_beside_what_is_named() -> None:
    unknown = Said("unknown", (), 0.9, 150.0, 102.0, False)
    line = live_figures.tables([row("tread_error", [unknown]), row("tread_error", [])])[0].rows[0]
    assert (line[2], line[5]) == ("0.00", "0.50")


def test_a_name_that_was_wrong_for_some_time_is_as_probable_as_it_is_in_the_end() -> None:
    late_right = Said("tread_error", (), 1.0, 150.0, 102.0, True)
    honesty = live_figures.tables([row("tread_error", [late_right])])[3]
    assert honesty.rows[1][1] == "0.000 of 1"


def test_the_ceiling_is_what_a_likelihood_ratio_of_known_form_and_size_reaches() -> None:
    # A thousand hours, some twenty effects, onsets of 4 s alike: ln 2e7 = 16.8 of the 32 that d = 8 has on average.
    assert live_figures.ceiling(8.0, 60.0) == pytest.approx(0.97, abs=0.01)
    assert live_figures.ceiling(12.0, 60.0) > 0.999
    assert live_figures.ceiling(5.0, 60.0) < 0.3
    assert live_figures.ceiling(0.0, 60.0) == 0.0


@pytest.mark.parametrize(("count", "most"), [(0, 2.996), (2, 6.296), (10, 16.962)])
def test_so_many_are_the_most_that_leave_few_by_chance(count: int, most: float) -> None:
    assert live_figures.most_by_chance(count) == pytest.approx(most, abs=1e-3)


def test_what_a_memory_knows_of_the_robot_lets_an_effect_be_seen_better() -> None:
    name = "wheel_radius_error-d12-000"
    with_memory, without = (
        live_cases.drawn(live_cases.Case(name, "wheel_radius_error", 12.0, 7, x)) for x in (True, False)
    )
    assert with_memory is not None
    assert without is not None
    assert 0.0 < without.seen_d < with_memory.seen_d < 12.5


def test_few_exact_probabilities_have_an_error_by_chance() -> None:
    rng = np.random.default_rng(0)
    p = rng.uniform(size=60)
    drawn = [calibration_error(list(zip(p, rng.uniform(size=60) < p, strict=True))) for _ in range(300)]
    assert exact_error(p.tolist()) == pytest.approx(np.mean(drawn), rel=0.1)


@pytest.mark.parametrize(("name", "seed"), [("null-floors-020", 712), ("null-floors-006", 715)])
def test_a_floor_is_named_from_the_first_turn_on_it_and_nothing_beside_it(name: str, seed: int) -> None:
    told = live.judged(live_cases.Case(name, "floors", 0.0, seed))
    assert told.is_timely
    assert not any(s.is_wrong for s in told.said)


def test_of_a_clock_that_drifts_the_interval_knows_that_its_onset_is_unsure() -> None:
    told = live.judged(live_cases.Case("gyro_sample_clock-d12-000", "gyro_sample_clock", 12.0, 731))
    assert len(told.sigmas) == 1
    assert abs(told.sigmas[0]) < 2.5


def test_a_stopped_trial_goes_on_with_the_cases_that_are_not_there(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    arguments = ["--live", "1", "--only", "encoder_dropout-*", "--seed", "3", "--jobs", "1", "--output", str(tmp_path)]
    there = row("tread_error", [])
    kept = Kept(tmp_path)
    assert kept.begin() == set()
    kept.add(there)
    with (tmp_path / "live.jsonl").open("ab") as cut_off:
        cut_off.write(b'{"case":')
    assert main(arguments) == 0
    assert "1 cases are there already" in capfd.readouterr().err
    assert [r.case.kind for r in kept.read()] == ["tread_error", "encoder_dropout"]
    assert main(["--draw", str(tmp_path)]) == 0
    assert "seed 0, 3: 2 cases" in (tmp_path / "live.html").read_text()


def test_results_of_another_build_are_moved_aside(tmp_path: Path) -> None:
    (tmp_path / "live.jsonl").write_bytes(msgspec.json.encode(row("tread_error", [])) + b"\n")
    assert Kept(tmp_path).begin() == set()
    assert (tmp_path / "live.old.jsonl").exists()


@pytest.mark.parametrize(
    ("name", "d"), [("gyro_scale_nonlinearity-d25-001", 25.0), ("gyro_scale_nonlinearity-d12-002", 12.0)]
)
def test_a_slow_robots_gyro_that_errs_by_rate_is_no_tread_that_wanders(name: str, d: float) -> None:
    told = live.judged(live_cases.Case(name, "gyro_scale_nonlinearity", d, 782 if d == 25.0 else 787))
    assert told.said[-1].effect == "gyro_scale_nonlinearity"
    assert told.said[-1].probability > 0.9
