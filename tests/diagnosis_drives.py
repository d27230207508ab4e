"""Short simulated recordings with known missing effects, and the problems that they pose to `drd diagnose`."""

from functools import lru_cache

from drd.config.robot import Robot
from drd.effects.catalogue import catalogue
from drd_tools.diagnose.observe.evidence import gather
from drd_tools.diagnose.regression.problem import Problem
from drd_tools.diagnose.selected import Selected
from drd_tools.recordings.folder import Recording
from drd_tools.simulate.conditions import Conditions, Reference
from drd_tools.simulate.missions import make_drive
from drd_tools.simulate.robot import DEFAULT
from drd_tools.simulate.simulator import Simulated, simulate
from drd_tools.simulate.truth import Truth, make_truth

WAREHOUSE = ("warehouse", 130.0)
SLALOM = ("slalom", 120.0)
LATE_5_MS = Conditions(reference=Reference(latency_s=0.005))
ASIDE_4_CM = Conditions(reference=Reference(lever_m=(0.0, 0.04)))


def selected(effect: str, **values: float | str) -> Selected:
    """An effect at values in SI, all linear parameters free."""
    found = catalogue()[effect]
    return Selected(found, values, found.linear())


# A skid-steer robot far from its robot.yaml, and how late its reference is.
TREAD, LEFT, RIGHT, WHEELS_S, REFERENCE_S = 0.65, -0.05, -0.03, 0.17, 0.3
FAR = (
    selected("tread_error", k=TREAD),
    selected("wheel_radius_error", left=LEFT, right=RIGHT),
    selected("encoder_latency", delay=WHEELS_S),
)


@lru_cache
def truth(mission: str, seconds: float, temperature: str = "warmup") -> Truth:
    return make_truth(make_drive(mission, seconds), temperature)


def simulated(
    drive: tuple[str, float],
    seed: int,
    *selection: Selected,
    conditions: Conditions | None = None,
    nominal: Robot = DEFAULT,
    temperature: str = "warmup",
) -> Simulated:
    """Simulate a drive with the selected effects."""
    effects = [(c.effect, c.values) for c in selection]
    return simulate(truth(*drive, temperature), nominal, effects, conditions or Conditions(), seed=seed)


def recorded(
    drive: tuple[str, float], seed: int, *selection: Selected, conditions: Conditions | None = None
) -> Recording:
    """The recording of such a drive."""
    return simulated(drive, seed, *selection, conditions=conditions).recording


def problem(drive: tuple[str, float], seed: int, *selection: Selected, conditions: Conditions | None = None) -> Problem:
    """The regression problem of such a recording, with the noise of the datasheets."""
    return Problem(gather(recorded(drive, seed, *selection, conditions=conditions)))
