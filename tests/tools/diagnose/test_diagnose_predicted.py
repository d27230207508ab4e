"""Explained asks for a path that stays where the model says it is: on the recordings of the fit, and on others. (91)"""

from pathlib import Path

import diagnosis_files
import pytest
from msgspec.structs import replace

from drd_tools.diagnose.files import load
from drd_tools.diagnose.report.verdict import lead
from drd_tools.diagnose.results import Figures, Finding, Status, Support, Train, Verdict
from drd_tools.diagnose.validate.trajectory import OUTSIDE, checked

INSIDE: Figures = {OUTSIDE: 2.0}
LEFT: Figures = {OUTSIDE: 40.0}


def found(effect: str) -> Finding:
    return Finding(
        effect=effect, status=Status.CONFIRMED, also_fits=(), acts_on="wheels", windows=((0.0, 1.0),),
        parameters={}, covariate="time", evidence=Support(50.0, 0.001, 1e9), explains=1.0, sentence="Found.",
    )  # fmt: skip


@pytest.mark.parametrize(
    ("effect", "own", "other", "verdict"),
    [
        ("tread_error", INSIDE, INSIDE, Verdict.EXPLAINED),
        ("tread_error", {}, {}, Verdict.EXPLAINED),  # no reference that could tell
        ("tread_error", LEFT, INSIDE, Verdict.PARTLY),
        ("tread_error", INSIDE, LEFT, Verdict.PARTLY),
        ("encoder_dropout", LEFT, INSIDE, Verdict.EXPLAINED),  # what is in no count cannot be put back
        ("encoder_dropout", INSIDE, LEFT, Verdict.PARTLY),  # but it was not lost there
        ("gyro_saturation", LEFT, LEFT, Verdict.EXPLAINED),  # that gyro is the same there
    ],
)
def test_poses_that_leave_their_bound_are_not_explained(
    effect: str, own: Figures, other: Figures, verdict: Verdict
) -> None:
    assert checked(Verdict.EXPLAINED, [found(effect)], [own], [other]) is verdict
    assert checked(Verdict.UNKNOWN, [found(effect)], [own], [other]) is Verdict.UNKNOWN


def test_the_report_tells_which_recording_leaves_its_bound(tmp_path: Path) -> None:
    d, s = load(diagnosis_files.write(tmp_path, diagnosis_files.one_finding()))
    train = Train(d.fit.train.before, {f"monday: {OUTSIDE}": 40.0, f"tuesday: {OUTSIDE}": 2.0})
    others = replace(d.fit.held_out, after={"friday": LEFT, "saturday": INSIDE})
    d = replace(d, fit=replace(d.fit, train=train, held_out=others))
    text = lead(d, s)[-1]
    assert "40 % of the poses of monday lie outside their own 99 % bound" in text
    assert "40 % of the poses of friday lie outside" in text
    assert "tuesday" not in text
    assert "saturday" not in text
    one = replace(d, fit=replace(d.fit, train=Train(d.fit.train.before, LEFT)))
    assert "40 % of the poses lie outside their own 99 % bound" in lead(one, s)[-1].lower()
