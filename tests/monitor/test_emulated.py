"""The monitor on the demo's robot, whose radii, tread and scale are as a tape and a datasheet leave them."""

import numpy as np
import pytest
from emulated_demo import demo_config, emulated

from drd.monitor.constants import stated_constants
from drd.monitor.first_turns import FirstTurns, Turns
from drd.monitor.library import TRAVEL
from drd.monitor.monitor import Monitor
from drd.samples import GyroSample

ROW_S = 0.1


# Of the first four, three were named a slip and one a latency once.
@pytest.mark.parametrize("seed", [1, 2, 3, 4])
def test_small_errors_of_radius_and_tread_are_no_findings(seed: int) -> None:
    monitor = Monitor(demo_config())
    for sample in emulated(seed, 200.0):
        if isinstance(sample, GyroSample):
            monitor.gyro(sample)
        else:
            monitor.wheels(sample)
        assert monitor.findings() == []
    assert monitor.now_s > 190.0


def test_what_the_configuration_says_of_the_radii_is_taken() -> None:
    assert stated_constants(demo_config()).sigmas[TRAVEL] == pytest.approx(0.005 * np.sqrt(2.0))


def turns(rate_rad_s: np.ndarray, lag_rows: int, seed: int = 0) -> Turns | None:
    """What rows of these rates show whose wheels are late, noisy and of a tread 2 % off."""
    random, first = np.random.default_rng(seed), FirstTurns()
    wheels = 1.02 * np.roll(rate_rad_s, lag_rows) + 0.018 * random.standard_normal(len(rate_rad_s))
    for k in range(0, len(rate_rad_s), 20):
        if (found := first.add(wheels[k : k + 20], rate_rad_s[k : k + 20])) is not None:
            return found
    return None


def test_a_rate_that_changes_slowly_tells_no_lag() -> None:
    slow = 0.226 * np.cos(0.094 * np.arange(1400) * ROW_S)
    found = [turns(slow, 0, seed) for seed in range(40)]
    assert {t.lag_s for t in found if t is not None} <= {0.0}


def test_sharp_turns_tell_a_lag() -> None:
    sharp = 0.8 * (np.arange(600) // 30 % 3 == 0)
    found = turns(sharp, 2)
    assert found is not None
    assert found.lag_s == pytest.approx(0.2, abs=0.02)
    none = turns(sharp, 0)
    assert none is not None
    assert none.lag_s == 0.0
    assert none.tread == pytest.approx(1.02, abs=0.01)
