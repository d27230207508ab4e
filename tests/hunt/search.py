"""The search: drives at random, and children of the worst of each kind, in several processes; kept in a file."""

from collections.abc import Iterable, Iterator
from pathlib import Path
from random import Random
from typing import Final

import msgspec
from msgspec import Struct, field
from msgspec.structs import replace as changed
from tqdm import tqdm

from drd_tools.processes import pool_of
from hunt.genome import Genome, bred, drawn
from hunt.judge import Found, judge, once

BATCH: Final = 120  # drives between two writings of the file
AT_RANDOM: Final = 0.4  # of the drives: they say how often a bound is broken, the children how badly it can be
OF_TWO: Final = 0.3  # of the children have two parents
REPEATS: Final = 20
KEPT: Final = 0.8  # of its ratio a case must keep while it is made simpler


class Case(Struct, frozen=True):
    """A drive and what was found of it."""

    genome: Genome
    found: Found


class Tally(Struct):
    """Drives of one sort: how many, valid rows, those beyond a bound, drives with any."""

    drives: int = 0
    rows: int = 0
    beyond: int = 0
    drives_beyond: int = 0
    worst: float = 0.0

    def add(self, found: Found) -> None:
        self.drives += 1
        self.rows += found.rows
        self.beyond += found.beyond
        self.drives_beyond += found.beyond > 0
        self.worst = max(self.worst, found.score)


class Hunt(Struct):
    """All that a search has found so far. `niches`: the worst case of each kind of drive; `tallies` by way of making
    and class; `single`: those at random with one event, by its kind.
    """

    seed: int
    drives: int = 0
    niches: dict[str, Case] = field(default_factory=dict)
    wrong: dict[str, Case] = field(default_factory=dict)
    jumps: dict[str, Case] = field(default_factory=dict)
    seen: dict[str, Case] = field(default_factory=dict)
    tallies: dict[str, Tally] = field(default_factory=dict)
    single: dict[str, Tally] = field(default_factory=dict)

    def take(self, genome: Genome, found: Found, made: str) -> None:
        """Count a drive, and keep it where it is the worst of its kind or shows what was not seen before."""
        self.drives += 1
        sort = f"{made}, {'named' if genome.named else 'rest'}"
        self.tallies.setdefault(sort, Tally()).add(found)
        kinds = sorted({event.kind for event in genome.events})
        if made == "random" and len(kinds) <= 1:
            self.single.setdefault(kinds[0] if kinds else "no event", Tally()).add(found)
        case = Case(genome, found)
        sides = ("position" if found.position >= found.heading else "heading", *kinds)
        if found.score > self._score(self.niches, niche := " + ".join(sides)):
            self.niches[niche] = case
        for text in found.wrong:
            self.wrong.setdefault(text, case)
        if found.jump > 1.0 and found.jump > getattr(getattr(self.jumps.get(niche), "found", None), "jump", 0.0):
            self.jumps[niche] = case
        signature = ",".join(found.seen)
        if len(self.seen) < 3000 and signature not in self.seen:  # parents that have reached something new
            self.seen[signature] = case

    @staticmethod
    def _score(cases: dict[str, Case], niche: str) -> float:
        return cases[niche].found.score if niche in cases else 0.0

    def next(self, random: Random) -> tuple[Genome, str]:
        """A genome to try, and how it was made."""
        if random.random() < AT_RANDOM or len(self.niches) < 20:
            return drawn(random), "random"
        mother, father = self._parent(random), self._parent(random)
        return bred(mother, father if random.random() < OF_TWO else mother, random), "bred"

    def _parent(self, random: Random) -> Genome:
        """The worse of two, mostly; at times one that has reached something new."""
        if random.random() < 0.15 and self.seen:
            return random.choice(list(self.seen.values())).genome
        cases = list(self.niches.values())
        return max(random.choice(cases), random.choice(cases), key=lambda case: case.found.score).genome


def hunt(file: Path, drives: int, jobs: int, seed: int) -> Hunt:
    """Search on from what the file holds, up to so many drives."""
    found = msgspec.json.decode(file.read_bytes(), type=Hunt) if file.exists() else Hunt(seed)
    with tqdm(total=drives, initial=min(found.drives, drives), desc="hunt", unit=" drives", disable=None) as bar:
        for results in _batches(found, drives, jobs):
            for genome, result, made in results:
                found.take(genome, result, made)
            bar.update(len(results))
            bar.set_postfix_str(
                f"worst {max((t.worst for n, t in found.tallies.items() if 'rest' in n), default=0):.2f}"
            )
            file.with_suffix(".new").write_bytes(msgspec.json.encode(found))
            file.with_suffix(".new").replace(file)
    return found


def _batches(found: Hunt, drives: int, jobs: int) -> Iterator[list[tuple[Genome, Found, str]]]:
    def tasks() -> list[tuple[Genome, str]]:
        random = Random(f"{found.seed}, {found.drives}")
        return [found.next(random) for _ in range(min(BATCH, drives - found.drives))]

    if jobs == 1:
        while found.drives < drives:
            yield [(genome, judge(genome), made) for genome, made in tasks()]
        return
    with pool_of(jobs) as pool:
        while found.drives < drives:
            given = tasks()
            results = pool.map(judge, (genome for genome, _ in given), chunksize=6)
            yield [(genome, result, made) for (genome, made), result in zip(given, results, strict=True)]


def simplified(genome: Genome, least: float) -> Genome:
    """Without the events, legs and unusual genes that its score does not need to stay above `least`."""

    def tries(g: Genome) -> Iterable[Genome]:
        for event in g.events:
            yield changed(g, events=tuple(e for e in g.events if e is not event))
        for name in g.genes:
            yield changed(g, genes={n: v for n, v in g.genes.items() if n != name})
        for i in reversed(range(1, len(g.legs))):
            yield changed(g, legs=g.legs[:i])

    simpler = True
    while simpler:
        simpler = False
        for other in tries(genome):
            if judge(other).score >= least:
                genome, simpler = other, True
                break
    return genome


def repeats(genome: Genome) -> list[float]:
    """Scores of the same drive by other robots of its kind with other noise, sorted."""
    return sorted(once(changed(genome, seed=genome.seed + i)).score for i in range(REPEATS))


def causes(cases: Iterable[Case], least: float) -> list[Case]:
    """The worst case of each set of kinds of events, simplified; what then has the same set counts once."""
    found: dict[tuple[str, ...], Case] = {}
    for case in tqdm(sorted(cases, key=lambda c: -c.found.score), desc="simplify", unit=" cases", disable=None):
        if case.found.score < least:
            continue
        kinds = {event.kind for event in case.genome.events}
        if any(set(known) <= kinds for known in found):  # its cause is known already
            continue
        genome = simplified(case.genome, max(least, KEPT * min(case.found.score, 10.0)))
        key = tuple(sorted({event.kind for event in genome.events}))
        found.setdefault(key, Case(genome, judge(genome)))
    return list(found.values())
