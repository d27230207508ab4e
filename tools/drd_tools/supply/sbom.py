"""Bill of materials: packages, versions, licences and dependencies, as CycloneDX 1.6 in JSON (ECMA-424)."""

import json
import uuid
from collections.abc import Mapping
from typing import Any

from drd_tools.supply.licences import licence
from drd_tools.supply.packages import Package


def bill_of_materials(packages: Mapping[str, Package]) -> dict[str, Any]:
    """Make the bill of materials of all packages, without a date, so that it is reproducible."""
    body = {
        "metadata": {"component": _component(packages["drd"], "application")},
        "components": [_component(p, "library") for name, p in sorted(packages.items()) if name != "drd"],
        "dependencies": [
            {"ref": _url(p), "dependsOn": [_url(packages[name]) for name in p.requires]}
            for _, p in sorted(packages.items())
        ],
    }
    serial = uuid.uuid5(uuid.NAMESPACE_URL, json.dumps(body, sort_keys=True))
    head = {"bomFormat": "CycloneDX", "specVersion": "1.6", "serialNumber": f"urn:uuid:{serial}", "version": 1}
    return {**head, **body}


def _component(package: Package, kind: str) -> dict[str, Any]:
    url = _url(package)
    licences = [{"expression": licence(package)}]
    return {
        "type": kind,
        "bom-ref": url,
        "name": package.name,
        "version": package.version,
        "licenses": licences,
        "purl": url,
    }


def _url(package: Package) -> str:
    """The package URL; a registry's local version ("+cu12") is the same package."""
    return f"pkg:pypi/{package.name}@{package.version.split('+')[0]}"
