"""Install the robot's packages from a lock file: each at one version, and only with the locked content."""

import shlex
import subprocess
from pathlib import Path

from drd.config.schema import ConfigError


def install_locked(program: str, lock: Path) -> None:
    """Install the versions of `lock` into the environment of `program`.

    Raises ConfigError where pip is missing or refuses: another hash, a package not in the lock file. Only wheels are
    installed, since building a package runs its code.
    """
    pip = [str(Path(program).with_name("python3")), "-m", "pip", "install", "--disable-pip-version-check"]
    command = [*pip, "--require-hashes", "--only-binary=:all:", "--requirement", str(lock)]
    try:
        code = subprocess.run(command, check=False).returncode
    except OSError as error:
        raise ConfigError(str(lock), "--lock", f"a Python beside {program}", f"{pip[0]}: {error.strerror}") from error
    if code:
        raise ConfigError(str(lock), "--lock", "packages as they were locked", f"exit code {code} of {shlex.join(pip)}")
