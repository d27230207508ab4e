import asyncio
import contextlib
import dataclasses
import json
import os
import pty
import re
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from links import free_endpoint

from drd.commands.pose_lines import pose_line
from drd.commands.watch import View, main
from drd.config.keys import Output
from drd.output.messages import encode, pose_json
from drd.output.zenoh_link import ZenohLink
from drd.samples import Pose, Reason, Validity

REASONS = (Reason("encoders", "silent", 1_000_000_000),)
POSE = Pose(
    3_500_000_000,
    2,
    3.25,
    -4.5,
    0.5,
    1.0,
    0.1,
    0.01,
    0.001,
    (0.04, 0, 0, 0.09, 0, 0.0001),
    0.75,
    Validity.DEGRADED,
    REASONS,
)


@contextlib.contextmanager
def a_daemon(poses: bool = True) -> Iterator[str]:
    """Publishes poses and a health whose counter grows, until the test is over."""
    endpoint, stop = free_endpoint(), threading.Event()
    loop = asyncio.new_event_loop()
    handlers = dict.fromkeys(("pose", "health", "config", "set_pose", "reset", "calibrate_bias"), lambda p: p)
    link = ZenohLink(Output(listen=(endpoint,)), handlers, loop)

    def publish() -> None:
        count = 0
        while not stop.wait(0.05):
            count += 1
            if poses:
                link.publish_pose(POSE, 1)
            link.publish_health({"counters": {"fog": {"bytes": count, "crc": 4}}, "monotonic_ns": count})

    thread = threading.Thread(target=publish)
    thread.start()
    try:
        yield endpoint
    finally:
        stop.set()
        thread.join()
        assert link.close(10.0)
        loop.close()


def test_plain_lines_hold_pose_uncertainty_validity_reasons_and_changed_counters(
    capsys: pytest.CaptureFixture[str],
) -> None:
    with a_daemon() as endpoint:
        assert main(["--connect", endpoint, "--seconds", "1.5", "--plain"]) == 0
    text = capsys.readouterr().out
    for part in ("degraded", "3.250 m", "-4.500 m", "28.65 deg", "0.200 m", "0.300 m", "0.573 deg", "0.750 m"):
        assert part in text
    assert "encoders: silent (for 2.5 s)" in text
    assert "fog.bytes+" in text
    assert "fog.crc" not in text
    assert "monotonic_ns" not in text
    assert "\x1b" not in text


def test_where_nobody_listens_the_message_says_what_to_check(capsys: pytest.CaptureFixture[str]) -> None:
    endpoint = free_endpoint()
    assert main(["--connect", endpoint, "--seconds", "1"]) == 1
    error = capsys.readouterr().err
    assert endpoint in error
    assert "output.listen" in error


@pytest.mark.parametrize("wrong", [["--connect", "rubbish"], ["--prefix", "a//b"]])
def test_what_zenoh_does_not_take_is_a_message(wrong: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with a_daemon() as endpoint:
        assert main(["--connect", endpoint, "--seconds", "1", *wrong]) == 1
    assert wrong[1] in capsys.readouterr().err


def test_a_wrong_prefix_is_pointed_at_and_the_exit_code_tells(capsys: pytest.CaptureFixture[str]) -> None:
    with a_daemon() as endpoint:
        assert main(["--connect", endpoint, "--prefix", "other", "--seconds", "0.3"]) == 1
    assert "no pose heard under 'other'" in capsys.readouterr().out


def test_a_daemon_without_a_pose_yet_is_told_from_one_that_is_not_there(capsys: pytest.CaptureFixture[str]) -> None:
    with a_daemon(poses=False) as endpoint:
        assert main(["--connect", endpoint, "--seconds", "0.5"]) == 0
    assert "has no pose yet" in capsys.readouterr().out


@pytest.mark.parametrize("terminal", [True, False])
def test_ctrl_c_ends_it_with_0_and_a_terminal_is_redrawn_in_place(terminal: bool) -> None:
    ours, theirs = pty.openpty()
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(p for p in sys.path if p)}
    program = "import sys; from drd.commands.watch import main; sys.exit(main(sys.argv[1:]))"
    with a_daemon() as endpoint, os.fdopen(ours, "rb", buffering=0) as screen:
        arguments = [sys.executable, "-c", program, "--connect", endpoint]
        if terminal:
            process = subprocess.Popen(arguments, stdout=theirs, env=environment)
            os.close(theirs)
            wanted, seen = b"\x1b[J", b""
            while wanted not in seen:
                seen += screen.read(4096)
        else:
            os.close(theirs)
            process = subprocess.Popen(arguments, stdout=subprocess.PIPE, env=environment)
            assert process.stdout
            process.stdout.readline()
        process.send_signal(signal.SIGINT)
        with contextlib.suppress(OSError):  # a pty whose other side is gone
            while terminal and screen.read(4096):
                pass
        with process:
            process.wait(30)
    assert process.returncode == 0


