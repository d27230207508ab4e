"""The build of the diagnosis: results of one and of another are not to be mixed."""

import hashlib
from pathlib import Path
from types import ModuleType


def fingerprint(*packages: ModuleType) -> str:
    """Hash of the code of packages, or of modules."""
    digest = hashlib.sha256()
    for package in packages:
        for folder in getattr(package, "__path__", ()) or [str(package.__file__)]:
            found = Path(folder)
            for file in sorted(found.rglob("*.py")) if found.is_dir() else [found]:
                digest.update(file.read_bytes())
    return digest.hexdigest()[:16]
