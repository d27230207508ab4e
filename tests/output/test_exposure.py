from pathlib import Path

import pytest

from drd.cli import main
from drd.config.keys import Output
from drd.output.exposure import exposure

SHIPPED = Path(__file__).parents[2] / "config" / "zenoh-tls.json5"


@pytest.mark.parametrize("endpoint", ["tcp/127.0.0.1:7447", "tcp/localhost:0", "tcp/[::1]:0", "unixsock-stream//a/b"])
def test_what_stays_on_this_machine_is_no_exposure(endpoint: str) -> None:
    assert exposure(Output(listen=(endpoint,), commands=True)) == []


@pytest.mark.parametrize("endpoint", ["tcp/0.0.0.0:7447", "tcp/[::]:7447", "udp/192.168.1.10:7447", "tcp/mybot:7447"])
def test_an_open_door_is_named_with_what_it_gives(endpoint: str) -> None:
    [text] = exposure(Output(listen=("tcp/127.0.0.1:1", endpoint)))
    assert text.startswith(f"output.listen: anyone who reaches {endpoint} can read the robot's pose:")
    [text] = exposure(Output(listen=(endpoint,), commands=True))
    assert "and change it (output.commands)" in text


def test_the_shipped_tls_file_is_no_exposure() -> None:
    assert exposure(Output(zenoh_config=str(SHIPPED), commands=True)) == []


@pytest.mark.parametrize(
    ("line", "instead", "text"),
    [
        ("enable_mtls: true", "enable_mtls: false", "enable_mtls is not true"),
        ("access_control: {\n    enabled: true", "access_control: {\n    enabled: false", "access_control is off"),
        ("multicast: { enabled: false }", "multicast: { enabled: true }", "multicast"),
        ('endpoints: ["tls/0.0.0.0:7447"]', 'endpoints: { peer: ["tcp/0.0.0.0:7447"] }', "no encryption"),
    ],
)
def test_what_is_opened_in_the_tls_file_is_named(tmp_path: Path, line: str, instead: str, text: str) -> None:
    shipped = SHIPPED.read_text()
    assert line in shipped
    file = tmp_path / "zenoh.json5"
    file.write_text(shipped.replace(line, instead))
    [found] = exposure(Output(zenoh_config=str(file)))
    assert text in found
    assert found.startswith(str(file))


def test_check_tells_what_is_open_and_which_file_is_missing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    robot = "robot: {wheel_radius_m: 0.1, tread_m: 0.5}\nencoders: {counts_per_revolution: 4096}\n"
    file = tmp_path / "robot.yaml"
    file.write_text(robot + "output: {listen: [tcp/0.0.0.0:7447]}\n")
    assert main(["check", str(file)]) == 0
    assert "note: output.listen: anyone who reaches tcp/0.0.0.0:7447 can read" in capsys.readouterr().out
    (tmp_path / "tls.json5").write_text(SHIPPED.read_text().replace("/etc/drd/tls", str(tmp_path)))
    file.write_text(robot + "output: {zenoh_config: tls.json5}\n")
    assert main(["check", str(file)]) == 0
    notes = [line for line in capsys.readouterr().out.splitlines() if line.startswith("note: ")]
    assert [note.split()[1] for note in notes] == ["root_ca_certificate", "listen_certificate", "listen_private_key"]
