"""`drd import`: convert another system's recording to a recording folder, and check it for the usual pitfalls."""

import argparse
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from drd.arrays import Array
from drd.batch.logs import COUNTS, RATE, RATE_AND_TEMPERATURE, SPEEDS
from drd.batch.samples import LONGEST_GAP_S
from drd.commands import writing
from drd.config.robot import Robot
from drd.config.schema import ConfigError
from drd.units import DEG_PER_RAD, NS_PER_S
from drd_tools.importing.checks import OK, WRONG, Finding
from drd_tools.importing.convert import EncoderRows, encoder_rows, for_checks, gyro_rad_s, seconds
from drd_tools.importing.examine import examine
from drd_tools.importing.matching import Match, Turning, angle_of, match
from drd_tools.importing.options import parser
from drd_tools.importing.sources import open_source
from drd_tools.importing.streams import GYRO_ANGLES, Gyro, Origin, Reference, Wheels, in_order
from drd_tools.importing.text import summary
from drd_tools.importing.text_table import TextTable
from drd_tools.importing.write import MADE, SAID, nominal_of, prepare, write_robot, write_said
from drd_tools.recordings.folder import POSES, continuous_rad, write_table


@dataclass
class Imported:
    """Streams of one import, and the changes made to them. `sign`: of the gyro, `rows`: of encoders.csv."""

    gyro: Gyro | None = None
    wheels: Wheels | None = None
    reference: Reference | None = None
    origins: dict[str, Origin] = field(default_factory=dict)
    inputs: list[Path] = field(default_factory=list)
    nominal: Robot | None = None
    rows: EncoderRows | None = None
    gyro_unit: str = "rad_s"
    axis: int | None = None
    sign: int = 1
    applied: dict[str, Any] = field(default_factory=dict)
    findings: list[Finding] = field(default_factory=list)


def main(argv: list[str]) -> int:
    """List or import, print, and return the exit code. Raises ConfigError on bad input."""
    chosen = parser().parse_args(argv)
    names = [name for name in ("gyro", "wheels", "reference") if getattr(chosen, name) is not None]
    if not names:
        print("\n".join(open_source(chosen.file, chosen).listing()))
        return 0
    if chosen.output is None:
        raise ConfigError("command line", "--output", "the folder to make", "nothing")
    made = read(chosen, names)
    check(made, chosen)
    written = write(made, chosen, argv)
    print(
        summary(chosen.output, made.origins, made.findings, made.applied, after(made, chosen.max_lag), _stands_s(made))
    )
    print("\nWritten: " + ", ".join(map(str, written)))
    return 0


def read(chosen: argparse.Namespace, names: list[str]) -> Imported:
    """Read the streams in the source's units, and apply the shifts that the options state. Raises ConfigError."""
    made = Imported()
    for name in names:
        path: Path = getattr(chosen, f"{name}_file") or chosen.file
        source = open_source(path, chosen)
        if isinstance(source, TextTable):
            _ask_units(chosen, name)
        are_angles = name == "gyro" and chosen.gyro_unit in GYRO_ANGLES
        values, origin = in_order(*getattr(source, name)(getattr(chosen, name)), are_angles=are_angles)
        shift = getattr(chosen, f"shift_{name}", 0.0)
        if isinstance(shift, float) and shift:
            values = _shifted(values, shift)
            made.applied[f"shift_{name}_s"] = shift
        if len(values.time_ns) < 2:
            raise ConfigError(str(path), f"--{name}", "at least 2 rows of different times", str(len(values.time_ns)))
        apart_s = np.diff(values.time_ns) / NS_PER_S
        if apart_s.max() > LONGEST_GAP_S:
            got = f"{apart_s.max():g} s after {values.time_ns[apart_s.argmax()] / NS_PER_S:.12g} s"
            raise ConfigError(str(path), f"--{name}", f"rows at most {LONGEST_GAP_S:g} s apart", got)
        setattr(made, name, values)
        made.origins[name] = origin
        made.inputs += [path] if path not in made.inputs else []
    if chosen.modulus is not None and made.wheels is not None:
        made.wheels = replace(made.wheels, modulus_counts=chosen.modulus)
    if made.gyro is not None and chosen.gyro_scale != 1.0:
        made.gyro = replace(made.gyro, value=made.gyro.value * chosen.gyro_scale)
        made.applied["gyro_scale"] = chosen.gyro_scale
    made.gyro_unit = chosen.gyro_unit or "rad_s"
    _overlap(made)
    made.nominal = nominal_of(chosen, made.wheels)
    if made.wheels is not None:
        assert made.nominal is not None
        made.rows = encoder_rows(made.wheels, made.nominal).changed(swap=chosen.swap == "yes", reverse=chosen.reverse)
        made.applied |= {"swap": chosen.swap == "yes", "reverse": chosen.reverse}
    return made


