"""All ways to wire a gyro and two encoders wrongly, and which of them agree with the observed signs."""

from dataclasses import dataclass
from itertools import product


@dataclass(frozen=True)
class Wiring:
    """A set of wiring faults; sides are those of the configuration."""

    gyro: bool = False
    swapped: bool = False
    left: bool = False
    right: bool = False

    @property
    def changes(self) -> int:
        """Number of faults; a wrong forward direction on both sides counts as one."""
        return self.gyro + self.swapped + (self.left or self.right)

    def words(self) -> str:
        """The faults in words."""
        wheels = {
            (True, True): "both wheels count backwards",
            (True, False): "the left wheel counts backwards",
            (False, True): "the right wheel counts backwards",
        }
        parts = ["the gyro's sign is wrong"] * self.gyro + ["left and right are swapped"] * self.swapped
        return " and ".join([*parts, *([wheels[self.left, self.right]] if self.left or self.right else [])])

    def coefficients(self) -> tuple[int, int, int, int]:
        """Coefficients of speed and yaw rate in the wheels' difference (right - left), then in their sum."""
        left, right, sides = (-1 if is_wrong else 1 for is_wrong in (self.left, self.right, self.swapped))
        return (right - left) // 2, sides * (right + left) // 2, (right + left) // 2, sides * (right - left) // 2


@dataclass(frozen=True)
class Seen:
    """Observed signs; None: unknown.

    `one_inverted`: turning shows in the wheels' sum instead of their difference. `opposite`: the gyro opposes it.
    `gyro_turn`, `wheel_turn`, `wheel_travel`: sign of each while, as stated, the robot turned left or drove forward.
    """

    one_inverted: bool | None = None
    opposite: bool | None = None
    gyro_turn: int | None = None
    wheel_turn: int | None = None
    wheel_travel: int | None = None

    def agrees(self, wiring: Wiring) -> bool:
        """Whether this wiring would give these signs."""
        turn_v, turn_w, sum_v, sum_w = wiring.coefficients()
        inverted = turn_w == 0
        gyro = -1 if wiring.gyro else 1
        wheels_w, wheels_v = (sum_w, turn_v) if inverted else (turn_w, sum_v)
        expected = (inverted, gyro * wheels_w < 0, gyro, wheels_w, wheels_v)
        found = (self.one_inverted, self.opposite, self.gyro_turn, self.wheel_turn, self.wheel_travel)
        return all(f is None or f == e for f, e in zip(found, expected, strict=True))


def explanations(seen: Seen, has_gyro: bool = True) -> list[Wiring]:
    """The wirings with the fewest faults that agree with the signs; only `Wiring()` if all is correct."""
    every = [Wiring(*flags) for flags in product((False, True), repeat=4)]
    fit = [wiring for wiring in every if seen.agrees(wiring) and (has_gyro or not wiring.gyro)]
    least = min((wiring.changes for wiring in fit), default=0)
    return [wiring for wiring in fit if wiring.changes == least]
