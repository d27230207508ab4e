"""Linear recursions `x' = A x + v` of many columns: in blocks side by side, then from block to block."""

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


class Recursion:
    """Steps with matrices A, (n, k, k). About sqrt(n) calls follow each other instead of n."""

    def __init__(self, A: Array):
        n, k, _ = A.shape
        length = max(1, round(n**0.5))
        count = -(-n // length)
        self._n = n
        self._A = np.tile(np.eye(k), (count * length, 1, 1))
        self._A[:n] = A
        self._A = self._A.reshape(count, length, k, k)
        # What the state at a block's begin makes of the state before each of its steps, and at its end.
        self._within = np.empty_like(self._A)
        self._across = np.tile(np.eye(k), (count, 1, 1))
        for j in range(length):
            self._within[:, j] = self._across
            self._across = self._A[:, j] @ self._across

    def states(self, v: Array, start: Array | float = 0.0) -> tuple[Array, Array]:
        """State before each step, (n, k, p), and after the last, (k, p). `v`: (n, k, p); `start`: (k, p) or 0."""
        count, length, k, _ = self._A.shape
        p = v.shape[2]
        inputs = np.zeros((count * length, k, p))
        inputs[: self._n] = v
        inputs = inputs.reshape(count, length, k, p)
        states = np.empty_like(inputs)
        x = np.zeros((count, k, p))
        for j in range(length):
            states[:, j] = x
            x = self._A[:, j] @ x
            x += inputs[:, j]
        begin = np.empty((count, k, p))
        at = np.zeros((k, p)) + start
        for b in range(count):
            begin[b] = at
            at = self._across[b] @ at + x[b]
        states += self._within @ begin[:, None]
        return states.reshape(count * length, k, p)[: self._n], at