def test_a_reader_that_leaves_ends_it_without_a_complaint() -> None:
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(p for p in sys.path if p)}
    with a_daemon() as endpoint:
        arguments = [sys.executable, "-m", "drd", "watch", "--connect", endpoint, "--seconds", "20"]
        with subprocess.Popen(arguments, stdout=subprocess.PIPE, stderr=subprocess.PIPE, env=environment) as process:
            assert process.stdout
            assert process.stderr
            process.stdout.readline()
            process.stdout.close()
            assert process.stderr.read() == b""
            assert process.wait(30) == 0


def test_rate_and_age_follow_what_was_heard_in_batches() -> None:
    view = View("drd", "here")
    start_s = view._first_s
    for i in range(100):
        pose = dataclasses.replace(POSE, t_ns=10**10 + i * 50_000_000)
        view.take_pose(pose_json(pose, 0), start_s + i // 20 + 1.0 + 1e-4 * (i % 20))
    [(rate, age)] = re.findall(r"poses ([\d.]+)/s  age ([\d.]+) s", view.line(start_s + 5.01))
    assert rate == "20.0"
    assert age == "0.0"
    assert "poses 0.0/s  age 5.0 s" in view.line(start_s + 10.0)
    view.take_pose(pose_json(POSE, 0), start_s + 10.0)
    assert "poses 0.0/s  age 0.0 s" in view.line(start_s + 10.0)


def test_counters_show_their_change_since_the_message_before() -> None:
    view = View("drd", "here")
    view.take_pose(pose_json(POSE, 0), 0.0)
    view.take_health(encode({"counters": {"a": 1, "b": {"c": 5}}}))
    assert not any("counters" in line for line in view.lines(0.0))
    view.take_health(encode({"counters": {"a": 1, "b": {"c": 3}, "new": 7}}))
    [line] = [line for line in view.lines(0.0) if "(-2)" in line]
    assert line.split() == ["b.c", "3", "(-2)"]


def test_findings_that_last_are_shown() -> None:
    view = View("drd", "here")
    view.take_pose(b"{}", 0.0)
    lasting = {"text": "The left tyre loses air.", "probability": 0.9, "until_ns": None}
    view.take_health(encode({"findings": [lasting, lasting | {"text": "It is over.", "until_ns": 7}]}))
    assert "monitor: The left tyre loses air. (probability 0.90)" in view.line(0.0)
    assert not any("over" in line for line in view.lines(0.0))
    view.take_health(encode({"findings": ["no finding", {"until_ns": None}]}))
    assert "monitor: - (probability -)" in view.line(0.0)


def test_what_is_suspected_is_shown() -> None:
    view = View("drd", "here")
    view.take_pose(b"{}", 0.0)
    text = "Something may have changed: wheel_radius_error (0.61)."
    view.take_health(encode({"monitor": {"suspected": text}}))
    assert f"monitor: {text}" in view.line(0.0)
    for nothing in ({"suspected": None}, None, "off"):
        view.take_health(encode({"monitor": nothing}))
        assert "monitor" not in view.line(0.0)


def test_text_from_the_network_cannot_steer_the_terminal() -> None:
    view = View("drd", "here")
    message = {"validity": "\x1b[2J", "reasons": [{"source": "a\nb", "text": "\x07", "since_s": 1}]}
    view.take_pose(json.dumps(message).encode(), 0.0)
    view.take_health(b'{"counters": {"\\u001b[1m": 1}}')
    view.take_health(b'{"counters": {"\\u001b[1m": 2}}')
    assert not {"\x1b", "\x07", "\n"} & set("".join(view.lines(1.0)) + view.line(1.0))


ANY: st.SearchStrategy[Any] = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=10),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=5), inner, max_size=4),
    max_leaves=8,
)
FIELDS = st.sampled_from([*json.loads(pose_json(POSE, 0)), "counters"])


