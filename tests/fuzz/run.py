"""Fuzz parsers: `python tests/fuzz/run.py TARGET --seconds 600`. A finding ends its target and is left in a file."""

import argparse
import os
import random
import re
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent
LIMITS = ("-timeout=20", "-rss_limit_mb=1024", "-max_len=8192", "-print_final_stats=1")
# Bytes that are changed at random hardly ever stay YAML or JSON: in texts whole words and brackets are exchanged, too.
TEXTS = ("dbc", "calibration", "model", "config", "folder", "mcap_messages", "state", "request")
WORD = re.compile(rb'"[^"]*"|[\w.+-]+|\[[^\[\]]*\]|\{[^{}]*\}')
HOSTILE = (
    *b'null ~ true [] {} [[]] "" "a" 0 -1 1.5 1e999 -1e308 5e-324 .nan NaN .inf Infinity 18446744073709551616'.split(),
    *b"0x1f 1:30 2001-01-01 &a *a !!python/none !!set % ../x \xff \xef\xbb\xbf \0".split(),
    *(b"", b"<<: 1", b"9" * 400, b"[" * 100, b"{a: " * 100),
)


def exchange_words(data: bytes, size: int, seed: int) -> bytes:
    """Put something else for some words: another one of the input's, or one that parsers stumble over."""
    chance = random.Random(seed)
    words = list(WORD.finditer(data))
    for word in sorted(chance.sample(words, min(len(words), chance.choice((1, 1, 2, 4)))), key=lambda w: -w.start()):
        other = chance.choice(HOSTILE) if chance.random() < 0.7 else chance.choice(words)[0]
        data = data[: word.start()] + other + data[word.end() :]
    return data[:size]


def fuzz(name: str, target: Callable[[bytes], None], kept: Path | None, bounds: list[str]) -> None:
    """Does not return: libFuzzer ends the process, with a code other than 0 where it found something."""
    import atheris  # noqa: PLC0415 - not everywhere

    with tempfile.TemporaryDirectory() as scratch:
        own = (kept or Path(scratch)) / name
        own.mkdir(parents=True, exist_ok=True)
        options: dict[str, Any] = {}
        if name in TEXTS:
            options["custom_mutator"] = lambda data, size, seed: (
                exchange_words(data, size, seed) if seed % 2 else atheris.Mutate(data, size)
            )
        folders = [f"-artifact_prefix={name}-", str(own), str(HERE / "corpus" / name)]
        atheris.Setup([sys.argv[0], *LIMITS, *bounds, *folders], target, **options)
        atheris.Fuzz()


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("targets", nargs="+", metavar="TARGET", help="of targets.py; all: every one in turn")
    parser.add_argument("--seconds", type=int, default=60, help="how long for each [default 60]")
    parser.add_argument("--seed", type=int, default=1, help="of the fuzzer's random numbers [default 1]")
    parser.add_argument("--keep", type=Path, help="folder that takes the inputs that reached new code; read first too")
    arguments = parser.parse_args()
    import atheris  # noqa: PLC0415 - not everywhere

    sys.path.insert(0, str(HERE.parent))
    with atheris.instrument_imports(include=["drd", "drd_tools", "yaml", "mcap", "cantools", "textparser"]):
        from fuzz.targets import TARGETS  # noqa: PLC0415 - only what is imported here is watched

    names = list(TARGETS) if arguments.targets == ["all"] else arguments.targets
    if unknown := [name for name in names if name not in TARGETS]:
        parser.error(f"no target {unknown[0]!r}; there are {', '.join(TARGETS)}")
    bounds = [f"-max_total_time={arguments.seconds}", f"-seed={arguments.seed}"]
    codes = {}
    for name in names:
        print(f"fuzzing {name}", file=sys.stderr, flush=True)  # noqa: T201 - what it is for
        child = os.fork()  # the watched modules are loaded once for all
        if not child:
            fuzz(name, TARGETS[name], arguments.keep, bounds)
        codes[name] = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
        print(f"fuzzed {name}: {codes[name] or 'nothing found'}", flush=True)  # noqa: T201
    return any(codes.values())


if __name__ == "__main__":
    raise SystemExit(main())
