"""Fingerprint of the diagnosis' code, since results of different versions must not be mixed."""

import hashlib
from importlib.util import find_spec
from pathlib import Path


def fingerprint(*names: str) -> str:
    """Hash the code of modules and of packages with everything below; they need not be loaded."""
    digest = hashlib.sha256()
    for name in names:
        spec = find_spec(name)
        assert spec is not None
        folders = spec.submodule_search_locations
        files = (
            [Path(str(spec.origin))] if folders is None else [f for p in folders for f in sorted(Path(p).rglob("*.py"))]
        )
        for file in files:
            digest.update(file.read_bytes())
    return digest.hexdigest()[:16]
