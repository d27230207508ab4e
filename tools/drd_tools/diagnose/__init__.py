"""Find the physics that a nominal model leaves out, name it, model it, and show that it holds."""

from importlib import import_module
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from drd_tools.diagnose.api import diagnose
    from drd_tools.diagnose.diagnosis import Diagnosis
    from drd_tools.diagnose.results import Amount, Finding, Verdict

__all__ = ["Amount", "Diagnosis", "Finding", "Verdict", "diagnose"]

MODULES: Final = {
    "Amount": "results",
    "Diagnosis": "diagnosis",
    "Finding": "results",
    "Verdict": "results",
    "diagnose": "api",
}


def __getattr__(name: str) -> Any:
    """The interface, loaded with its first use: what only draws a diagnosis does not wait for what finds one."""
    if name not in MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{MODULES[name]}"), name)
