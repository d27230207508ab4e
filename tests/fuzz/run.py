"""Fuzz parsers: `python tests/fuzz/run.py TARGET --seconds 600`. A finding ends its target and is left in a file.

`--all --hours N` shares the hours among all targets, in turn, keeps a small corpus and goes on after findings
(campaign.py); what several such runs did adds up.
"""

import argparse
import os
import random
import re
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent
LIMITS = ("-timeout=20", "-rss_limit_mb=1024", "-max_len=8192", "-print_final_stats=1")
# Bytes that are changed at random hardly ever stay YAML or JSON: in texts whole words and brackets are exchanged, too.
TEXTS = ("dbc", "calibration", "model", "config", "folder", "mcap_messages", "state", "request", "query", "labels",
         "web_request", "web_message")  # fmt: skip
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


def fuzz(name: str, target: Callable[[bytes], None], arguments: Sequence[str], program: str = "fuzz") -> None:
    """Does not return: libFuzzer ends the process, with a code other than 0 where it found something.

    `arguments`: libFuzzer's options and folders. `program`: what it starts again, which it does to merge.
    """
    import atheris  # noqa: PLC0415 - not everywhere

    options: dict[str, Any] = {}
    if name in TEXTS:
        options["custom_mutator"] = lambda data, size, seed: (
            exchange_words(data, size, seed) if seed % 2 else atheris.Mutate(data, size)
        )
    atheris.Setup([program, *LIMITS, *arguments], target, **options)
    atheris.Fuzz()


@contextmanager
def scratch() -> Iterator[str]:
    """A folder, in memory where there is one, for all temporary files: libFuzzer ends its process as a signal does."""
    memory = Path("/dev/shm")
    with tempfile.TemporaryDirectory(prefix="drd-fuzz-", dir=memory if memory.is_dir() else None) as folder:
        before, tempfile.tempdir = tempfile.tempdir, folder
        try:
            own = Path(folder, "corpus")
            own.mkdir()
            yield str(own)
        finally:
            tempfile.tempdir = before


def load_targets() -> dict[str, Callable[[bytes], None]]:
    """The targets, with the project's own code watched.

    YAML's, MCAP's and cantools' Python is not: watched, it takes 10 to 40 times as long as all the rest.
    """
    import atheris  # noqa: PLC0415 - not everywhere

    sys.path.insert(0, str(HERE.parent))
    with atheris.instrument_imports(include=["drd", "drd_tools"]):
        from fuzz.targets import TARGETS  # noqa: PLC0415 - only what is imported here is watched
    return TARGETS


def one_after_the_other(targets: dict[str, Callable[[bytes], None]], names: Sequence[str], bounds: list[str]) -> bool:
    """Fuzz each; whether anything was found."""
    codes = {}
    for name in names:
        print(f"fuzzing {name}", file=sys.stderr, flush=True)  # noqa: T201 - what it is for
        with scratch() as folder:
            child = os.fork()  # the watched modules are loaded once for all
            if not child:
                fuzz(name, targets[name], [f"-artifact_prefix={name}-", *bounds, folder, str(HERE / "corpus" / name)])
            codes[name] = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
        print(f"fuzzed {name}: {codes[name] or 'nothing found'}", flush=True)  # noqa: T201
    return any(codes.values())


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("targets", nargs="*", metavar="TARGET", help="of targets.py; all: every one in turn")
    parser.add_argument("--seconds", type=int, default=60, help="how long for each [default 60]")
    parser.add_argument("--seed", type=int, default=1, help="of the fuzzer's random numbers [default 1]")
    parser.add_argument("--all", action="store_true", help="a campaign: all targets (or those named) in rounds")
    parser.add_argument("--hours", type=float, default=1.0, help="of a campaign, in all [default 1]")
    parser.add_argument("--workers", type=int, default=os.cpu_count(), help="of a campaign [default: one a core]")
    text = "of a campaign: corpus, findings and figures.json; it goes on from there [default out/fuzz]"
    parser.add_argument("--output", type=Path, default=Path("out/fuzz"), metavar="DIR", help=text)
    parser.add_argument("--inner", nargs=argparse.REMAINDER, help=argparse.SUPPRESS)  # libFuzzer's own, of a merge
    arguments = parser.parse_args()
    targets = load_targets()
    names = list(targets) if arguments.targets in (["all"], []) else arguments.targets
    if unknown := [name for name in names if name not in targets]:
        parser.error(f"no target {unknown[0]!r}; there are {', '.join(targets)}")
    from fuzz.campaign import Campaign, collecting  # noqa: PLC0415 - as the targets

    if arguments.inner is not None:
        with scratch():
            fuzz(names[0], collecting(targets[names[0]], None), arguments.inner)
    if arguments.all:
        with scratch():
            campaign = Campaign(arguments.output, {name: targets[name] for name in names}, fuzz)
            return campaign.run(arguments.hours, arguments.workers)
    if not arguments.targets:
        parser.error("name a target, or --all")
    return one_after_the_other(targets, names, [f"-max_total_time={arguments.seconds}", f"-seed={arguments.seed}"])


if __name__ == "__main__":
    raise SystemExit(main())
