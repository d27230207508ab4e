"""A small trial: bounds that a right build keeps whatever the seed, and a broken one does not."""

import pytest

from drd_tools.trial.plan import Drawing, Plan, drawings
from drd_tools.trial.results import Record, Row
from drd_tools.trial.run import simulated
from drd_tools.trial.score import score

# A fixed seed: chance is drawn anew only when the drives or the noise are.
SEED = 11
MINUTES = (2.5, 3.5)
NULLS = 5  # plain, and as many stressed
# Unlike all others on any drive; each has a d of 40.
STRONG = (
    "gyro_bias_temperature_rate",
    "encoder_clock_skew",
    "wheel_eccentricity",
    "encoder_latency",
    "gyro_bias_step",
    "slip_acceleration",
)


def made(rows: list[Row]) -> list[Record]:
    records = [row for row in rows if isinstance(row, Record)]
    assert len(records) == len(rows)
    return records


@pytest.fixture(scope="module")
def nulls() -> list[Record]:
    return made([simulated(d) for d in drawings(Plan(nulls=NULLS), SEED, MINUTES)])


@pytest.fixture(scope="module")
def singles() -> list[Record]:
    return made([simulated(Drawing(f"{e}-gate", "single", (e,), 40.0, SEED, MINUTES)) for e in STRONG])


def test_where_nothing_is_missing_next_to_nothing_is_reported(nulls: list[Record]) -> None:
    # 5 % false claims, the most that is allowed, give more than 2 of 10 with a probability of 1.2 %.
    wrong = [r for r in nulls if score(r).reports]
    assert len(wrong) <= 2, [(r.case, [f.effect for f in r.findings]) for r in wrong]


def test_strong_effects_get_their_name(singles: list[Record]) -> None:
    # 95 % right as a class, the least that is asked for at d = 20, give fewer than 4 of 6 with a probability of 0.2 %.
    right = [r for r in singles if score(r).top_1_class]
    assert len(right) >= 4, [(r.case, [f.effect for f in r.findings]) for r in singles if r not in right]


def test_their_corrections_hold_on_another_drive(singles: list[Record]) -> None:
    shares = sorted(share for r in singles if (share := score(r).share) is not None)
    assert len(shares) >= 4
    assert shares[len(shares) // 2] > 0.7
