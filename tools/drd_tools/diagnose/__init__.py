"""Find the physics that a nominal model leaves out, name it, model it, and validate it."""

from drd_tools.diagnose.api import diagnose
from drd_tools.diagnose.diagnosis import Diagnosis
from drd_tools.diagnose.results import Amount, Finding, Verdict

__all__ = ["Amount", "Diagnosis", "Finding", "Verdict", "diagnose"]
