"""The classifier that learns from simulations which effects are there."""

from pathlib import Path

import numpy as np
import pytest

from drd.effects.catalogue import catalogue
from drd_tools.trial import sbmi
from drd_tools.trial.baselines import Regression
from drd_tools.trial.plan import reversible

NAMES = list(catalogue())
Random = np.random.Generator


def regression(random: Random, *there: int) -> Regression:
    """A residual of noise, and of the columns of some effects, one each."""
    X = random.normal(size=(200, len(NAMES)))
    y = random.normal(size=200) + X[:, list(there)].sum(axis=1)
    return Regression(y / np.sqrt(np.mean(y**2)), X / np.sqrt(np.mean(X**2, axis=0)), NAMES)


def test_a_drive_is_drawn_from_its_number_and_has_features_for_each_effect() -> None:
    first, again = (sbmi.simulated(1, 5, (1.5, 1.6)) for _ in range(2))
    assert first is not None
    assert again is not None
    np.testing.assert_array_equal(first[0], again[0])
    assert first[0].shape[0] == len(first[1]) == len(NAMES)
    assert np.isfinite(first[0]).all()
    assert {NAMES[i] for i in np.flatnonzero(first[1])} <= set(reversible())


def test_what_hides_behind_another_is_seen_beside_it() -> None:
    r = regression(np.random.default_rng(0), 3, 8)
    x = sbmi.features(r)
    alone, beside = x[:, 1], x[:, 2]
    assert set(np.argsort(-alone)[:2]) == {3, 8}
    assert all(beside[k] > alone[k] for k in (3, 8))  # the other is noise to it


def test_it_learns_which_are_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip(sbmi.PACKAGE)
    monkeypatch.setattr(sbmi, "MODELS", 2)
    monkeypatch.setattr(sbmi, "ROUNDS", 40)
    random = np.random.default_rng(1)
    sets = [tuple(random.choice(len(NAMES), n, replace=False)) for n in random.integers(0, 3, size=60)]
    there = np.zeros((len(sets), len(NAMES)))
    for row, chosen in zip(there, sets, strict=True):
        row[list(chosen)] = 1.0
    X = np.array([sbmi.features(regression(random, *chosen)) for chosen in sets])
    file = tmp_path / sbmi.FILE
    np.savez_compressed(file, features=X, there=there)
    sbmi.train(file, 10**9, 0, (1.0, 1.0), 1)  # what is there stays
    assert set(sbmi.selected(regression(random, 4, 20), file)) == {NAMES[4], NAMES[20]}
    assert sbmi.selected(regression(random), file) == []
    p = sbmi.inclusion(regression(random, 7), file)
    assert p.pop(NAMES[7]) > 0.8
    assert max(p.values()) < 0.3
