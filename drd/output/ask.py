"""Query a running daemon; shared by all clients."""

import json
from typing import Any, Final

import msgspec
import zenoh

from drd.output.messages import Refused
from drd.output.session import tidy

# The daemon answers within milliseconds; no answer for longer means that it is not running.
ANSWER_S: Final = 3.0
# Zenoh's own reply when no answer came in time; it may also send none.
TIMEOUT: Final = b"Timeout"


def ask(session: Any, key: str, payload: bytes | None = None) -> dict[str, Any]:
    """The answer to a query. Waits up to ANSWER_S; raises Refused with the daemon's reason, or Zenoh's."""
    try:
        reply = next(iter(session.get(key, payload=payload, timeout=ANSWER_S)), None)
        if reply is not None and reply.ok is not None:
            return msgspec.json.decode(reply.ok.payload.to_bytes(), type=dict[str, Any])
    except zenoh.ZError as error:
        raise Refused(tidy(error)) from error
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise Refused("the answer is not a JSON object") from error
    reason = TIMEOUT if reply is None else reply.err.payload.to_bytes()
    raise Refused(f"no drd answers to {key}" if reason == TIMEOUT else _text(reason))


def _text(reason: bytes) -> str:
    try:
        return str(json.loads(reason)["error"])
    except (ValueError, RecursionError, LookupError, TypeError):
        return reason.decode(errors="replace")[:200]
