"""The range of its covariate to which a model holds an effect."""

from dataclasses import replace

import numpy as np
import pytest
from effect_motions import motion

from drd.effects.catalogue import catalogue
from drd.units import RAD_PER_DEG
from drd_tools.diagnose.error_model.ranges import seen, within
from drd_tools.diagnose.selected import Selected

LEFT = replace(m := motion(), rate_rad_s=np.abs(m.rate_rad_s))  # turns one way only
LARGEST_DEG_S = float(LEFT.rate_rad_s.max() / RAD_PER_DEG)


@pytest.mark.parametrize("name", ["tread_error", "wheel_radius_error", "gyro_scale_error", "rotation_centre_offset"])
def test_geometry_that_was_seen_in_left_turns_holds_in_right_ones(name: str) -> None:
    effect = catalogue()[name]
    assert seen(LEFT, Selected(effect, dict.fromkeys(effect.linear(), 0.01), ())) == {}


@pytest.mark.parametrize("name", ["gyro_scale_asymmetry", "gyro_scale_nonlinearity"])
def test_other_forms_are_held_to_the_turns_that_they_were_seen_in(name: str) -> None:
    effect = catalogue()[name]
    values = effect.variants(LEFT)[0] | dict.fromkeys(effect.linear(), 0.01)
    found = seen(LEFT, Selected(effect, values, ()))
    assert found["yaw_rate"] == pytest.approx((LEFT.rate_rad_s.min() / RAD_PER_DEG, LARGEST_DEG_S))
    held = within(replace(LEFT, rate_rad_s=-2.0 * LEFT.rate_rad_s), found)
    assert held.rate_rad_s == pytest.approx(np.full(len(LEFT.time_s), LEFT.rate_rad_s.min()))
