"""The catalogue as a table for the documentation."""

from drd.effects.catalogue import catalogue
from drd.effects.effect import END, Effect, Parameter

HEAD = """# Physical effects

Generated from the modules of this folder by `python -m drd.effects`; do not edit. An effect is one module: its formula
serves simulator, compensation and diagnosis.

Signs are those of REP-103: a left turn is positive, forward is positive, to the left is positive. e is the
error of a reading, w the yaw rate, v the forward speed, T the gyro's temperature, D the tread; `-+` is - for the left
and + for the right wheel. Ranges are of magnitudes; ± marks parameters of either sign. The residual after correction is
a share of the effect, for samples at 10 and 20 Hz. Effects act in the order of the table, each on the result of those
before it: first body and wheels, then gyro, timing and readout.

"""
COLUMNS = (
    "id",
    "acts on",
    "what it is",
    "formula",
    "source",
    "parameters",
    "covariate",
    "manoeuvre that excites it",
    "residual after correction",
    "unchanged in the next run",
)


def markdown() -> str:
    """The file's text."""
    rows = [COLUMNS, ("---",) * len(COLUMNS), *(_row(effect) for effect in catalogue().values())]
    return HEAD + "".join(f"| {' | '.join(row)} |\n" for row in rows)


def _row(effect: Effect) -> tuple[str, ...]:
    where = effect.channel if effect.channel == effect.acts_on.value else f"{effect.channel}, {effect.acts_on.value}"
    left = "all" if effect.remainder >= 1.0 else f"up to {100.0 * effect.remainder:.0f} %"
    left += f": {effect.irreversible}" if effect.irreversible else ""
    cells = (
        f"`{effect.id}`",
        where,
        effect.sentence,
        effect.formula,
        effect.source,
        "<br>".join(_parameter(q) for q in effect.parameters),
        effect.covariate.replace("_", " "),
        effect.manoeuvre,
        left,
        "yes" if effect.lasting else "no",
    )
    return tuple(cell.replace("|", "\\|") for cell in cells)


def _parameter(q: Parameter) -> str:
    if q.choices:
        return f"`{q.name}` {' or '.join(q.choices)}: {q.text}"
    if q.high >= END.high:
        return f"`{q.name}` {q.unit}: {q.text}"
    sign = "±" if q.signed and q.low >= 0.0 else ""
    unit = "" if q.unit == "1" else f" {q.unit}"
    return f"`{q.name}` {sign}{q.low:g} to {sign}{q.high:g}{unit}: {q.text}"
