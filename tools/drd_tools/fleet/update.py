"""Bring a store up to date: analyse new and changed recordings, and store each result as it becomes ready."""

import hashlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, Final, NamedTuple

from tqdm import tqdm

from drd_tools.fleet.discover import Seen, discover
from drd_tools.fleet.engine import Engine
from drd_tools.fleet.labels import Labels, Rule, from_text, ruled
from drd_tools.fleet.store import MOST_PENDING, Store
from drd_tools.fleet.task import Rows, Task, build, failed

KILLED: Final = "its process was killed, more than once: memory?"
HERE: Final = Engine()


class Updated(NamedTuple):
    """Outcome of an update: numbers of recordings found, analysed, relabelled, and without a start.

    `failures`: recording and error of all marked as failed.
    """

    found: int
    analysed: int
    relabelled: int
    undated: int
    failures: list[tuple[str, str]]


class _Known(NamedTuple):
    """Row of a recording in the store; the parts of a long one are alike except for name and start."""

    recordings: list[str]
    row: Mapping[str, Any]


def update(
    folders: Sequence[str | Path],
    store: Store,
    rules: Sequence[Rule] = (),
    engine: Engine = HERE,
    call: Callable[[Task], Rows | None] | None = None,
) -> Updated:
    """Analyse new and changed recordings. A stopped update resumes where it was. Raises ConfigError.

    `call`: replaces the analysis.
    """
    with store.writing():
        store.compact()
        found = discover(folders)
        known = _known(store)
        names = _names(found, known)
        fresh, other = [], []
        for seen in found:
            was = known.get(seen.uri)
            if was is None or not _is_current(was.row, seen):
                same_build = was is not None and was.row["build"] == build()
                fresh.append(Task(seen, names[seen.uri], build(), was.row["digest"] if was and same_build else ""))
            elif _labels(rules, seen, was.row) != _kept(was.row):
                other.append(seen)
        touched = list(_analysed(store, rules, engine, call, fresh))
        other += touched
        _relabel(store, rules, known, other)
        index = store.index()
        here = {seen.uri for seen in found}
        rows = [
            row for row in index.select(["uri", "recording", "error", "start_utc"]).to_pylist() if row["uri"] in here
        ]
    failures = [(row["recording"], row["error"]) for row in rows if row["error"] is not None]
    undated = sum(row["start_utc"] is None and row["error"] is None for row in rows)
    return Updated(len(found), len(fresh) - len(touched), len(other), undated, failures)


def _known(store: Store) -> dict[str, _Known]:
    known: dict[str, _Known] = {}
    for row in store.index().to_pylist():
        known.setdefault(row["uri"], _Known([], row)).recordings.append(row["recording"])
    return known


def _is_current(row: Mapping[str, Any], seen: Seen) -> bool:
    return bool(row["digest"]) and row["signature"] == seen.signature and row["build"] == build()


def _names(found: Sequence[Seen], known: Mapping[str, _Known]) -> dict[str, str]:
    """Name each recording permanently; if two have the same name, the later one gets a mark."""
    names = {uri: _without_part(was) for uri, was in known.items()}
    taken = set(names.values())
    for seen in found:
        if seen.uri not in names:
            mark = hashlib.sha256(seen.uri.encode()).hexdigest()[:6]
            names[seen.uri] = f"{seen.name}~{mark}" if seen.name in taken else seen.name
            taken.add(names[seen.uri])
    return names


def _without_part(was: _Known) -> str:
    name = was.recordings[0]
    return name.rpartition("-part-")[0] if len(was.recordings) > 1 else name


def _labels(rules: Sequence[Rule], seen: Seen, row: Mapping[str, Any]) -> dict[str, Any]:
    return ruled(rules, seen.name, from_text(row["own"])).columns(row.get("begins_s") or 0.0)


def _relabelled(rows: Rows, rules: Sequence[Rule], seen: Seen) -> Rows:
    """Rows of a recording with the labels by the rules."""
    labels = {row["recording"]: _labels(rules, seen, row) for row in rows["recordings"]}
    return {table: [{**row, **labels[row["recording"]]} for row in own] for table, own in rows.items()}


def _kept(row: Mapping[str, Any]) -> dict[str, Any]:
    return {name: row[name] for name in Labels().columns()}


def _analysed(
    store: Store,
    rules: Sequence[Rule],
    engine: Engine,
    call: Callable[[Task], Rows | None] | None,
    tasks: Sequence[Task],
) -> Iterator[Seen]:
    """Analyse and store; yield the recordings whose files were touched but not changed."""
    if not tasks:
        return
    if call is None:
        from drd_tools.fleet.analysis import analysed  # noqa: PLC0415  # takes a second to load: only if something is new

        call = analysed
    with tqdm(total=len(tasks), desc="analysing", unit="recording", disable=None, leave=False) as bar:
        for count, (task, rows) in enumerate(engine.results(call, tasks, partial(failed, error=KILLED)), 1):
            bar.update()
            if rows is None:
                yield task.seen
                continue
            store.put(_relabelled(rows, rules, task.seen))
            if count % MOST_PENDING == 0:
                store.compact()


def _relabel(store: Store, rules: Sequence[Rule], known: Mapping[str, _Known], found: Sequence[Seen]) -> None:
    """Update the labels and signatures of recordings."""
    store.compact()
    for at in range(0, len(found), MOST_PENDING):
        some = found[at : at + MOST_PENDING]
        rows = store.rows({name for seen in some for name in known[seen.uri].recordings})
        for seen in some:
            own: dict[str, list[dict[str, Any]]] = {}
            for name in known[seen.uri].recordings:
                for table, those in rows[name].items():
                    own.setdefault(table, []).extend(those)
            own["recordings"] = [{**row, "signature": seen.signature} for row in own["recordings"]]
            store.put(_relabelled(own, rules, seen))
        store.compact()
