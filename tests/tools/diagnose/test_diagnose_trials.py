"""The shared trials with known answers: five that are cheap, one of each kind."""

import json
from pathlib import Path

import pytest

from drd_tools.diagnose.analysis import analyse
from drd_tools.diagnose.conclude import outcome
from drd_tools.recordings.folder import read_recording

TRIALS = Path(__file__).resolve().parents[4] / "shared/trials"
NUMBERS = (1, 4, 16, 29, 34)  # gyro scale, bias by temperature, tread, a dropout, nothing


def answer(case: str) -> list[str]:
    rows = json.loads((TRIALS / "answers.json").read_text())
    return next([e["effect"] for e in row["effects"]] for row in rows if row["case"] == case)


@pytest.mark.recordings
@pytest.mark.skipif(not (TRIALS / "answers.json").exists(), reason="no shared trials")
@pytest.mark.parametrize("case", [f"case_{n:03d}" for n in NUMBERS])
def test_verdict_and_names_are_those_of_the_answers(case: str) -> None:
    conclusion = analyse(read_recording(TRIALS / case)).conclusion
    expected = answer(case)
    assert outcome.verdict(conclusion) == ("explained" if expected else "nothing_missing")
    assert sorted(f.effect for f in conclusion.causes) == sorted(expected)
