"""Linear recursions in blocks: the same as step by step."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from drd_tools.diagnose.error_model.recursion import Recursion, StateSpace


@settings(deadline=None)
@given(st.integers(1, 60), st.integers(1, 4), st.integers(1, 3), st.integers(0, 2**32 - 1), st.booleans())
def test_blocks_give_what_single_steps_give(n: int, k: int, p: int, seed: int, begins: bool) -> None:
    rng = np.random.default_rng(seed)
    A, v = rng.standard_normal((n, k, k)) * 0.5, rng.standard_normal((n, k, p))
    x = start = rng.standard_normal((k, p)) * begins
    before = []
    for i in range(n):
        before.append(x)
        x = A[i] @ x + v[i]
    states, last = Recursion(A).states(v, start)
    scale = max(1.0, float(np.abs(before).max()), float(np.abs(x).max()))
    np.testing.assert_allclose(states, before, rtol=0.0, atol=1e-12 * scale)
    np.testing.assert_allclose(last, x, rtol=0.0, atol=1e-12 * scale)


def test_states_that_grow_without_bound_stay_exact() -> None:
    # An error that is never corrected adds up over hours.
    n = 40000
    states, last = Recursion(np.ones((n, 1, 1))).states(np.ones((n, 1, 1)))
    np.testing.assert_array_equal(states[:, 0, 0], np.arange(n))
    assert last[0, 0] == n


@settings(deadline=None)
@given(st.integers(1, 40), st.integers(1, 3), st.integers(1, 3), st.integers(1, 2), st.integers(0, 2**32 - 1))
def test_outputs_of_a_state_space_are_those_of_single_steps(n: int, k: int, q: int, o: int, seed: int) -> None:
    rng, p = np.random.default_rng(seed), 3
    A, B, C, D = (rng.standard_normal((n, *shape)) * 0.5 for shape in ((k, k), (k, q), (o, k), (o, q)))
    s = rng.standard_normal((rng.integers(1, q + 1), p, n))
    full = np.concatenate([s, np.zeros((q - len(s), p, n))])
    x, expected = np.zeros((k, p)), np.empty((p, n, o))
    for i in range(n):
        expected[:, i] = (C[i] @ x + D[i] @ full[:, :, i]).T
        x = A[i] @ x + B[i] @ full[:, :, i]
    scale = max(1.0, float(np.abs(expected).max()))
    np.testing.assert_allclose(StateSpace(A, B, C, D).outputs(s), expected, rtol=0.0, atol=1e-12 * scale)