def check(made: Imported, chosen: argparse.Namespace) -> None:
    """Run the checks, and apply their results to options set to `auto`. Raises ConfigError if undetermined."""
    axis = None if chosen.axis == "auto" else chosen.axis
    made.sign = -1 if chosen.sign == "-" else 1
    streams = for_checks(made.gyro, made.gyro_unit, made.rows, made.nominal, made.reference, _zero_ns(made))
    examined = examine(*streams, axis=axis, sign=made.sign, max_lag_s=chosen.max_lag)
    made.findings, made.axis = examined.findings, examined.axis
    found = {finding.check: finding for finding in made.findings}
    if made.gyro is not None:
        if made.axis is None:
            raise _cannot("axis", found.get("axis"), made)
        name = made.gyro.axes[made.axis]
        if chosen.sign == "auto":
            _require("sign", found.get("sign"), made)
            made.sign = -1 if found["sign"].proposal else 1
        made.applied |= {"axis": name or "the only one", "sign": "+" if made.sign > 0 else "-", "unit": made.gyro_unit}
    if chosen.swap == "auto" and made.rows is not None:
        _require("swap", sides := found.get("sides", found.get("one side")), made)
        if sides is not None and sides.proposal:
            made.rows = made.rows.changed(swap=True, reverse=None)
            made.applied["swap"] = True
    for name, option in (("wheels", chosen.shift_wheels), ("reference", chosen.shift_reference)):
        if option == "auto" and name in made.origins:
            _shift_as_found(made, name)
    autos = ("axis", "sign", "swap", "shift_wheels", "shift_reference")
    made.applied["auto"] = [name.replace("_", "-") for name in autos if getattr(chosen, name) == "auto"]


def write(made: Imported, chosen: argparse.Namespace, argv: list[str]) -> list[Path]:
    """Write the folder's files; return their paths. Raises ConfigError."""
    folder: Path = chosen.output
    prepare(folder)
    zero_ns, rows = _zero_ns(made), made.rows
    header: tuple[str, ...]
    with writing(folder):
        if made.nominal is not None:
            rates_hz = {name: origin.rate_hz for name, origin in made.origins.items()}
            write_robot(folder / "robot.yaml", made.nominal, rates_hz)
        if rows is not None:
            header, form = (COUNTS, "%.9f,%.0f,%.0f") if rows.are_counts else (SPEEDS, "%.9f,%.9g,%.9g")
            columns = [seconds(rows.time_ns, zero_ns), rows.left, rows.right]
            write_table(folder / "encoders.csv", header, np.column_stack(columns), form)
        if made.gyro is not None:
            columns = [seconds(made.gyro.time_ns, zero_ns), _rate_rad_s(made) * DEG_PER_RAD]
            warm = made.gyro.temperature_c
            columns += [] if warm is None else [warm]
            header, form = (RATE, "%.9f,%.9g") if warm is None else (RATE_AND_TEMPERATURE, "%.9f,%.9g,%.6g")
            write_table(folder / "fog.csv", header, np.column_stack(columns), form)
        if (poses := made.reference) is not None:
            heading_deg = continuous_rad(poses.heading_rad * DEG_PER_RAD) * DEG_PER_RAD
            columns = [seconds(poses.time_ns, zero_ns), poses.x_m, poses.y_m, heading_deg]
            write_table(folder / "reference.csv", POSES, np.column_stack(columns), "%.9f,%.12g,%.12g,%.9g")
        write_said(folder / SAID, made.inputs, argv, made.origins, made.applied, made.findings, zero_ns)
    return [folder / name for name in MADE if (folder / name).exists()]


