"""The daemon's recording of a simulated drive, with the drive's reference beside it."""

from pathlib import Path

from drd.config.keys import Config
from drd.config.schema import Loaded
from drd.units import DEG_PER_RAD
from drd_tools.emulate.raw import write_mcap
from drd_tools.recordings.daemon_log import reference_file
from drd_tools.replay.nominal import configuration
from drd_tools.simulate.simulator import Simulated


def daemon_log(file: Path, run: Simulated, reference: bool = True, config: Config | None = None) -> Path:
    """Write FILE.mcap, and FILE.reference.csv."""
    file.parent.mkdir(parents=True, exist_ok=True)
    config = configuration(run.recording) if config is None else config
    write_mcap(file, run.recording, Loaded(config, {}), file.parent)
    log = run.recording.reference
    if reference and log is not None:
        rows = zip(log.time_s, log.x_m, log.y_m, log.heading_rad * DEG_PER_RAD, strict=True)
        text = "".join(f"{t:.6f},{x:.6f},{y:.6f},{h:.6f}\n" for t, x, y, h in rows)
        reference_file(file).write_text("time_s,x_m,y_m,heading_deg\n" + text)
    return file
