"""When the state is written."""

from pathlib import Path

import pytest
from recorded_drive import CONFIG
from sensors import T0, S, drive

from drd.config.keys import Config
from drd.config.schema import loads
from drd.pipeline import Pipeline
from drd.samples import GyroSample, WheelSample
from drd.state.keeper import StateKeeper
from drd.state.saved import Saved
from drd.state.store import Store

STAND_S = 20.0


@pytest.fixture
def written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[tuple[float, Saved]]:
    """Times and states of a robot that stands for 20 s and then drives for 20 s, written each 6 s."""
    text = CONFIG.format(folder=tmp_path, recording="", calibration="null").replace("enabled: true", "enabled: false")
    config = loads(text + f"state: {{folder: {tmp_path}, period_s: 6}}\n", Config).value
    pipeline = Pipeline(config, tmp_path, lambda *_: None)
    puts: list[tuple[float, Saved]] = []
    now_s = 0.0
    monkeypatch.setattr(Store, "put", lambda _, saved: puts.append((now_s, saved)))
    keeper = StateKeeper(config, pipeline)
    keeper.begin(1)
    keeper.tick(T0)
    assert puts == []  # nothing is known before the wheels are heard
    for now_s, sample in drive(40, stand_s=STAND_S):
        if isinstance(sample, GyroSample):
            pipeline.estimator.add_gyro(sample)
        elif isinstance(sample, WheelSample):
            pipeline.estimator.add_wheels(sample)
        keeper.tick(T0 + round(now_s * S))
    assert keeper.close(10.0)
    return puts


def test_each_period_at_once_when_it_starts_to_move_and_at_the_end(written: list[tuple[float, Saved]]) -> None:
    assert [t for t, _ in written] == pytest.approx([0.05, 6.05, 12.05, 18.05, 20.05, 26.05, 32.05, 38.05, 40.0])
    assert [s.estimate.at_rest for _, s in written] == [t <= STAND_S for t, _ in written]
    assert written[-1][1].estimate.speed_m_s == pytest.approx(1.0, abs=0.01)
    assert {s.robot for _, s in written} == {"my robot/1"}
    assert written[0][1].basis.wheels["robot.tread_m"] == 0.6
