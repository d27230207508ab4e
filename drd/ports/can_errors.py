"""CAN error frames: the controller's reports on the bus (linux/can/error.h)."""

from typing import Final

# Error classes: bits of the identifier.
CLASSES: Final = {
    0x001: "tx_timeout",
    0x002: "lost_arbitration",
    0x008: "protocol_violation",
    0x010: "transceiver_error",
    0x020: "no_acknowledgement",
    0x040: "bus_off",
    0x080: "bus_error",
    0x100: "restarted",
}
CONTROLLER_PROBLEM: Final = 0x004
# Kind of controller problem: bits of data[1].
CONTROLLER: Final = {
    0x01: "rx_overflow",
    0x02: "tx_overflow",
    0x04: "error_warning",  # receiving
    0x08: "error_warning",  # transmitting
    0x10: "error_passive",  # receiving
    0x20: "error_passive",  # transmitting
    0x40: "error_active",
}
# The bus's state after an error frame; the first that applies. None: the bus works.
STATES: Final[dict[str, str | None]] = {
    "bus_off": "bus-off",
    "restarted": None,
    "error_passive": "error-passive",
    "error_warning": "error-warning",
    "error_active": None,
    "no_acknowledgement": "no node acknowledges",
    "tx_timeout": "transmit timeout",
}
COUNTERS: Final = tuple(dict.fromkeys((*CLASSES.values(), *CONTROLLER.values())))


def problems(can_id: int, data: bytes) -> set[str]:
    """Names of `COUNTERS` that an error frame reports; unknown bits are ignored."""
    names = {name for bit, name in CLASSES.items() if can_id & bit}
    if can_id & CONTROLLER_PROBLEM and len(data) > 1:
        names |= {name for bit, name in CONTROLLER.items() if data[1] & bit}
    return names


def state_after(reported: set[str], state: str | None) -> str | None:
    """The bus's state after the `reported` problems; `state` if they do not determine it."""
    return next((text for name, text in STATES.items() if name in reported), state)
