"""Licences of packages, as SPDX expressions, and their compatibility with Apache-2.0."""

from collections.abc import Iterable, Mapping
from typing import Final

from drd_tools.supply.packages import Package

# Licences under which a package can be installed beside drd, unaltered: permissive ones, and those whose copyleft ends
# at the library's (LGPL) or the file's (MPL) border.
COMPATIBLE: Final = frozenset((
    "0BSD", "Apache-2.0", "BSD-2-Clause", "BSD-3-Clause", "CC0-1.0", "ISC", "LGPL-2.1-only", "LGPL-2.1-or-later",
    "LGPL-3.0-only", "LGPL-3.0-or-later", "MIT", "MPL-2.0", "PSF-2.0", "Zlib",
))  # fmt: skip
# The classifiers and free texts that name one licence.
SPDX: Final = {
    "Apache Software License": "Apache-2.0",
    "Apache 2": "Apache-2.0",
    "ISC License (ISCL)": "ISC",
    "MIT": "MIT",
    "MIT License": "MIT",
    "Mozilla Public License 2.0 (MPL 2.0)": "MPL-2.0",
    "Python Software Foundation License": "PSF-2.0",
}
# Where the metadata leave it open ("BSD", two licences without a word between them): as the LICENSE file says.
BY_FILE: Final = {
    "eclipse-zenoh": "EPL-2.0 OR Apache-2.0",
    "lz4": "BSD-3-Clause",
    "pyserial": "BSD-3-Clause",
    "wrapt": "BSD-2-Clause",
}
CLASSIFIER: Final = "License :: OSI Approved :: "


def licence(package: Package) -> str:
    """Find the SPDX expression. Raises ValueError if the metadata do not state it."""
    if package.name in BY_FILE:
        return BY_FILE[package.name]
    metadata = package.metadata
    if "License-Expression" in metadata:
        return metadata["License-Expression"]
    classifiers: list[str] = metadata.get_all("Classifier") or []
    texts = [c.removeprefix(CLASSIFIER) for c in classifiers if c.startswith(CLASSIFIER)]
    if not texts and "License" in metadata:
        texts = [metadata["License"]]
    if len(texts) != 1 or texts[0] not in SPDX.keys() | COMPATIBLE:
        raise ValueError(f"{package.name}: its metadata name no one licence: {texts}; see its LICENSE, then BY_FILE")
    return SPDX.get(texts[0], texts[0])


def table(sections: Mapping[str, Iterable[Package]]) -> str:
    """Make a Markdown table for each section, without versions, so that it changes only with packages or licences."""
    lines = [
        "# Licences",
        "",
        "Packages that run on a robot beside drd (Apache-2.0), from their metadata: `make licences`. They are",
        "installed from the registry, unaltered; drd's own package holds code of drd alone.",
    ]
    for title, packages in sections.items():
        lines += ["", f"| {title} | licence (SPDX) |", "| --- | --- |"]
        lines += [f"| {p.name} | {licence(p)} |" for p in sorted(packages)]
    return "\n".join(lines) + "\n"
