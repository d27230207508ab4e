"""The two headings compared: slip releases the wheels', also where no heading is known any more."""

import pytest
from sensors import NO_BIAS, T0, S, drive, feed, make

from drd.agreement import Agreement
from drd.filter import HEADING_UNKNOWN_RAD2
from drd.health import Reasons


@pytest.mark.parametrize("unseen_rad2", [0.0, 10.0 * HEADING_UNKNOWN_RAD2], ids=["known", "unknown"])
@pytest.mark.parametrize("parted_rad", [0.1, -1.0, 3.0])
def test_a_lasting_disagreement_releases_the_wheels_and_loses_nothing(unseen_rad2: float, parted_rad: float) -> None:
    estimator = make(NO_BIAS)
    feed(estimator, drive(5.0))
    track = estimator._track
    kf = track.kf
    kf.add_heading_variance(unseen_rad2, both=True)
    kf.nominal.heading_rad = kf.nominal.gyro_heading_rad + parted_rad
    counters = dict.fromkeys(("rejected", "released", "accepted", "not_finite"), 0)
    agreement = Agreement(3, Reasons(), counters)
    for i in range(4):
        assert agreement.update(track, T0 + i * S)
    assert counters == {"rejected": 3, "released": 1, "accepted": 2, "not_finite": 0}
    assert kf.nominal.heading_rad == pytest.approx(kf.nominal.gyro_heading_rad, abs=0.02)
