"""Known vulnerabilities of the locked packages, by pip-audit; a missing answer is reported but is no failure."""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any, Final

# An answer takes a few seconds. A slow registry must not delay continuous integration.
TIMEOUT_S: Final = 60.0
# uv keeps it in a separate environment, apart from our packages.
PIP_AUDIT: Final = ("uv", "tool", "run", "--quiet", "--from", "pip-audit>=2.9,<3", "pip-audit")
OPTIONS: Final = ("--require-hashes", "--disable-pip", "--progress-spinner=off", "--timeout=10", "--format=json")


def audit(lock: Path, pip_audit: tuple[str, ...] = PIP_AUDIT, timeout_s: float = TIMEOUT_S) -> int:
    """Print the results; return exit code 1 if a package has a known vulnerability, otherwise 0."""
    command = [*_beside_python(pip_audit), *OPTIONS, "--requirement", str(lock)]
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=timeout_s)
        packages: list[dict[str, Any]] = json.loads(done.stdout)["dependencies"]
    except subprocess.TimeoutExpired:
        return _skipped(f"no answer within {timeout_s:g} s")
    except OSError as error:
        return _skipped(f"{command[0]}: {error.strerror}")
    except (ValueError, KeyError, TypeError):
        return _skipped((done.stderr.strip() or "no answer").splitlines()[-1])
    found = [(p, v) for p in packages for v in p.get("vulns", ())]
    for package, vulnerability in found:
        mended = ", ".join(vulnerability.get("fix_versions", ())) or "no version yet"
        print(f"{package['name']} {package['version']}: {vulnerability['id']}, mended in {mended}")
    unknown = [p["name"] for p in packages if "skip_reason" in p]
    if len(unknown) == len(packages):
        return _skipped("the registry tells of no package")
    text = f"; not known to the registry: {', '.join(unknown)}" if unknown else ""
    print(f"audit: {len(packages) - len(unknown)} packages, {len(found)} known vulnerabilities{text}")
    return 1 if found else 0


def _skipped(reason: str) -> int:
    print(f"audit: skipped: {reason}")
    return 0


def _beside_python(command: tuple[str, ...]) -> tuple[str, ...]:
    """Use the program of this environment, if it has one."""
    beside = Path(sys.executable).parent / command[0]
    return (str(beside), *command[1:]) if beside.exists() else command
