"""What is in force in a replay: robot.yaml, and what overrules it."""

from dataclasses import replace
from pathlib import Path

import pytest
from replay_folders import long_drive, short_drive, write_perfect

from drd.cli import main
from drd.config.keys import Config
from drd.config.schema import ConfigError
from drd_tools.recordings.folder import Recording, read_recording
from drd_tools.replay.folder_source import replay_folder
from drd_tools.replay.nominal import configuration, with_model

CALIBRATION = """format: drd-gyro-calibration/1
error_deg_s: {{a0: [{bias}, 0, 0], a1: [0.01, 0, 0], a2: [0, 0, 0], a3: [0, 0, 0]}}
rate_range_deg_s: [-80, 80]
temperature_range_c: [-10, 40]
residual_deg_s: 0.001
provenance: {{source: test}}
"""


@pytest.fixture(scope="module")
def with_gyro(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    return long_drive(tmp_path_factory.mktemp("gyro"))


@pytest.fixture(scope="module")
def short(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    return short_drive(tmp_path_factory.mktemp("short"))


def test_robot_yaml_is_the_nominal_model(short: Recording) -> None:
    nominal = replace(
        short.nominal,
        gyro_angle_random_walk_deg_per_sqrt_h=0.1,
        gyro_bias_random_walk_deg_per_h_per_sqrt_h=5.0,
        gyro_bias_repeatability_deg_s=0.03,
    )
    config = configuration(replace(short, nominal=nominal))
    noise = config.estimation.noise
    assert (config.robot.wheel_radius_m, config.robot.tread_m, config.encoders.counts_per_revolution) == (
        0.1,
        0.5,
        4000,
    )
    assert (noise.gyro_deg_per_sqrt_h, noise.gyro_bias_deg_h_per_sqrt_h, noise.gyro_bias_repeatability_deg_s) == (
        0.1,
        5.0,
        0.03,
    )
    assert config.estimation.initial.gyro_bias_deg_s == 0.03
    assert noise.wheel_m_per_sqrt_m == 1e-6
    assert (config.fog.full_scale_deg_s, config.fog.rate_hz, config.encoders.rate_hz) == (100.0, 10.0, 20.0)
    assert config.estimation.static_bias.duration_s == 12.0


def test_a_mems_gyro_is_not_taken_for_a_fog(short: Recording) -> None:
    nominal = replace(short.nominal, gyro_kind="MEMS", gyro_angle_random_walk_deg_per_sqrt_h=0.2)
    mems = configuration(replace(short, nominal=nominal)).estimation
    fog = configuration(short).estimation
    assert mems.noise.gyro_deg_per_sqrt_h == 0.2  # what is stated is kept
    assert mems.initial.gyro_bias_deg_s > 5.0 * fog.initial.gyro_bias_deg_s


def test_a_configuration_replaces_what_it_states_and_nothing_else(short: Recording, tmp_path: Path) -> None:
    file = tmp_path / "robot.yaml"
    file.write_text(
        "robot: {wheel_radius_m: 0.2, tread_m: 0.6, left_scale: 1.01}\nencoders: {counts_per_revolution: 4000}\n"
        "estimation: {noise: {turn_rad_per_sqrt_rad: 0.07}}\n"
    )
    config = replay_folder(short, file).config
    assert (config.robot.wheel_radius_m, config.robot.tread_m, config.robot.left_scale) == (0.2, 0.6, 1.01)
    assert config.estimation.noise.turn_rad_per_sqrt_rad == 0.07
    assert config.estimation.noise.wheel_m_per_sqrt_m == 1e-6
    assert config.estimation.static_bias.duration_s == 12.0
    assert config.fog.positive == "counterclockwise"
    assert config.robot.max_speed_m_s == 10.0


@pytest.mark.parametrize("as_speeds", [True, False])
def test_any_part_of_a_configuration_will_do(tmp_path: Path, as_speeds: bool) -> None:
    folder = write_perfect(tmp_path / "drive", gyro=True, as_speeds=as_speeds, legs=((0.0, 0.0, 1.0), (0.5, 0.3, 4.0)))
    recording, file = read_recording(folder), tmp_path / "part.yaml"
    believed = configuration(recording)

    def with_part(text: str) -> Config:
        file.write_text(text)
        return replay_folder(recording, file).config

    estimation, robot = believed.estimation, believed.robot
    assert with_part("") == believed
    narrow = replace(estimation, gate_sigma=3.0)
    assert with_part("estimation: {gate_sigma: 3}") == replace(believed, estimation=narrow)
    assert with_part("robot: {tread_m: 0.6}") == replace(believed, robot=replace(robot, tread_m=0.6))
    assert with_part("robot: {wheel_radius_m: 0.2}") == replace(believed, robot=replace(robot, wheel_radius_m=0.2))


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("robot:\n  tread: 0.6\n", r"part.yaml:2: robot.tread: expected one of .*an unknown key"),
        ("estimation:\n  gate_sigma: wide\n", r"part.yaml:2: estimation.gate_sigma: expected a number .*got 'wide'"),
        ("encoders: {latency_s: -0.1}\n", r"part.yaml:1: encoders.latency_s: expected a number in s from 0 to 1"),
        ("encoders: {counts_per_revolution: null}\n", r"part.yaml:1: encoders.counts_per_revolution: .*has counts"),
        ("fog: {latency_s: 0.4}\n", r"part.yaml: estimation.reorder_s: expected more than a gyro sample's age"),
        ("fog: {protocol: none}\nestimation: {heading: gyro}\n", r"part.yaml:2: estimation.heading: expected filter"),
        ("- robot\n", r"expected a section of keys"),
    ],
)
def test_a_part_that_cannot_be_used_is_refused(short: Recording, tmp_path: Path, text: str, expected: str) -> None:
    file = tmp_path / "part.yaml"
    file.write_text(text)
    with pytest.raises(ConfigError, match=expected):
        replay_folder(short, file)


