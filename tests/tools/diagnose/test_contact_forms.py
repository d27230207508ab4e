"""A form of contact is told from others by how it predicts drives that it was not fitted to."""

import numpy as np
import pytest
from contact_forms import FORMS, Drive, judged, late, read_drive
from diagnosis_drives import selected

from drd_tools.diagnose.selected import Selected
from drd_tools.simulate.conditions import Conditions
from drd_tools.simulate.missions import make_drive
from drd_tools.simulate.robot import DEFAULT
from drd_tools.simulate.simulator import simulate
from drd_tools.simulate.truth import make_truth

SEEDS = (1, 2, 3)


def drives(*effects: Selected) -> list[Drive]:
    true = [(s.effect, s.values) for s in effects]
    truth = make_truth(make_drive("slalom", 60.0))
    return [read_drive(simulate(truth, DEFAULT, true, Conditions(), seed=seed).recording, 0.0) for seed in SEEDS]


def test_what_is_there_gains_in_every_unseen_drive_and_what_is_unlike_does_not() -> None:
    made = drives(selected("lateral_slip_turning", k=0.1))
    gains = {name: judged(made, form)[0] for name, form in FORMS.items()}
    best = sorted(gains, key=lambda name: -float(np.mean(gains[name])))[:2]
    assert set(best) == {"lateral slip, v w", "lateral slip, v^2 w"}  # in a slalom the speed hardly changes
    assert min(gains["lateral slip, v w"]) > 0.0


def test_the_path_is_better_with_what_is_there() -> None:
    made = drives(selected("lateral_slip_turning", k=0.1))
    _, without_m, _ = judged(made, None)
    _, with_m, _ = judged(made, FORMS["lateral slip, v w"])
    assert np.median(with_m) < 0.8 * np.median(without_m)


@pytest.mark.parametrize("name", ["encoder_lag", "encoder_latency"])
def test_a_lag_is_told_from_a_delay(name: str) -> None:
    effect = selected(name, **{"encoder_lag": {"tau": 0.2}, "encoder_latency": {"delay": 0.2}}[name])
    gains = late(drives(effect), 0)["delay and lag"]  # a count is half a sample late besides
    assert (min(gains) > 10.0) if name == "encoder_lag" else (max(gains) < 5.0)
