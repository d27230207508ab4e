"""The daemon's recording of a simulated drive, with the drive's reference beside it."""

from pathlib import Path

from drd.config.keys import Config
from drd.config.schema import Loaded
from drd.recording.file import RecordingFile
from drd.recording.topics import Message
from drd.units import DEG_PER_RAD
from drd_tools.emulate.raw import write_mcap
from drd_tools.recordings.daemon_log import reference_file
from drd_tools.recordings.mcap_file import open_mcap
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


def in_parts(file: Path, run: str, count: int) -> list[Path]:
    """Split FILE.mcap into `count` parts of a run, equally long, in the same folder; remove FILE.mcap."""
    whole = open_mcap(file)
    messages = list(whole.messages())
    end = messages[-1].log_ns + 1
    span, first = end - messages[0].log_ns, messages[0].log_ns
    paths = [file.with_name(f"{run}-{k + 1:04}.mcap") for k in range(count)]
    parts = [
        RecordingFile(path, {**whole.information, "part": str(k + 1)}, whole.attachments, first)
        for k, path in enumerate(paths)
    ]
    for m in messages:
        parts[(m.log_ns - first) * count // span].add(Message(m.topic, m.log_ns, m.data), m.number, m.log_ns, m.log_ns)
    for part in parts:
        part.finish({})
    if reference_file(file).exists():
        reference_file(file).rename(reference_file(paths[-1]))
    file.unlink()
    return paths
