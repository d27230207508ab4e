import pytest

from drd.estimation.stuck import STUCK_READINGS, Stuck


@pytest.mark.parametrize("says_angles", [False, True])
def test_a_gyro_that_repeats_itself_is_stuck_once_the_wheels_disagree(says_angles: bool) -> None:
    stuck = Stuck()
    for i in range(2 * STUCK_READINGS):
        longer = 1.0 + 1e-4 * i if says_angles else 1.0
        assert not stuck.take(0.3 / longer, 0.1 * longer, disagrees=False)
    assert stuck.take(0.3, 0.1, disagrees=True)
    assert not stuck.take(0.3, 0.1, disagrees=False)  # told once
    assert stuck.found
    stuck.take(0.31, 0.1, disagrees=True)
    assert (stuck.found, stuck.repeats) == (False, 0)


def test_too_few_repeats_are_chance() -> None:
    stuck = Stuck()
    for _ in range(STUCK_READINGS):
        assert not stuck.take(0.3, 0.1, disagrees=True)
    assert stuck.take(0.3, 0.1, disagrees=True)
