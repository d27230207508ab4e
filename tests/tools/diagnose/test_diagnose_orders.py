"""What repeats with a wheel's angle as no wheel does is reported, with its order, side and amplitude."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from diagnosis_drives import SLALOM, WAREHOUSE, problem, recorded, selected

from drd.arrays import Array
from drd_tools.diagnose.analysis import analyse
from drd_tools.diagnose.conclude.outcome import course_of, findings_of
from drd_tools.diagnose.error_model.linear import Sensitivity
from drd_tools.diagnose.select.orders import Ripple, ripples
from drd_tools.recordings.folder import Recording, read_recording
from drd_tools.trial.overlay import planted
from drd_tools.trial.unknown import HIDDEN

GEAR = HIDDEN["unknown_wheel_gear"]
LEAST_NATS, MOST_P = 12.0, 0.05
SHARED = Path(__file__).parents[4] / "shared" / "recordings"


def geared(recording: Recording, order: float, amplitude: float) -> Recording:
    return planted(recording, GEAR, {"k": amplitude, "order": order, "phase": 1.0})


def found_in(drive: tuple[str, float], seed: int) -> list[Ripple]:
    return ripples(problem(drive, seed), (), LEAST_NATS, MOST_P)


@pytest.mark.parametrize("drive", [SLALOM, WAREHOUSE])
def test_the_adjoint_is_the_transpose_of_the_whitener(drive: tuple[str, float]) -> None:
    of, random = problem(drive, 1), np.random.default_rng(3)
    moves: list[Array] = list(random.normal(size=(4, len(of.evidence.step_s))))
    rows = of.whiten([Sensitivity(*moves)])[:, 0]
    other = random.normal(size=len(rows))
    back = of.adjoint(other)
    assert float(rows @ other) == pytest.approx(sum(float(back[:, i] @ m) for i, m in enumerate(moves)), rel=1e-9)


@pytest.mark.parametrize(("order", "amplitude"), [(0.7, 0.01), (2.6, 0.01), (3.7, 0.02)])
def test_a_gear_is_reported_with_order_side_and_amplitude(order: float, amplitude: float) -> None:
    conclusion = analyse(geared(recorded(WAREHOUSE, 5), order, amplitude)).conclusion
    (finding,), (cause,) = findings_of(conclusion), conclusion.causes
    assert finding.effect == "unknown"
    assert finding.choices == {"side": "left"}
    for name, true in (("order", order), ("amplitude", amplitude)):
        found = finding.parameters[name]
        # The ripple within a sample is not seen: the amplitude may be a tenth smaller.
        assert found.value == pytest.approx(true, abs=4.0 * found.std + (0.1 * true if name == "amplitude" else 0.0))
    drawn = course_of(cause).curve
    assert drawn is not None
    at = np.interp(drawn.x, drawn.fit_x, drawn.fit)
    assert np.mean(((drawn.mismatch - at) / drawn.sigma) ** 2) < 3.0


def test_an_effect_of_the_catalogue_is_still_named_beside_a_gear() -> None:
    both = geared(recorded(WAREHOUSE, 6, selected("tread_error", k=0.02)), 2.6, 0.01)
    assert {c.effect for c in analyse(both).conclusion.causes} == {"tread_error", "unknown"}


@pytest.mark.parametrize("seed", range(1, 7))
def test_noise_has_no_order(seed: int) -> None:
    assert found_in(SLALOM, seed) == []


def test_an_eccentric_wheel_is_no_gear() -> None:
    drive = problem(WAREHOUSE, 2, selected("wheel_eccentricity", side="left", e=0.01, phase=0.5))
    assert [r for r in ripples(drive, (), LEAST_NATS, MOST_P) if abs(r.order - 1.0) < 0.1] == []


def test_without_turns_of_the_wheels_there_is_no_spectrum() -> None:
    of = problem(SLALOM, 1)
    still = replace(of.evidence, left_m=np.zeros_like(of.evidence.left_m), right_m=np.zeros_like(of.evidence.right_m))
    of.evidence = still
    assert ripples(of, (), LEAST_NATS, MOST_P) == []


@pytest.mark.skipif(not SHARED.is_dir(), reason="the shared recordings are not here")
@pytest.mark.parametrize(
    ("name", "order", "amplitude"),
    [("warthog_grass_2024_7_29_14h4s53", 3.7, 0.08), ("optiodom_circular_250620202119_run-05", 2.6, 0.05)],
)
def test_a_gear_is_found_in_a_real_drive(name: str, order: float, amplitude: float) -> None:
    recording = read_recording(SHARED / name)
    assert [c for c in analyse(recording).conclusion.causes if c.ripple is not None] == []
    found = [c.ripple for c in analyse(geared(recording, order, amplitude)).conclusion.causes if c.ripple is not None]
    assert len(found) == 1
    assert found[0].side == "left"
    assert found[0].order == pytest.approx(order, abs=max(5.0 * found[0].sigma_order, 0.01))
