"""Files of a folder or a bucket, by fsspec: `s3://bucket/store` works like a folder."""

import contextlib
from pathlib import Path
from typing import Any

import fsspec
import pyarrow.fs as pafs
from fsspec.implementations.local import LocalFileSystem

from drd.state.store import replace_file


class Files:
    """A folder, or a prefix of a bucket, and the files below it; names are relative to it, with "/"."""

    def __init__(self, url: str | Path):
        self.url = str(url).rstrip("/")
        self.system, self.root = fsspec.core.url_to_fs(self.url)
        self.is_local = isinstance(self.system, LocalFileSystem)

    def path(self, name: str) -> str:
        """Path in the file system."""
        return f"{self.root}/{name}" if name else self.root

    def arrow(self) -> Any:
        """File system for pyarrow."""
        return pafs.LocalFileSystem() if self.is_local else pafs.PyFileSystem(pafs.FSSpecHandler(self.system))

    def read(self, name: str) -> bytes | None:
        """Read a file; None if it does not exist."""
        try:
            return bytes(self.system.cat_file(self.path(name)))
        except FileNotFoundError:
            return None

    def write(self, name: str, content: bytes) -> None:
        """Write a file atomically: by a rename in a folder; a bucket's objects are atomic."""
        path = self.path(name)
        if not self.is_local:
            self.system.pipe_file(path, content)
            return
        replace_file(Path(path), content)

    def remove(self, name: str) -> None:
        """Remove a file if it exists."""
        with contextlib.suppress(FileNotFoundError):
            self.system.rm_file(self.path(name))

    def below(self, name: str, suffix: str) -> list[str]:
        """Names of all files below a folder that end in `suffix`, sorted; none if the folder does not exist."""
        self.system.invalidate_cache()
        start = len(self.root) + 1
        found = self.system.find(self.path(name))
        return sorted(path[start:] for path in found if path.endswith(suffix))
