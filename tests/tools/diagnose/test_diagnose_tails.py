"""Heavy tails of the wheels' rows: seen where they are, and left alone where noise is Gaussian. (78)"""

import numpy as np
import pytest

from drd_tools.diagnose.regression.noise_fit import tails

ROWS = 4000


@pytest.mark.parametrize("seed", range(5))
def test_gaussian_rows_are_left_as_they_are(seed: int) -> None:
    rows = np.random.default_rng(seed).normal(0.0, 0.7, ROWS)
    assert np.array_equal(tails(rows, np.ones(ROWS, bool)), 1.0)


@pytest.mark.parametrize("seed", range(5))
def test_rows_of_students_t_get_the_weight_that_their_likelihood_gives_them(seed: int) -> None:
    """Weighted least squares then finds the middle of rows better than their mean does."""
    random = np.random.default_rng(seed)
    rows, moving = random.standard_t(3.0, ROWS), np.arange(ROWS) % 10 > 0
    found = np.asarray(tails(rows, moving))
    assert np.all(found[~moving] == 1.0)
    assert found[moving] == pytest.approx(np.sqrt(1.0 + rows[moving] ** 2 / 3.0), rel=0.15)


def test_the_middle_of_rows_with_heavy_tails_is_found_better() -> None:
    errors = []
    for seed in range(100):
        rows = np.random.default_rng(seed).standard_t(2.5, 400)
        weights = np.broadcast_to(tails(rows, np.ones(400, bool)), rows.shape) ** -2.0
        errors.append((rows.mean(), np.average(rows, weights=weights)))
    mean, weighted = np.sqrt(np.mean(np.square(errors), axis=0))
    assert weighted < 0.8 * mean
