"""`drd calibrate noise`: warm-up, bias and noise of the gyro, from a log at standstill."""

import argparse
import math
import sys
from pathlib import Path
from typing import Final

from tqdm import tqdm

from drd.commands import command, number, writing
from drd.config.file import load_config
from drd.config.schema import ConfigError
from drd_tools.calibrate.fog_recorder import Progress, RecordingError, SampleFile, gyro_of, record
from drd_tools.calibrate.noise.analysis import STEPS, GyroNoise, analyse
from drd_tools.calibrate.noise.report import allan_picture, noise_page, warm_up_picture
from drd_tools.calibrate.noise.static_log import FILE_NAME, SHORTEST_S, read_static_log
from drd_tools.calibrate.noise.text import HEADER, rows, sentences, snippet
from drd_tools.report.terminal import print_table

LOG_HEADER: Final = ("time_s", "rate_deg_s", "temperature_c")
# The live display compares means over the last minutes; a difference of more than so many sigmas is a drift.
DRIFT_WINDOW_S: Final = 300.0
DRIFT_SIGMAS: Final = 3.0

DESCRIPTION: Final = """\
Estimate the gyro's noise terms, bias and warm-up from a log at standstill (Allan deviation), and write them as keys of
the daemon's configuration. Mount the gyro where nothing disturbs it, start the log when you switch the gyro on, and let
it run for an hour or more: slow terms need averaging times of a third of the log.

LOG is a CSV file with the columns time_s (s), rate_deg_s (deg/s, each row the mean since the row before) and, where
known, temperature_c (degC); or a recording's folder with such a fog.csv. With --live the log is recorded from the
gyro of the configuration CONFIG into DIR/fog.csv; the daemon must not be running. Ctrl-C ends the recording early, and
what has been recorded is analysed.
"""
EPILOG: Final = """\
written into DIR:
  noise.yaml    lines for the daemon's configuration, with uncertainty and provenance
  report.html   all of it on one page
  allan.png     the Allan deviation with the fitted terms
  warmup.png    the bias, and the temperature, over time

examples:
  drd calibrate noise fog.csv --output noise
  drd calibrate noise fog.csv --skip 1200
  drd calibrate noise --live mybot.yaml --seconds 7200 --output noise

Exit code: 0 done, 1 the recording failed, 2 bad usage or input.
"""


def main(argv: list[str]) -> int:
    """Run the command. Returns 0, or 1 if recording failed; the caller reports ConfigError."""
    parser = _parser()
    arguments = parser.parse_args(argv)
    if (arguments.log is None) == (arguments.live is None):
        parser.error("give either LOG or --live CONFIG")
    folder: Path = arguments.output
    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)
    log = arguments.log
    if arguments.live is not None:
        log = folder / FILE_NAME
        if not _record(arguments.live, log, arguments.seconds):
            return 1
    whole = read_static_log(log)
    with tqdm(total=STEPS, desc="simulating such logs", disable=None, leave=False) as shown:
        result = analyse(whole, arguments.skip, on_step=shown.update)
    print(f"Gyro noise from {log}\n")
    print_table(HEADER, rows(result), text=range(len(HEADER)))
    print()
    print("\n".join(sentences(result)), end="\n\n")
    with writing(folder):
        for file in _write(folder, result):
            print(f"wrote {file}")
    print(f"Merge {folder / 'noise.yaml'} into the section `estimation` of the configuration.")
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = command("drd calibrate noise", DESCRIPTION, EPILOG)
    add = parser.add_argument
    add("log", type=Path, nargs="?", metavar="LOG", help="CSV file, or folder with fog.csv")
    add("--output", type=Path, default=Path("noise"), metavar="DIR", help="default: ./noise")
    add("--live", type=Path, metavar="CONFIG", help="record the gyro of this configuration first")
    longest_s = 7 * 86_400.0
    text = "length of the recording (default 3600)"
    add("--seconds", type=number(SHORTEST_S, longest_s), default=3600.0, metavar="S", help=text)
    text = "skip the first S seconds instead of the detected warm-up"
    add("--skip", type=number(0.0), metavar="S", help=text)
    return parser


