"""What a trial keeps on disk: a line of JSON per case, added as it is ready, so that a stopped trial goes on."""

import hashlib
import json
from pathlib import Path
from typing import Any, Final

import drd.effects
import drd_tools.diagnose
import drd_tools.simulate
from drd.config.schema import ConfigError
from drd_tools.diagnose.files import plain

Record = dict[str, Any]
Head = dict[str, Any]

RESULTS: Final = "results.jsonl"
OLD: Final = "results.old.jsonl"
FORMAT: Final = "drd-trial/2"


def fingerprint() -> str:
    """Of the code that simulates and diagnoses: results of one and of another build are not to be mixed."""
    digest = hashlib.sha256()
    for package in (drd.effects, drd_tools.diagnose, drd_tools.simulate):
        for folder in package.__path__:
            for file in sorted(Path(folder).rglob("*.py")):
                digest.update(file.read_bytes())
    return digest.hexdigest()[:16]


class Store:
    """The results in a folder."""

    def __init__(self, folder: Path):
        self.file = folder / RESULTS

    def begin(self, head: Head) -> list[Record]:
        """Go on with the results that are there, or begin; returns those that are there.

        Results of another build of the diagnosis are moved aside. Raises ConfigError where they are of other cases
        (another seed, say), and OSError.
        """
        head = {"format": FORMAT, **head, "build": fingerprint()}
        self.file.parent.mkdir(parents=True, exist_ok=True)
        if self.file.exists() and self.file.stat().st_size:
            was, records = self.read()
            if was["build"] == head["build"]:
                for name, value in head.items():
                    if was.get(name) != value:
                        expected = f"the trial that it holds, with {name} {was.get(name)}; or another folder"
                        raise ConfigError(str(self.file.parent), name, expected, str(value))
                self._write([was, *records])  # without a line that was cut off
                return records
            self.file.replace(self.file.with_name(OLD))
        self._write([head])
        return []

    def add(self, record: Record) -> None:
        """Keep a record. Raises OSError."""
        with self.file.open("a", encoding="utf-8") as out:
            out.write(json.dumps(plain(record), allow_nan=False) + "\n")

    def read(self) -> tuple[Head, list[Record]]:
        """What is there. A last line that was cut off does not count. Raises ConfigError."""
        try:
            lines = self.file.read_text(encoding="utf-8").split("\n")
            rows: list[Any] = [json.loads(line) for line in lines[:-1]]
        except (OSError, ValueError) as error:
            raise ConfigError(str(self.file), "", "results of a trial", str(error)) from error
        if not rows or not isinstance(rows[0], dict) or rows[0].get("format") != FORMAT:
            raise ConfigError(str(self.file), "format", FORMAT, "something else")
        return rows[0], rows[1:]

    def _write(self, rows: list[Any]) -> None:
        text = "".join(json.dumps(plain(row), allow_nan=False) + "\n" for row in rows)
        self.file.write_text(text, encoding="utf-8")
