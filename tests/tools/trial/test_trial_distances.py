"""How far manoeuvres set all effects apart."""

import csv
import json
from pathlib import Path

import numpy as np
import pytest

from drd.cli import main
from drd.effects.catalogue import catalogue
from drd_tools.diagnose.advise.manoeuvres import MANOEUVRES
from drd_tools.diagnose.results import NOTHING
from drd_tools.trial import distances
from drd_tools.trial.distance_page import text, write_page
from drd_tools.trial.distances import SIZE, Distances, Measured, calls, measured

SPINS, CIRCLES, *_ = MANOEUVRES
STANDING = next(m for m in MANOEUVRES if m.startswith("standing"))


def made(manoeuvre: str, effect: str, **others: float) -> Measured:
    return Measured(manoeuvre, effect, {"k": 0.01}, 12.0, others)


def test_tread_and_scrub_part_in_circles_and_not_in_turns_on_the_spot() -> None:
    near = {m: measured(m, "tread_error", 0).distances["turn_scrub"] for m in (SPINS, CIRCLES)}
    assert near[SPINS] < 0.5
    assert near[CIRCLES] > near[SPINS] + 1.0


def test_an_effect_is_as_large_as_asked_for_and_a_standstill_shows_no_wheels() -> None:
    step = measured(STANDING, "gyro_bias_step", 0)
    assert step.size == pytest.approx(SIZE, rel=0.02)
    assert set(step.distances) == {NOTHING, *catalogue()} - {"gyro_bias_step"}
    assert step.distances["tread_error"] == pytest.approx(step.size, abs=0.01)
    assert measured(STANDING, "tread_error", 0).distances == {}


def test_a_pair_is_as_near_as_its_nearer_way_round_in_the_best_manoeuvre() -> None:
    found = Distances(
        [
            made(CIRCLES, "tread_error", turn_scrub=3.0, gyro_lag=11.0),
            made(CIRCLES, "turn_scrub", tread_error=2.0),
            made(SPINS, "tread_error", turn_scrub=0.1, gyro_lag=11.5),
            made(SPINS, "turn_scrub"),
        ]
    )
    assert found.manoeuvres == [SPINS, CIRCLES]
    closest, other = found.pairs()
    assert (set(closest.names), closest.by_manoeuvre) == ({"tread_error", "turn_scrub"}, {SPINS: 0.1, CIRCLES: 2.0})
    assert (closest.best, closest.worst, closest.farthest, other.farthest) == (CIRCLES, SPINS, 2.0, 11.5)
    i, k = (found.names.index(name) for name in ("tread_error", "turn_scrub"))
    assert found.best()[i, k] == 3.0
    assert np.isnan(found.matrix(SPINS)[k]).all()
    assert (found.alike(SPINS), found.unseen(SPINS)) == (1, ["turn_scrub"])


def test_all_of_it_is_written_and_drawn(tmp_path: Path) -> None:
    found = Distances([made(CIRCLES, "tread_error", turn_scrub=2.0), made(CIRCLES, "turn_scrub", tread_error=1.5)])
    files = write_page(found, tmp_path)
    assert all(f.stat().st_size for f in files)
    assert (tmp_path / "distances.html").read_text().count("data:image/png") == 2
    with (tmp_path / "distances.csv").open() as lines:
        rows = list(csv.reader(lines))
    assert rows[1:] == [
        [CIRCLES, "tread_error", "12.0", "turn_scrub", "2.0"], [CIRCLES, "turn_scrub", "12.0", "tread_error", "1.5"],
    ]  # fmt: skip
    assert len(json.loads((tmp_path / "distances.json").read_text())["rows"]) == 2
    assert "tread_error  turn_scrub     0.77        1.50   1" in text(found)


def test_from_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(distances, "calls", lambda seed: calls(seed, [STANDING])[13:16])
    assert main(["trial", "--distances", "--jobs", "1", "--output", str(tmp_path / "out")]) == 0
    assert "closest pairs" in capsys.readouterr().out
    assert (tmp_path / "out" / "distances_1.png").exists()
    with pytest.raises(SystemExit, match="2"):
        main(["trial", "--distances", "--each", "1", "--output", str(tmp_path / "out")])
