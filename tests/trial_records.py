"""Made-up records of a trial."""

from drd_tools.diagnose.results import Amount, Finding, Status, Support
from drd_tools.trial.results import Record, TrueEffect

SCALE = TrueEffect(effect="gyro_scale_error", parameters={"k": 0.001}, detectability=25.0)
TREAD = TrueEffect(effect="tread_error", parameters={"k": 0.02}, detectability=25.0)


def amount(value: float, std: float) -> Amount:
    return Amount(value, std, "1")


def finding(
    effect: str,
    status: str = "confirmed",
    also_fits: tuple[str, ...] = (),
    window: tuple[float, float] = (0.0, 100.0),
    **parameters: Amount | str,
) -> Finding:
    return Finding(
        effect=effect, status=Status(status), also_fits=also_fits, acts_on="gyro",
        parameters={n: v for n, v in parameters.items() if isinstance(v, Amount)},
        choices={n: v for n, v in parameters.items() if isinstance(v, str)},
        windows=(window,), covariate="time", evidence=Support(100.0, 0.001, 1e9), explains=None, sentence="",
    )  # fmt: skip


def record(verdict: str, truth: list[TrueEffect], *findings: Finding, kind: str = "single") -> Record:
    return Record(case="a", kind=kind, effects=truth, verdict=verdict, findings=findings)