def _write(folder: Path, result: GyroNoise) -> list[Path]:
    names = ("noise.yaml", "allan.png", "warmup.png", "report.html")
    noise, allan, warm_up, page = files = [folder / name for name in names]
    noise.write_text(snippet(result), encoding="utf-8")
    allan_picture(allan, result)
    warm_up_picture(warm_up, result)
    noise_page(page, result, allan, warm_up)
    return files


class Drift:
    """Detector of a drifting bias, from the means of two consecutive windows."""

    def __init__(self, window_s: float = DRIFT_WINDOW_S):
        self._window_s, self._ends_s = window_s, window_s
        self._means: list[tuple[float, float]] = []  # mean and its sigma, deg/s
        self._samples, self._sum, self._squares = 0, 0.0, 0.0

    def feed(self, progress: Progress) -> str:
        """Update with the recording so far; return a text on the drift."""
        if progress.recorded_s >= self._ends_s:
            n = max(progress.samples - self._samples, 1)
            mean = (progress.sum_deg - self._sum) / n
            spread = (progress.sum_squares - self._squares) / n - mean**2
            self._means.append((mean, math.sqrt(max(spread, 0.0) / n)))
            self._samples, self._sum, self._squares = progress.samples, progress.sum_deg, progress.sum_squares
            self._ends_s = progress.recorded_s + self._window_s
        if len(self._means) < 2:
            return f"drift: known after {2 * self._window_s / 60.0:.0f} min"
        (before, before_sigma), (after, after_sigma) = self._means[-2:]
        moved = after - before
        steady = abs(moved) <= DRIFT_SIGMAS * math.hypot(before_sigma, after_sigma)
        return (
            "steady" if steady else f"still warming up: {moved * 3600.0:+.2g} deg/h in {self._window_s / 60.0:.0f} min"
        )


def _record(config_file: Path, file: Path, seconds: float) -> bool:
    """Record the log; return False if too little came to be analysed."""
    config = load_config(config_file).value
    fog = gyro_of(config, str(config_file))
    if file.exists():
        raise ConfigError(str(file), "", "a new file for the recording", "one that exists; choose another --output")
    print(f"Recording {seconds:g} s from {fog.port} into {file}. Do not touch the gyro; Ctrl-C ends it early.")
    drift, bar = Drift(), "{percentage:3.0f} %|{bar}| {n:.0f} of {total:.0f} s {postfix}"
    recorded_s = 0.0
    with (
        SampleFile(file, LOG_HEADER) as samples,
        tqdm(total=seconds, bar_format=bar, disable=None, leave=False) as shown,
    ):

        def on_progress(progress: Progress) -> None:
            nonlocal recorded_s
            recorded_s = progress.recorded_s
            warmth = "" if math.isnan(progress.temperature_c) else f", {progress.temperature_c:.1f} degC"
            shown.set_postfix_str(
                f"mean {progress.mean_deg_s:+.5f} deg/s{warmth}, {drift.feed(progress)}", refresh=False
            )
            shown.update(min(progress.recorded_s, seconds) - shown.n)

        trouble = ""
        try:
            record(config, seconds, samples.add, on_progress)
        except RecordingError as failed:
            trouble = str(failed)
        except KeyboardInterrupt:
            trouble = "ended by Ctrl-C"
    if not trouble:
        return True
    if recorded_s < SHORTEST_S:
        print(f"drd calibrate noise: {trouble}; {recorded_s:.0f} s in {file} are too few", file=sys.stderr)
        if recorded_s == 0.0:
            file.unlink(missing_ok=True)
        return False
    print(f"{trouble}; the {recorded_s:.0f} s that were recorded are analysed.", file=sys.stderr)
    return True