def test_the_daemon_still_refuses_a_part(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "part.yaml"
    file.write_text("robot: {tread_m: 0.6}\n")
    for command in ("run", "check"):
        assert main([command, str(file)]) == 2
        assert "robot.wheel_radius_m: expected a number in m" in capsys.readouterr().err


def test_a_configuration_without_gyro_gives_odometry_alone(with_gyro: Recording, tmp_path: Path) -> None:
    file = tmp_path / "robot.yaml"
    file.write_text(
        "robot: {wheel_radius_m: 0.1, tread_m: 0.5}\nencoders: {counts_per_revolution: 4000}\nfog: {protocol: none}\n"
    )
    replayed = replay_folder(with_gyro, file)
    assert replayed.samples["gyro"] == 0
    assert replayed.counters["estimator"]["accepted"] == 0
    assert len(replayed.poses) == replayed.samples["wheels"]


def test_a_configuration_with_the_gyros_heading_needs_a_gyro(short: Recording, tmp_path: Path) -> None:
    file = tmp_path / "robot.yaml"
    file.write_text(
        "robot: {wheel_radius_m: 0.1, tread_m: 0.5}\nencoders: {counts_per_revolution: 4000}\n"
        "output: {publish_on: gyro}\nestimation:\n  heading: gyro\n"
    )
    assert replay_folder(short, file).poses
    with pytest.raises(ConfigError, match=r"robot.yaml:5: estimation.heading: .*the recording has no gyro"):
        replay_folder(replace(short, fog=None), file)


def test_the_calibration_is_applied_wherever_it_is_named(with_gyro: Recording, tmp_path: Path) -> None:
    plain, config = tmp_path / "plain.yaml", tmp_path / "named.yaml"
    plain.write_text("robot: {wheel_radius_m: 0.1, tread_m: 0.5}\nencoders: {counts_per_revolution: 4000}\n")
    config.write_text(plain.read_text() + "calibration: {file: gyro.yaml}\n")
    tmp_path.joinpath("gyro.yaml").write_text(CALIBRATION.format(bias=0.1))
    tmp_path.joinpath("other.yaml").write_text(CALIBRATION.format(bias=0.2))
    digests = [
        replay_folder(with_gyro, plain).digest(),
        replay_folder(with_gyro, config).digest(),
        replay_folder(with_gyro, plain, tmp_path / "gyro.yaml").digest(),
        replay_folder(with_gyro, config, tmp_path / "other.yaml").digest(),
    ]
    assert digests[0] != digests[1]
    assert digests[1] == digests[2]
    assert digests[3] not in digests[:3]


def test_a_model_changes_the_nominal_robot(short: Recording, tmp_path: Path) -> None:
    file = tmp_path / "model.yaml"
    file.write_text("tread_m: 0.55\nwheel: {radius_m: 0.11}\neffects: []\n")
    changed = with_model(short, file).nominal
    assert changed.counts_per_revolution == 4000
    assert changed == replace(short.nominal, tread_m=0.55, wheel_radius_m=0.11)


def test_what_a_model_has_null_stays_as_it_is(short: Recording, tmp_path: Path) -> None:
    file = tmp_path / "model.yaml"
    file.write_text("tread_m: null\nwheel: {radius_m: null}\neffects: []\n")
    assert with_model(short, file).nominal == short.nominal


def test_robot_yaml_may_state_how_the_robot_steers_and_its_top_speed(short: Recording) -> None:
    config = configuration(replace(short, nominal=replace(short.nominal, drive="skid", max_speed_m_s=2.0)))
    assert (config.robot.drive, config.robot.max_speed_m_s) == ("skid", 2.0)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("effects: [{id: gyro_lag, tau: 0.1}]\n", r"effects\[0\].id: expected one of effect, .*an unknown key"),
        ("track_m: 1\n", r"model.yaml:1: track_m: expected one of .*an unknown key"),
        ("tread_m: -1\n", r"model.yaml:1: tread_m: expected a number in m from 0.01"),
        (
            "wheel: {counts_per_revolution: null}\n",
            r"model.yaml:1: wheel.counts_per_revolution: .*encoders.csv has counts",
        ),
        ("[1, 2]\n", r"expected a section of keys"),
        ("{", r"expected YAML"),
    ],
)
def test_a_model_that_cannot_be_used_is_refused(short: Recording, tmp_path: Path, text: str, expected: str) -> None:
    file = tmp_path / "model.yaml"
    file.write_text(text)
    with pytest.raises(ConfigError, match=expected):
        with_model(short, file)
