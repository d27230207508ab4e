"""Recording on a rotary table, step by step, one file per rate."""

import math
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from tqdm import tqdm

from drd.commands import writing
from drd.config.file import load_config
from drd.config.keys import Config
from drd.config.schema import ConfigError
from drd_tools.calibrate.fog_recorder import Progress, RecordingError, SampleFile, gyro_of, record

HEADER: Final = ("time_s", "table_rate_deg_s", "rate_deg_s", "temperature_c")
ENOUGH_PART: Final = 0.8
# The gyro's scale is known to 1 % but the table's rate is only read off: a larger difference is another rate.
MEAN_PART: Final = 0.2
# At rest the mean is the bias and the Earth's rate.
MEAN_AT_REST_DEG_S: Final = 1.0
# A table less steady than this is no reference; a gyro scatters by 0.1 deg/s or so.
SCATTER_PART: Final = 0.05
SCATTER_DEG_S: Final = 0.5


def record_steps(config_file: Path, folder: Path, rates_deg_s: Sequence[float], seconds: float) -> list[Path]:
    """Guide the user through the table's rates (deg/s, counter-clockwise positive); record `seconds` at each.

    Asks on standard input: Enter records, s skips the rate, q ends. Each step becomes a CSV file in `folder` with
    the columns HEADER, in which the rate is the daemon's before bias and calibration (counter-clockwise positive,
    after sign and axis) and the temperature is empty if the gyro sends none. Returns the files that were kept.
    Raises ConfigError if the configuration or the folder cannot be used.
    """
    config = load_config(config_file).value
    gyro_of(config, str(config_file))
    if not rates_deg_s or not all(map(math.isfinite, rates_deg_s)) or not (math.isfinite(seconds) and seconds > 0):
        got = f"{list(rates_deg_s)} and {seconds:g} s"
        raise ConfigError("table", "", "at least one finite rate and a time above 0", got)
    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)
        taken = sorted(folder.glob("step_*.csv"))
    if taken:
        raise ConfigError(str(folder), "", "a folder without earlier steps", taken[0].name)
    print(f"{len(rates_deg_s)} steps of {seconds:g} s from {config.fog.port}; rates are counter-clockwise positive.")
    kept: list[Path] = []
    for number, rate_deg_s in enumerate(rates_deg_s, start=1):
        file = folder / f"step_{number:02}_{rate_deg_s:+g}_deg_s.csv"
        print(f"\nStep {number} of {len(rates_deg_s)}")
        answer = _step(config, file, rate_deg_s, seconds)
        if answer == "q":
            print(f"Ended; {len(kept)} of {len(rates_deg_s)} steps were kept.")
            break
        if answer == "":
            kept.append(file)
    return kept


def _step(config: Config, file: Path, rate_deg_s: float, seconds: float) -> str:
    """Record one rate, repeating it as the user wishes. Returns "" (kept, the only case with a file), "s" or "q"."""
    while True:
        answer = _ask(
            f"Set the table to {rate_deg_s:+g} deg/s, wait until it is steady, press Enter (s: skip, q: quit) "
        )
        if answer in {"s", "q"}:
            return answer
        try:
            progress = _record(config, file, rate_deg_s, seconds)
        except (RecordingError, KeyboardInterrupt) as error:
            print(f"Not recorded: {error or 'stopped'}.", file=sys.stderr)
            file.unlink(missing_ok=True)
            continue
        print(_summary(file, progress))
        doubts = doubts_about(progress, rate_deg_s, seconds, config.fog.rate_hz)
        for doubt in doubts:
            print(f"Warning: {doubt}")
        answer = _ask("Repeat it? Enter: repeat, k: keep it all the same, s: skip, q: quit ") if doubts else "k"
        if answer == "k":
            return ""
        file.unlink(missing_ok=True)
        if answer in {"s", "q"}:
            return answer


def _record(config: Config, file: Path, rate_deg_s: float, seconds: float) -> Progress:
    bar = "{desc} {percentage:3.0f} %|{bar}| {n:.0f} of {total:.0f} s {postfix}"
    with (
        SampleFile(file, HEADER, (f"{rate_deg_s:.9g}",)) as samples,
        tqdm(total=seconds, desc=f"{rate_deg_s:+g} deg/s", bar_format=bar, disable=None, leave=False) as shown,
    ):

        def on_progress(progress: Progress) -> None:
            shown.set_postfix_str(f"mean {progress.mean_deg_s:+.3f} deg/s", refresh=False)
            shown.update(min(progress.recorded_s, seconds) - shown.n)

        return record(config, seconds, samples.add, on_progress)


def doubts_about(progress: Progress, rate_deg_s: float, seconds: float, rate_hz: float) -> list[str]:
    """Sentences on what looks wrong with a step; `rate_hz` is the gyro's nominal rate."""
    mean, sigma, found = progress.mean_deg_s, progress.sigma_deg_s, []
    expected = seconds * rate_hz
    if progress.samples < max(2.0, ENOUGH_PART * expected):
        found.append(f"only {progress.samples} samples came in {seconds:g} s where {expected:.0f} were expected.")
    if progress.samples >= 2 and sigma == 0.0:
        found.append("the reading never changes: is the gyro alive?")
    limit = max(SCATTER_PART * abs(rate_deg_s), SCATTER_DEG_S)
    if sigma > limit:
        found.append(f"the readings scatter by {sigma:.3g} deg/s (limit {limit:.3g}): was the table steady?")
    allowed = max(MEAN_PART * abs(rate_deg_s), MEAN_AT_REST_DEG_S if rate_deg_s == 0.0 else 0.0)
    if abs(mean - rate_deg_s) > allowed:
        opposite = rate_deg_s and abs(mean + rate_deg_s) <= allowed
        hint = "the other way round: the table's direction, or fog.positive?" if opposite else "is the table turning?"
        found.append(f"the mean is {mean:+.4g} deg/s, the table's rate {rate_deg_s:+g}: {hint}")
    return found


def _summary(file: Path, progress: Progress) -> str:
    if math.isnan(progress.temperature_c):
        warmth = "no temperature: this gyro sends none, so it cannot be calibrated over temperature"
    else:
        warmth = f"{progress.temperature_c:.1f} degC"
    return (
        f"{file.name}: {progress.samples} samples, mean {progress.mean_deg_s:+.4f} deg/s, scatter "
        f"{progress.sigma_deg_s:.4f} deg/s, {warmth}"
    )


def _ask(question: str) -> str:
    """First letter of the answer, in lower case; "" for Enter, "q" for Ctrl-C or the end of the input."""
    try:
        return input(question).strip().lower()[:1]
    except (EOFError, KeyboardInterrupt):
        print()
        return "q"
