"""Find recordings in folders and buckets, with their files and a signature that changes with them."""

import hashlib
import os
import re
import shutil
from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path, PurePosixPath
from tempfile import TemporaryDirectory
from typing import Final, NamedTuple

from drd.config.schema import ConfigError
from drd_tools.fleet.files import Files

# Files of a recording folder; one of the sensors' is enough. fleet.yaml has labels, see `labels`.
SENSORS: Final = frozenset({"encoders.csv", "fog.csv"})
OWN: Final = frozenset({*SENSORS, "robot.yaml", "reference.csv", "fleet.yaml"})
REFERENCE, LABELS = ".reference.csv", ".fleet.yaml"  # next to a daemon's file
PART: Final = re.compile(r"(.+-\d{8}T\d{6}Z-[0-9a-f]+)-\d+")  # file name of a part of a daemon's run


class Seen(NamedTuple):
    """A recording found: `uri` of its folder, its file, or its run (without a part's number), and its files.

    `name`: its path below the searched folder. `signature`: hash of sizes and times, which change with the contents.
    """

    uri: str
    name: str
    folder: str
    files: tuple[str, ...]
    signature: str

    @property
    def last(self) -> str:
        """Last file of a run; "" for a folder."""
        return max((name for name in self.files if name.endswith(".mcap")), default="")

    @property
    def labels(self) -> str:
        """Name of its label file; for a run, the run's own or that of its newest part that has one; "" if none."""
        return max((name for name in self.files if name.endswith("fleet.yaml")), default="")


class _File(NamedTuple):
    name: str
    stamp: tuple[object, ...]


def discover(folders: Sequence[str | Path]) -> list[Seen]:
    """Find all recordings in folders and buckets, and given files, by `uri`. Raises ConfigError if there is none."""
    found: dict[str, Seen] = {}
    for url in folders:
        before = len(found)
        for seen in _below(str(url)):
            found.setdefault(seen.uri, seen)
        if len(found) == before and not any(_is_within(seen.uri, str(url)) for seen in found.values()):
            raise ConfigError(str(url), "", "recordings: folders with encoders.csv or fog.csv, or MCAP files", "none")
    return [found[uri] for uri in sorted(found)]


def _is_within(uri: str, url: str) -> bool:
    root = _url(Files(url))
    return uri == root or uri.startswith(f"{root}/")


def _url(files: Files) -> str:
    return str(files.root if files.is_local else files.system.unstrip_protocol(files.root))


def _below(url: str) -> Iterator[Seen]:
    only = ""
    if url.endswith(".mcap"):
        url, _, only = url.rpartition("/")
    files = Files(url or ".")
    if files.is_local and not Path(files.root).is_dir():
        raise ConfigError(url, "", "a folder of recordings", "nothing there")
    root = _url(files)
    for folder, entries in _local(files.root) if files.is_local else _remote(files):
        # A searched folder that is itself a recording goes by its own name.
        name = folder or PurePosixPath(root).name
        place = f"{root}/{folder}".rstrip("/")
        own = sorted(e for e in entries if e.name in OWN)
        if not only and SENSORS & {e.name for e in own}:
            yield _seen(place, name, place, own)
        yield from _mcaps(place, folder, entries, only)


def _mcaps(place: str, folder: str, entries: Sequence[_File], only: str) -> Iterator[Seen]:
    """Yield the daemon's runs, each with its parts: a run that gets another part remains the same recording."""
    by_name, runs = {e.name: e for e in entries}, dict[str, list[_File]]()
    for entry in sorted(e for e in entries if e.name.endswith(".mcap")):
        part = PART.fullmatch(entry.name.removesuffix(".mcap"))
        runs.setdefault(part[1] if part else entry.name.removesuffix(".mcap"), []).append(entry)
    for run, parts in runs.items():
        last = parts[-1].name
        if only in ("", last):
            # Labels stay valid when the run gets another part.
            labels = [stem + LABELS for stem in dict.fromkeys([run, *(p.name.removesuffix(".mcap") for p in parts)])]
            beside = [by_name[n] for n in (last.removesuffix(".mcap") + REFERENCE, *labels) if n in by_name]
            yield _seen(f"{place}/{run}.mcap", f"{folder}/{run}".lstrip("/"), place, [*parts, *beside])


def _seen(uri: str, name: str, folder: str, files: Sequence[_File]) -> Seen:
    stamps = hashlib.sha256(repr([tuple(f) for f in files]).encode()).hexdigest()[:32]
    return Seen(uri, name, folder, tuple(f.name for f in files), stamps)


def _local(root: str) -> Iterator[tuple[str, list[_File]]]:
    """Yield each folder below once, with files that may belong to a recording; targets of links come last."""
    todo, visited = deque([""]), set[tuple[int, int]]()
    while todo:
        folder, files, folders, links = todo.popleft(), list[_File](), list[str](), list[str]()
        try:
            about = Path(root, folder).stat()
            if (about.st_dev, about.st_ino) in visited:
                continue
            with os.scandir(Path(root, folder)) as entries:
                for entry in entries:
                    if entry.is_dir():
                        if not entry.name.startswith("."):
                            (links if entry.is_symlink() else folders).append(f"{folder}/{entry.name}".lstrip("/"))
                    elif _may_belong(entry.name) and entry.is_file():
                        one = entry.stat()
                        files.append(_File(entry.name, (one.st_size, one.st_mtime_ns)))
        except (PermissionError, FileNotFoundError):  # or removed in the meantime
            continue
        visited.add((about.st_dev, about.st_ino))
        yield folder, files
        todo.extendleft(sorted(folders, reverse=True))
        todo.extend(sorted(links))


def _remote(files: Files) -> Iterator[tuple[str, list[_File]]]:
    files.system.invalidate_cache()
    found: dict[str, list[_File]] = {}
    for path, about in sorted(files.system.find(files.root, detail=True).items()):
        folder, _, name = path[len(files.root) + 1 :].rpartition("/")
        if _may_belong(name):
            stamp = about.get("ETag") or str(about.get("LastModified") or about.get("mtime"))
            found.setdefault(folder, []).append(_File(name, (about["size"], stamp)))
    yield from found.items()


def _may_belong(name: str) -> bool:
    return name in OWN or name.endswith((".mcap", REFERENCE, LABELS))


@contextmanager
def fetched(seen: Seen) -> Iterator[Path]:
    """Yield the recording as a local folder or file; from a bucket it is copied. Raises OSError."""
    files = Files(seen.folder)
    if files.is_local:
        yield Path(seen.folder) / seen.last
        return
    with TemporaryDirectory() as scratch:
        place = Path(scratch) / PurePosixPath(seen.folder).name
        place.mkdir()
        for name in seen.files:
            with files.system.open(files.path(name), "rb") as source, (place / name).open("wb") as target:
                shutil.copyfileobj(source, target)
        yield place / seen.last


def contents(place: Path, seen: Seen) -> str:
    """Hash of the names and contents of a fetched recording's files. Raises OSError."""
    digest, folder = hashlib.sha256(), place.parent if seen.last else place
    for name in seen.files:
        with (folder / name).open("rb") as stream:
            digest.update(f"{name} {hashlib.file_digest(stream, 'sha256').hexdigest()}\n".encode())
    return digest.hexdigest()