def after(made: Imported, max_lag_s: float) -> Match | None:
    """Match of gyro and wheels as written to the folder."""
    if made.gyro is None or made.rows is None or made.nominal is None:
        return None
    zero_ns, nominal = _zero_ns(made), made.nominal
    left, right = made.rows.angles_rad(nominal.counts_per_revolution)
    turned = (right - left) * nominal.wheel_radius_m / nominal.tread_m
    time_s = seconds(made.gyro.time_ns, zero_ns)
    wheels_s = seconds(made.rows.time_ns, zero_ns)
    gyro = Turning(time_s, angle_of(time_s, _rate_rad_s(made)))
    return match(Turning(wheels_s, turned), gyro, max_lag_s)


def _rate_rad_s(made: Imported) -> Array:
    assert made.gyro is not None
    assert made.axis is not None
    return made.sign * gyro_rad_s(made.gyro, made.gyro_unit)[:, made.axis]


def _zero_ns(made: Imported) -> int:
    streams = [stream for stream in (made.gyro, made.rows, made.reference) if stream is not None]
    return min(int(stream.time_ns[0]) for stream in streams)


def _shifted(values: Any, shift_s: float) -> Any:
    return replace(values, time_ns=values.time_ns + round(shift_s * NS_PER_S))


def _shift_as_found(made: Imported, name: str) -> None:
    option = f"shift-{name}"
    findings = [f for f in made.findings if f.check.startswith(f"clock, {name} against")]
    finding = next((f for f in findings if option in f.proposal), findings[0] if findings else None)
    _require(option, finding, made)
    assert finding is not None
    shift_s = float(finding.proposal.get(option, 0.0))
    if name == "wheels":
        made.rows = _shifted(made.rows, shift_s)
    else:
        made.reference = _shifted(made.reference, shift_s)
    made.applied[f"shift_{name}_s"] = shift_s


def _require(option: str, finding: Finding | None, made: Imported) -> None:
    """Raise ConfigError if the data do not determine the value of `auto`."""
    if finding is None or (finding.verdict != OK and option not in finding.proposal):
        raise _cannot(option, finding, made)


def _cannot(option: str, finding: Finding | None, made: Imported) -> ConfigError:
    why = "there is nothing to compare with" if finding is None else finding.text
    axis = next((f for f in made.findings if f.check == "axis"), None)
    if axis is not None and axis.verdict == WRONG:
        why += f"; but {axis.text}"
    return ConfigError("command line", f"--{option}", "a value, since the data cannot tell", f"auto ({why})")


def _ask_units(chosen: argparse.Namespace, name: str) -> None:
    option = {"gyro": "gyro_unit", "reference": "heading_unit"}.get(name)
    if option is not None and getattr(chosen, option) is None:
        shown = "--" + option.replace("_", "-")
        raise ConfigError("command line", shown, "the unit, which a table does not say", "nothing")


def _overlap(made: Imported) -> None:
    """Raise ConfigError if the streams do not overlap in time."""
    spans = {
        name: (int(values.time_ns[0]), int(values.time_ns[-1]))
        for name in made.origins
        if (values := getattr(made, name)) is not None
    }
    if max(begin for begin, _ in spans.values()) >= min(end for _, end in spans.values()):
        told = "; ".join(f"{n} {a / NS_PER_S:.3f} to {b / NS_PER_S:.3f} s" for n, (a, b) in spans.items())
        raise ConfigError("command line", "times", "streams that overlap (--time-unit, --shift-...)", told)


def _stands_s(made: Imported) -> float:
    """Time at the start during which no wheel moves."""
    if made.rows is None:
        return 0.0
    rows = made.rows
    left, right = (rows.left[0], rows.right[0]) if rows.are_counts else (0.0, 0.0)
    moves = (rows.left != left) | (rows.right != right)
    first = int(np.argmax(moves)) if moves.any() else len(moves) - 1
    return float(rows.time_ns[max(0, first - 1)] - rows.time_ns[0]) / NS_PER_S
