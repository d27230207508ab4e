"""A small relative of SBMI (Schroeder and Macke 2023, arXiv 2305.15174): effects learned from simulations.

Like SBMI it is amortised: models are drawn from a prior over sets of effects and their sizes and simulated by the
trial's own generator, and a classifier learns the posterior probability that each effect is included, once for all
drives. Unlike SBMI it does not learn its summary statistics: it has a fixed list of them, computed from the same
residual and library as the other methods. Each effect's inclusion is learned separately, by an ensemble of boosted
trees, where SBMI has a joint distribution; and there is no posterior of the parameters, for which SBMI has a mixture
density network. It has one advantage over all other methods: it knows the distribution from which the trial draws.
"""

import math
from collections.abc import Sequence
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, Final

import numpy as np

from drd.arrays import Array
from drd.effects.catalogue import catalogue
from drd_tools.trial.baselines import Regression, forward, regress
from drd_tools.trial.draw import make
from drd_tools.trial.plan import STRESSED, Drawing, reversible
from drd_tools.trial.workers import completed

METHOD, PACKAGE = "SBMI", "sklearn"
FILE: Final = "sbmi.npz"
COUNTS: Final = (0.35, 0.35, 0.15, 0.15)  # prior of none to three effects, roughly as in a trial
DISTANCES: Final = (6.0, 30.0)  # of d, log-uniform
MODELS: Final = 5
ROUNDS: Final = 120  # of boosting
INCLUDED: Final = 0.5
APART: Final = 1e-3  # of a column's square that another must leave


def train(file: Path, count: int, seed: int, minutes: tuple[float, float], jobs: int) -> None:
    """Simulate `count` drives, and save their features (count, effects, f) and true effects. Raises OSError.

    An existing file is kept: training takes as long as a trial.
    """
    if file.exists():
        return
    calls = [partial(simulated, number, seed, minutes) for number in range(count)]
    made = [pair for pair in completed(calls, jobs) if pair is not None]
    file.parent.mkdir(parents=True, exist_ok=True)
    np.savez_compressed(file, features=np.array([x for x, _ in made]), there=np.array([y for _, y in made]))


def simulated(number: int, seed: int, minutes: tuple[float, float]) -> tuple[Array, Array] | None:
    """Features of a drive drawn from the prior, and 1 for each effect in it; None if no drive shows them."""
    random = np.random.default_rng([seed, number])
    names = reversible()
    chosen = random.choice(len(names), int(random.choice(len(COUNTS), p=COUNTS)), replace=False)
    effects = tuple(names[i] for i in chosen)
    low, high = DISTANCES
    d = low * (high / low) ** float(random.random()) if effects else 0.0
    kind = STRESSED if random.random() < 0.5 else "plain"
    try:
        case = make(Drawing(f"training-{number}", kind, effects, d, seed, minutes), judged=False)
    except ValueError:
        return None
    return features(regress(case.recording)), np.array([float(name in effects) for name in catalogue()])


def features(r: Regression) -> Array:
    """Summary statistics of a drive for each effect of the catalogue, (effects, f).

    Per effect: its gain alone and beside the best other, in nats, as if the rows' noise were independent; its size by
    forward selection; its rank; its number. Per drive: rows, gain of the best, number selected, and all gains.
    """
    n, names = len(r.y), list(catalogue())
    index = np.array([names.index(e) for e in r.effects])

    def largest(values: Array) -> Array:
        """The largest value among each effect's columns."""
        most = np.zeros(len(names))
        np.maximum.at(most, index, values)
        return most

    products = r.X.T @ r.y / n  # correlations, since columns and residual have unit rms
    alone, size = largest(_nats(products**2, n)), largest(np.abs(forward(r)))
    first, second = (int(k) for k in np.argsort(-alone)[:2])

    def beside_best(name: int) -> Array:
        """Gain of each effect beside the best column of one."""
        best = int(np.argmax(np.where(index == name, np.abs(products), -1.0)))
        shared = r.X.T @ r.X[:, best] / n
        free = 1.0 - shared**2
        rest = np.where(free > APART, (products - shared * products[best]) ** 2 / np.maximum(free, APART), 0.0)
        return largest(_nats(rest / (1.0 - products[best] ** 2), n))

    beside = beside_best(first)
    beside[first] = beside_best(second)[first]
    rank = np.argsort(np.argsort(-alone)).astype(float)
    own = np.column_stack([np.arange(len(names)), np.log1p(alone), np.log1p(beside), size, rank])
    drive = [math.log(n), math.log1p(float(alone.max())), float((size > 0.0).sum()), *np.log1p(alone)]
    return np.hstack([own, np.tile(drive, (len(names), 1))])


def _nats(share: Array, n: int) -> Array:
    """Gain in nats of a column that explains a share of the variance of n rows."""
    return -0.5 * n * np.log1p(-np.clip(share, 0.0, 1.0 - 1e-9))


def inclusion(r: Regression, file: Path) -> dict[str, float]:
    """Posterior probability of each effect."""
    x = features(r)
    p = np.mean([model.predict_proba(x)[:, 1] for model in _ensemble(file)], axis=0)
    return dict(zip(catalogue(), p.tolist(), strict=True))


def selected(r: Regression, file: Path) -> list[str]:
    """Effects more likely present than not, the likeliest first."""
    p = inclusion(r, file)
    return sorted((name for name in p if p[name] > INCLUDED), key=lambda name: -p[name])


@lru_cache(maxsize=1)
def _ensemble(file: Path) -> Sequence[Any]:
    """Train boosted trees, each on another bootstrap sample of the drives."""
    from sklearn.ensemble import HistGradientBoostingClassifier  # noqa: PLC0415  # an optional extra
    from threadpoolctl import threadpool_limits  # noqa: PLC0415  # comes with scikit-learn

    with np.load(file) as kept:
        X, there = kept["features"], kept["there"]
    models = []
    for k in range(MODELS):
        drawn = np.random.default_rng(k).integers(len(X), size=len(X))
        model: Any = HistGradientBoostingClassifier(
            max_iter=ROUNDS, learning_rate=0.06, l2_regularization=1.0, categorical_features=[0], random_state=k
        )
        with threadpool_limits(1):  # the trial's processes fill all cores already
            models.append(model.fit(X[drawn].reshape(-1, X.shape[2]), there[drawn].ravel()))
    return models
