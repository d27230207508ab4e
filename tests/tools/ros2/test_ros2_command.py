import sys
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest

import drd_tools.ros2
from drd.cli import main
from drd_tools.ros2.command import _parser

LAUNCH = Path(drd_tools.ros2.__file__).parent / "drd.launch.xml"


def test_without_rclpy_the_command_says_where_it_comes_from(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "rclpy", None)
    assert main(["ros2"]) == 2
    said = capsys.readouterr().err
    assert "setup.bash" in said
    assert "drd[ros2]" in said


def test_the_launch_file_calls_the_command_with_its_arguments() -> None:
    launch = ET.parse(LAUNCH).getroot()
    defaults = {arg.attrib["name"]: arg.attrib["default"] for arg in launch.iter("arg")}
    executable = launch.find("executable")
    assert executable is not None
    text = executable.attrib["cmd"]
    for name, default in defaults.items():
        assert f"$(var {name})" in text
        text = text.replace(f"$(var {name})", default)
    words = text.split()
    assert words[:2] == ["drd", "ros2"]
    given = _parser().parse_args(words[2:]).ros_args
    assert given[-1] == "topics.tf:=/tf"
    assert "connect:=tcp/127.0.0.1:7447" in given
