"""Linear recursions `x' = A x + v` of many columns: within all blocks in parallel, then from block to block."""

from typing import Final

import numpy as np

from drd.arrays import Array

BLOCK: Final = 8  # steps: longer ones cost more products, shorter ones more calls


class Recursion:
    """Recursion with matrices A, (n, k, k), in about sqrt(n) sequential calls instead of n."""

    def __init__(self, A: Array):
        n, k, _ = A.shape
        length = max(1, round(n**0.5))
        count = -(-n // length)
        self._n = n
        self._A = np.tile(np.eye(k), (count * length, 1, 1))
        self._A[:n] = A
        self._A = self._A.reshape(count, length, k, k)
        # Transition from the start of a block to each of its steps, and to its end.
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


class StateSpace:
    """Outputs of `x' = A x + B s, y = C x + D s` for many series s at once, x = 0 before the first step.

    A (n, k, k), B (n, k, q), C (n, o, k), D (n, o, q). One matrix maps the inputs of a block of BLOCK steps, and the
    state at its start, to its outputs; the states at the starts of the blocks are a recursion of their own.
    """

    def __init__(self, A: Array, B: Array, C: Array, D: Array):
        n, k, q = B.shape
        self._n, self._k, self._count = n, k, -(-n // BLOCK)
        A, B, C, D = (
            np.concatenate([m, np.zeros((self._count * BLOCK - n, *m.shape[1:]))]).reshape(
                self._count, BLOCK, *m.shape[1:]
            )
            for m in (A, B, C, D)
        )
        # Columns: the state at the start of the block, then input by input, all steps of each.
        state = np.zeros((self._count, k, k + q * BLOCK))
        state[:, :, :k] = np.eye(k)
        outputs = np.empty((self._count, BLOCK, C.shape[2], state.shape[2]))
        for j in range(BLOCK):
            own = slice(k + j, None, BLOCK)
            outputs[:, j] = C[:, j] @ state
            outputs[:, j, :, own] += D[:, j]
            state = A[:, j] @ state
            state[:, :, own] += B[:, j]
        # Transposed, so that the rows of a series are contiguous.
        self._outputs = np.ascontiguousarray(outputs.reshape(self._count, -1, state.shape[2]).transpose(0, 2, 1))
        self._end = np.ascontiguousarray(state[:, :, k:].transpose(0, 2, 1))
        self._begin = Recursion(state[:, :, :k])

    def outputs(self, s: Array) -> Array:
        """Outputs (p, n, o) of the first q inputs (q, p, n); the other inputs are 0."""
        q, p, _ = s.shape
        inputs = np.zeros((self._count, p, self._k + q * BLOCK))
        for i in range(q):
            padded = np.zeros((p, self._count * BLOCK))
            padded[:, : self._n] = s[i]
            first = self._k + i * BLOCK
            inputs[:, :, first : first + BLOCK] = padded.reshape(p, self._count, BLOCK).swapaxes(0, 1)
        ends = inputs[:, :, self._k :] @ self._end[:, : q * BLOCK]
        inputs[:, :, : self._k] = self._begin.states(ends.swapaxes(1, 2))[0].swapaxes(1, 2)
        y = (inputs @ self._outputs[:, : inputs.shape[2]]).reshape(self._count, p, BLOCK, -1)
        result: Array = y.swapaxes(0, 1).reshape(p, self._count * BLOCK, -1)[:, : self._n]
        return result
