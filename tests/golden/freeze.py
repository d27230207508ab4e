"""Freezes today's file formats: `PYTHONPATH=tests python tests/golden/freeze.py VERSION`, before one of them changes.

The folder tests/golden/VERSION gets a file of each format as this version writes it; test_golden.py asks of every later
version that it reads them. A folder that is there is never written again.
"""

import json
import shutil
import sys
import tempfile
from pathlib import Path

import diagnosis_files
import recorded_drive
from recorded_drive import drive, recordings

from drd.effects.catalogue import catalogue
from drd.effects.effect import Parameter
from drd.effects.model import load_model, make_model, save_model
from drd.estimation.calibration import load_calibration
from drd.estimation.estimate import Estimate
from drd.monitor.memory import DAY_NS, EARLIEST_NS, Day, Memory
from drd.pipeline import Pipeline
from drd.recording.in_force import AS_WRITTEN, IN_FORCE, files_in_force
from drd.state import memory_file, saved
from drd.state.saved import Moment, Saved
from drd_tools.diagnose import files as diagnosis
from drd_tools.recordings.mcap_file import open_mcap

HERE = Path(__file__).parent
MOMENT = Moment(1_800_000_000_123_456_789, 5_000_000_000, "0123456789abcdef")
# Beyond the last command of the recorded drive.
SECONDS = 13.0
DIAGNOSED_S = 50.0


def main(version: str) -> None:
    """Write tests/golden/VERSION. Raises FileExistsError where it is there."""
    folder = HERE / version
    folder.mkdir()
    with tempfile.TemporaryDirectory(prefix="drd-golden-") as name:
        work = Path(name)
        estimate = _recording(work, folder)
        shutil.copy(work / "calibration.yaml", folder)
    _model(folder / "model.yaml")
    days = [Day(EARLIEST_NS + i * DAY_NS, 1e3 + i / 3, (0.1, -1e-3, 0.1 + i / 7), (1e-3, 1e-4, 0.1)) for i in range(9)]
    (folder / "golden.memory").write_bytes(memory_file.encoded(Memory("0" * 64, days)))
    diagnosis_files.DURATION_S = DIAGNOSED_S
    diagnosis.save(folder, *diagnosis.load(diagnosis_files.write(folder, diagnosis_files.one_finding())))
    expected = {
        "x_m": estimate.nominal.x_m,
        "messages": _counts(folder / "run.mcap"),
        "days": len(days),
        "gyro_error_deg_s": load_calibration(folder / "calibration.yaml").error_deg_s(30.0, 20.0),
        "effects": {t.effect.id: len(t.parameters) for t in load_model(folder / "model.yaml").terms},
        "findings": [f.effect for f in diagnosis.load(folder)[0].findings],
    }
    (folder / "expected.json").write_text(json.dumps(expected, indent=1) + "\n")


def _recording(work: Path, folder: Path) -> Estimate:
    """A run that begins warm, with each kind of event; its configuration, with every key stated, and its state."""
    recorded_drive.CONFIG = recorded_drive.CONFIG.replace("{{name: my robot/1,", "{{name: golden,")
    before = drive(work, "viewers: false")
    before.start()
    before.run(5.0)
    before.recorder.close(5.0)
    estimate = before.pipeline.estimator.estimate()
    assert estimate is not None
    for file in recordings(work):
        file.unlink()
    live = drive(work, "viewers: false")
    live.start()
    live.pipeline.resume(0, estimate, True)
    files = {name: text.decode() for name, text in files_in_force(live.loaded, work).items() if name != AS_WRITTEN}

    def reload(tick: int) -> None:
        if tick == 200:
            fresh = Pipeline(live.loaded.value, work, lambda *_: None)
            live.pipeline.reload(live.poses[-1].t_ns, fresh, files)

    live.run(SECONDS, reload)
    live.recorder.health_report(live.pipeline.health(0) | {"monotonic_ns": 0})
    assert live.recorder.close(5.0)
    (file,) = recordings(work)
    shutil.copy(file, folder / "run.mcap")
    (folder / "robot.yaml").write_text(files[IN_FORCE].replace(str(work), "/var/lib/drd-golden"))
    last = live.pipeline.estimator.estimate()
    assert last is not None
    (folder / "golden.state").write_bytes(saved.encoded(Saved(last, MOMENT, live.pipeline.basis, "golden")))
    return last


def _model(file: Path) -> None:
    """Each effect of the catalogue in the middle of its plausible range."""
    effects = [{"effect": e.id, "parameters": {p.name: _middle(p) for p in e.parameters}} for e in catalogue().values()]
    robot = {"tread_m": 0.55, "wheel": {"radius_m": 0.11}}
    save_model(file, make_model(effects, robot, recording="golden", who="a test"))


def _middle(parameter: Parameter) -> object:
    if parameter.choices:
        return parameter.choices[0]
    return {"value": (parameter.low + parameter.high) / 2, "std": parameter.high / 100, "unit": parameter.unit}


def _counts(file: Path) -> dict[str, int]:
    found: dict[str, int] = {}
    for message in open_mcap(file).messages():
        found[message.topic] = found.get(message.topic, 0) + 1
    return found


if __name__ == "__main__":
    main(sys.argv[1])