@given(st.binary(max_size=50) | st.dictionaries(FIELDS, ANY, max_size=8).map(lambda m: json.dumps(m).encode()))
@settings(deadline=None)
def test_whatever_arrives_is_shown_or_counted(payload: bytes) -> None:
    view = View("drd", "here")
    for _ in range(2):
        view.take_pose(payload, 1.0)
        view.take_health(payload)
        assert view.line(2.0)
        assert view.lines(2.0)
    assert view.heard or view.unreadable == 4


def test_deep_nesting_is_survived() -> None:
    view = View("drd", "here")
    for depth in (100, 900, 100_000):
        payload = b'{"counters":' * depth + b"1" + b"}" * depth
        view.take_health(payload)
        view.take_pose(payload, 1.0)
    assert view.unreadable >= 2


def watch_in_a_pipe(*arguments: str) -> "subprocess.Popen[bytes]":
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(p for p in sys.path if p)}
    line = [sys.executable, "-m", "drd", "watch", *arguments]
    return subprocess.Popen(line, stdout=subprocess.PIPE, stderr=subprocess.PIPE, env=environment)


def test_json_lines_are_the_poses_as_published(capsys: pytest.CaptureFixture[str]) -> None:
    with a_daemon() as endpoint:
        assert main(["--connect", endpoint, "--seconds", "1", "--json"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) > 1
    assert all(json.loads(line) == json.loads(pose_json(POSE, 1)) for line in lines)


@pytest.mark.parametrize("poses", [True, False])
def test_a_pipe_that_closes_ends_the_lines_even_where_no_pose_comes(poses: bool) -> None:
    with a_daemon(poses=poses) as endpoint, watch_in_a_pipe("--connect", endpoint, "--json") as process:
        assert process.stdout
        assert process.stderr
        if poses:
            process.stdout.readline()
        process.stdout.close()
        assert process.stderr.read() == b""
        assert process.wait(30) == 0


def test_once_is_one_pose(capsys: pytest.CaptureFixture[str]) -> None:
    with a_daemon() as endpoint:
        assert main(["--connect", endpoint, "--json", "--once"]) == 0
        assert main(["--connect", endpoint, "--once"]) == 0
    line, text = capsys.readouterr().out.splitlines()
    assert json.loads(line)["sequence"] == POSE.sequence
    assert text.startswith("degraded")


@pytest.mark.parametrize("form", ["--json", "--plain"])
def test_once_without_a_pose_fails_and_says_how_long_it_waited(form: str, capsys: pytest.CaptureFixture[str]) -> None:
    with a_daemon(poses=False) as endpoint:
        assert main(["--connect", endpoint, form, "--once", "--seconds", "0.3"]) == 1
    out, error = capsys.readouterr()
    assert out == ""
    assert "within 0.3 s" in error


@given(st.binary(max_size=50) | ANY.map(lambda value: json.dumps(value).encode()))
@settings(deadline=None)
def test_whatever_is_published_becomes_one_line_of_strict_json_or_none(payload: bytes) -> None:
    line = pose_line(payload)
    if line is not None:
        assert "\n" not in line
        assert isinstance(json.loads(line, parse_constant=pytest.fail), dict)


def test_a_line_of_json_survives_deep_nesting_and_endless_numbers() -> None:
    for payload in (b'{"a":' * 100_000, b'{"a":' * 900 + b"1" + b"}" * 900, b'{"a":' + b"9" * 6000 + b"}"):
        assert pose_line(payload) is None or json.loads(payload)
    assert pose_line(b'{"a":1e400}') == '{"a":null}'
