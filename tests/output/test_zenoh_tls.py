"""Mutual TLS and access control by config/zenoh-tls.json5, as it is shipped but for the places of its files."""

import contextlib
import datetime
import json
import logging
import re
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import trustme
import zenoh
from links import HANDLERS, PATIENCE_S, POSE, ask, event_loop, first_sample, free_endpoint, subscribe

from drd.cli import main
from drd.config.keys import Output
from drd.config.schema import ConfigError
from drd.output import queries
from drd.output.command_log import neighbours
from drd.output.forms import COMMANDS, QUESTIONS
from drd.output.zenoh_link import ZenohLink

CONFIG = Path(__file__).parents[2] / "config"


def write(folder: Path, name: str, certificate: trustme.LeafCert) -> None:
    certificate.private_key_pem.write_to_path(folder / f"{name}.key")
    (folder / f"{name}.crt").write_bytes(b"".join(pem.bytes() for pem in certificate.cert_chain_pems))


@pytest.fixture(scope="module")
def certificates(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """ca.crt, and NAME.crt with NAME.key: of this authority, of another one, and out of date."""
    folder = tmp_path_factory.mktemp("tls")
    ours, another = trustme.CA(), trustme.CA()
    ours.cert_pem.write_to_path(folder / "ca.crt")
    write(folder, "robot", ours.issue_cert("localhost", "127.0.0.1", common_name="robot"))
    for name in ("reader", "operator", "stranger"):
        write(folder, name, ours.issue_cert(f"{name}.test", common_name=name))
    write(folder, "forged", another.issue_cert("operator.test", common_name="operator"))
    yesterday = datetime.datetime.now(datetime.UTC) - datetime.timedelta(days=1)
    write(folder, "expired", ours.issue_cert("operator.test", common_name="operator", not_after=yesterday))
    return folder


def placed(text: str, folder: Path) -> str:
    """A shipped file's text with its certificates in `folder`."""
    return re.sub(r'"[^"\n]*?([a-z]+\.(?:key|crt))"', lambda found: f'"{folder}/{found[1]}"', text)


@contextlib.contextmanager
def robot(folder: Path, **output: Any) -> Iterator[tuple[ZenohLink, str]]:
    """The daemon's link with the shipped file, and where it listens."""
    endpoint = free_endpoint().replace("tcp/127.0.0.1", "tls/localhost")
    file = folder / "zenoh-tls.json5"
    file.write_text(placed((CONFIG / file.name).read_text(), folder).replace("tls/0.0.0.0:7447", endpoint))
    with event_loop() as loop:
        link = ZenohLink(Output(zenoh_config=str(file), **output), HANDLERS, loop)
        try:
            yield link, endpoint
        finally:
            assert link.close(PATIENCE_S)


def client_file(folder: Path, endpoint: str, name: str | None) -> Path:
    """The shipped client's file with the certificate of `name`, or without one."""
    text = placed((CONFIG / "zenoh-tls-client.json5").read_text(), folder).replace("tls/localhost:7447", endpoint)
    if name is None:
        text = re.sub(r"\s+(connect_(certificate|private_key)|enable_mtls): [^\n]*", "", text)
    file = folder / "client.json5"
    file.write_text(text.replace("/reader.", f"/{name}."))
    return file


def client(folder: Path, endpoint: str, name: str | None) -> Any:
    return zenoh.open(zenoh.Config.from_file(client_file(folder, endpoint, name)))


@pytest.mark.parametrize("name", ["reader", "operator"])
def test_the_right_certificate_hears_asks_and_sees_the_robot(certificates: Path, name: str) -> None:
    with robot(certificates) as (link, endpoint), client(certificates, endpoint, name) as other:
        for key in ("pose", "odom"):
            first_sample(subscribe(other, f"drd/{key}"), lambda: link.publish_pose(POSE, 5))
        first_sample(subscribe(other, "drd/health"), lambda: link.publish_health({}))
        for question in QUESTIONS:
            assert ask(other, f"drd/{question}") == [(True, {"handler": question, "payload": {}})]
        assert [str(r.ok.key_expr) for r in other.liveliness().get("drd/alive", timeout=5.0)] == ["drd/alive"]


@pytest.mark.parametrize("name", ["forged", "expired", None])
def test_no_certificate_a_foreign_and_an_expired_one_are_not_let_in(certificates: Path, name: str | None) -> None:
    with robot(certificates, commands=True) as (link, endpoint):
        with pytest.raises(zenoh.ZError, match="Unable to connect"):
            client(certificates, endpoint, name)
        with client(certificates, endpoint, "reader") as other:
            assert ask(other, "drd/pose"), "the right one still is"
        assert link.counters["queries"] == 1


def test_an_unencrypted_connection_is_not_let_in(certificates: Path) -> None:
    with robot(certificates) as (_, endpoint):
        config = zenoh.Config()
        for key, value in (("mode", "client"), ("connect/endpoints", [endpoint.replace("tls/", "tcp/")])):
            config.insert_json5(key, json.dumps(value))
        with pytest.raises(zenoh.ZError, match="Unable to connect"):
            zenoh.open(config)


def test_a_certificate_that_no_policy_names_hears_and_learns_nothing(certificates: Path) -> None:
    with robot(certificates, commands=True) as (link, endpoint), client(certificates, endpoint, "stranger") as other:
        heard = subscribe(other, "drd/**")
        for key in (*QUESTIONS, *COMMANDS, "**"):
            assert ask(other, f"drd/{key}") == []
        assert list(other.liveliness().get("drd/**", timeout=5.0)) == []
        with client(certificates, endpoint, "reader") as reader:
            first_sample(subscribe(reader, "drd/pose"), lambda: link.publish_pose(POSE, 5))
        assert heard.try_recv() is None
        assert link.counters["queries"] == 0


def test_only_an_operator_commands_and_the_log_says_who(certificates: Path, caplog: pytest.LogCaptureFixture) -> None:
    payload = b'{"x_m": 1, "y_m": 2, "heading_rad": 0}'
    with caplog.at_level(logging.INFO), robot(certificates, commands=True) as (link, endpoint):
        with client(certificates, endpoint, "reader") as reader:
            for command in COMMANDS:
                assert ask(reader, f"drd/{command}", payload) == []
            assert link.counters["queries"] == link.counters["commands"] == 0
        with client(certificates, endpoint, "operator") as operator:
            for command in COMMANDS:
                assert ask(operator, f"drd/{command}", payload)[0][0]
            assert link.counters["commands"] == len(COMMANDS)
    lines = [r.getMessage() for r in caplog.records if "command=" in r.getMessage()]
    assert [re.findall(r"command=drd/(\w+) outcome=(\w+)", line) for line in lines] == [
        [(command, "accepted")] for command in COMMANDS
    ]
    assert all("neighbours=['operator' at tls/" in line and '"x_m": 1' in line for line in lines)


def test_an_operator_who_is_refused_and_leaves_at_once_is_in_the_log(
    certificates: Path, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    def slowly(session: zenoh.Session) -> list[str]:
        time.sleep(0.3)
        return neighbours(session)

    monkeypatch.setattr(queries, "neighbours", slowly)
    with caplog.at_level(logging.INFO), robot(certificates) as (link, endpoint):
        with client(certificates, endpoint, "operator") as operator:
            [(good, answer)] = ask(operator, "drd/set_pose", b"{}")
        assert (good, "output.commands" in answer["error"]) == (False, True)
        assert link.counters["commands"] == 0
    assert re.search(r"command=drd/set_pose outcome=refused .*neighbours=\[.*'operator' at tls/", caplog.text)


def test_a_reader_cannot_speak_to_other_readers_in_the_robots_name(certificates: Path) -> None:
    with (
        robot(certificates) as (link, endpoint),
        client(certificates, endpoint, "reader") as feigner,
        client(certificates, endpoint, "operator") as listener,
    ):
        heard = subscribe(listener, "drd/pose")
        first_sample(heard, lambda: link.publish_pose(POSE, 5))
        feigner.put("drd/pose", b"{}")
        feigner.put("**", b"{}")
        feigner.declare_queryable("drd/pose", lambda query: query.reply("drd/pose", b'{"handler": "feigned"}'))
        assert [answer["handler"] for _, answer in ask(listener, "drd/pose")] == ["pose"]
        time.sleep(0.2)
        while (sample := heard.try_recv()) is not None:
            assert json.loads(sample.payload.to_bytes())["x_m"] == POSE.x_m


def test_watch_reads_with_a_certificate(certificates: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with robot(certificates) as (link, endpoint):
        file = client_file(certificates, endpoint, "reader")
        command = [sys.executable, "-m", "drd", "watch", "--plain", "--seconds", "2", "--zenoh-config", str(file)]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
            while process.poll() is None:
                link.publish_pose(POSE, 5)
                link.publish_health({})
                time.sleep(0.05)
            assert process.stdout is not None
            assert "x    3.000 m" in process.stdout.read()
        assert process.returncode == 0
    assert main(["watch", "--seconds", "1", "--zenoh-config", str(client_file(certificates, endpoint, "forged"))]) == 1
    assert "client.json5" in capsys.readouterr().err


@pytest.mark.parametrize("missing", ["ca.crt", "robot.crt", "robot.key"])
def test_a_missing_certificate_stops_the_start_and_names_the_file(certificates: Path, missing: str) -> None:
    (certificates / missing).rename(certificates / "away")
    try:
        with pytest.raises(ConfigError) as error, robot(certificates):
            pass
    finally:
        (certificates / "away").rename(certificates / missing)
    assert error.value.path == "output.zenoh_config"
    assert f"{missing}: No such file" in str(error.value)


def test_the_commands_in_the_file_make_certificates_that_work(tmp_path: Path) -> None:
    if shutil.which("openssl") is None:
        pytest.skip("openssl is not installed")
    commands = re.findall(r"^// +(openssl .*)$", (CONFIG / "zenoh-tls.json5").read_text(), re.MULTILINE)
    assert len(commands) == 4
    for command in commands:
        subprocess.run(command, shell=True, check=True, cwd=tmp_path, capture_output=True)
    with robot(tmp_path, commands=True) as (_, endpoint):
        for name, may_command in (("reader", False), ("operator", True)):
            with client(tmp_path, endpoint, name) as other:
                assert ask(other, "drd/pose")[0][0]
                assert bool(ask(other, "drd/reset")) == may_command
        with pytest.raises(zenoh.ZError):
            client(tmp_path, endpoint, None)
