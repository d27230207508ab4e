"""A client's query, and what it is told where the daemon does not carry it out."""

import threading
from typing import Any

import pytest
from links import HANDLERS, a_link

from drd.output import ask as asking
from drd.output.ask import ask
from drd.output.messages import Refused


def refuse(_: dict[str, Any]) -> dict[str, Any]:
    raise Refused("not now")


def test_the_answer_comes_back_as_it_is() -> None:
    with a_link() as (_, other):
        assert ask(other, "drd/pose", b'{"a": 1}') == {"handler": "pose", "payload": {"a": 1}}


def test_the_reason_of_the_daemon_is_told() -> None:
    with a_link(HANDLERS | {"config": refuse}) as (_, other):
        with pytest.raises(Refused, match=r"^not now$"):
            ask(other, "drd/config")
        with pytest.raises(Refused, match=r"output\.commands is false"):
            ask(other, "drd/reset")
        with pytest.raises(Refused, match="no drd answers to other/pose"):
            ask(other, "other/pose")


def test_a_daemon_that_hangs_or_a_session_that_ended_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(asking, "ANSWER_S", 0.2)
    awake = threading.Event()
    with a_link(HANDLERS | {"pose": lambda _: {"late": awake.wait(5.0)}}) as (_, other):
        try:
            with pytest.raises(Refused, match="no drd answers to drd/pose"):
                ask(other, "drd/pose")
        finally:
            awake.set()
        other.close()
        with pytest.raises(Refused, match="closed"):
            ask(other, "drd/pose")


@pytest.mark.parametrize("answer", [b"", b"[]", b"\xff", b'{"a": ' + b"[" * 20_000])
def test_an_answer_that_is_no_json_object_is_told(answer: bytes) -> None:
    with (
        a_link() as (_, other),
        other.declare_queryable("x/y", lambda q: q.reply("x/y", answer)),
        pytest.raises(Refused, match="not a JSON object"),
    ):
        ask(other, "x/y")


@pytest.mark.parametrize(
    ("answer", "told"), [(b"[]", r"\[\]"), (b'{"error": 3}', "3"), (b"\xff", "\ufffd"), (b"[" * 20_000, r"\[{200}")]
)
def test_an_error_that_is_not_the_daemons_is_told_as_it_is(answer: bytes, told: str) -> None:
    with (
        a_link() as (_, other),
        other.declare_queryable("x/y", lambda q: q.reply_err(answer)),
        pytest.raises(Refused, match=f"^{told}$"),
    ):
        ask(other, "x/y")
