"""Files that a command installs and removes, without ever overwriting other people's changes."""

import hashlib
import json
import os
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Self

from drd.config.schema import ConfigError
from drd.state.store import replace_file

MANIFEST = "etc/drd/.installed.json"
_MANIFEST_VERSION = 1


@dataclass
class Installation:
    """Files that this program installed under `root`, with the SHA-256 of each as written, and folders it made.

    The outcome for each file is printed. Methods raise OSError. A `with` statement writes the manifest at its end,
    whatever happens, so that it lists every file written.
    """

    root: Path
    files: dict[str, str] = field(default_factory=dict)  # by path relative to `root`
    folders: list[str] = field(default_factory=list)  # in the order they were made

    @classmethod
    def read(cls, root: Path) -> "Installation":
        """Read the manifest, if there is one. Raises ConfigError if it is invalid."""
        file = root / MANIFEST
        if not file.exists():
            return cls(root)
        try:
            value: Any = json.loads(file.read_text(encoding="utf-8"))
            if value["version"] != _MANIFEST_VERSION:
                raise ValueError(f"version {value['version']!r}")
            files, folders = dict[str, str](value["files"]), [str(name) for name in value["folders"]]
            if any(".." in Path(name).parts or Path(name).is_absolute() for name in (*files, *folders)):
                raise ValueError("a path that leads out of the root")
        except (ValueError, TypeError, KeyError) as error:
            raise ConfigError(str(file), "", "the list of installed files that drd wrote", str(error)) from error
        return cls(root, files, folders)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.save()

    def put(self, name: str, text: str, remark: str = "") -> None:
        """Write a file; where somebody has changed it or put another there, write NAME.new beside it instead."""
        path, beside = self.root / name, f"{name}.new"
        if not os.path.lexists(path):
            self._write(name, text)
            say("wrote", path, remark)
        elif _sha256(path) == _digest(text):
            self.files[name] = _digest(text)
            say("unchanged", path)
        elif self._is_as_written(name):
            self._write(name, text)
            say("updated", path, remark)
        else:
            self._write(beside, text)
            say("kept", path, f"not as it was installed; this version is {Path(beside).name} beside it")
            return
        if beside in self.files:
            self._remove(beside)

    def put_once(self, name: str, text: str, remark: str = "") -> None:
        """Write a file only where there is none; from then on it belongs to the user."""
        path = self.root / name
        if os.path.lexists(path):
            say("kept", path, "it is yours")
        else:
            self._write(name, text)
            say("wrote", path, remark)

    def remove(self, yours: Callable[[str], bool], purge: bool) -> None:
        """Remove installed files. Those that are `yours` or have been changed stay, unless `purge`."""
        for name in list(self.files):
            path = self.root / name
            if not os.path.lexists(path):
                del self.files[name]
            elif purge or (self._is_as_written(name) and not yours(name)):
                self._remove(name)
                say("removed", path)
            else:
                say("kept", path, f"{'it is yours' if yours(name) else 'changed'}; --purge removes it")

    def save(self) -> None:
        """Write the manifest; if no file is left, remove it and the folders that were made."""
        file = self.root / MANIFEST
        if self.files:
            self._make_folder(file.parent)
            value = {"version": _MANIFEST_VERSION, "files": self.files, "folders": self.folders}
            _write_text(file, json.dumps(value, indent=1) + "\n")
            return
        file.unlink(missing_ok=True)
        for name in reversed(self.folders):
            try:
                (self.root / name).rmdir()
            except FileNotFoundError:
                pass
            except OSError:  # other files are in it
                say("kept", self.root / name, "it holds other files")

    def _is_as_written(self, name: str) -> bool:
        return _sha256(self.root / name) == self.files.get(name, "")

    def _write(self, name: str, text: str) -> None:
        self._make_folder((self.root / name).parent)
        _write_text(self.root / name, text)
        self.files[name] = _digest(text)

    def _remove(self, name: str) -> None:
        (self.root / name).unlink(missing_ok=True)
        del self.files[name]

    def _make_folder(self, folder: Path) -> None:
        missing = [f for f in (folder, *folder.parents) if not f.exists()]
        for f in reversed(missing):
            f.mkdir()
            f.chmod(0o755)  # regardless of the umask: the service has its own user
            if f.is_relative_to(self.root) and f != self.root:
                self.folders.append(str(f.relative_to(self.root)))


def say(what: str, path: Path, remark: str = "") -> None:
    """Print what was done to which file."""
    print(f"{what:9}  {path}{f'  ({remark})' if remark else ''}")


def _write_text(file: Path, text: str) -> None:
    replace_file(file, text.encode(), 0o644)  # readable by everybody


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()


def _sha256(file: Path) -> str | None:
    """Digest of the content; None for a link or anything that is not a file."""
    return hashlib.sha256(file.read_bytes()).hexdigest() if file.is_file() and not file.is_symlink() else None
