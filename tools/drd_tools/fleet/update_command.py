"""`drd fleet update`: analyse new and changed recordings."""

import os

from drd.commands import command, whole, writing
from drd_tools.fleet.engine import Engine
from drd_tools.fleet.labels import read_maintenance, read_rules
from drd_tools.fleet.store import Store
from drd_tools.fleet.update import Updated, update

DESCRIPTION = """\
Find the recordings below FOLDERS, diagnose those that are new, have changed, or were diagnosed by another build of drd,
and keep the results in STORE: Parquet tables that pandas, Polars and DuckDB can read directly.

A recording is a folder with encoders.csv or fog.csv, or a run of the daemon (FILE.mcap). FOLDERS and STORE may be
buckets (s3://bucket/prefix; credentials and, as AWS_ENDPOINT_URL, another server are read from the environment). An
update that was stopped resumes where it was; a recording that fails is listed and does not stop the update.
"""
EXAMPLES = """\
examples:
  drd fleet update /data/robots --store fleet --robots robots.yaml --maintenance log.csv
  drd fleet update s3://robots/2026 --store s3://robots/fleet --scheduler tcp://10.0.0.5:8786
  drd fleet query fleet findings --robot 7

robots.yaml: rules, of which all that match are applied, later ones overriding earlier ones; shell patterns, on the path
below FOLDERS. Labels of a recording itself (fleet.yaml in its folder, or FILE.fleet.yaml beside FILE.mcap, with robot,
place, batch and start; robot.yaml's name; the start in a daemon's file) apply where no rule overrides them.
  - recordings: ["warthog_*"]
    robot: warthog-1
    batch: MEMS 2023                        # of its gyro
    start_in_name: '_(?P<year>\\d+)_(?P<month>\\d+)_(?P<day>\\d+)_(?P<hour>\\d+)h(?P<minute>\\d+)s(?P<second>\\d+)'
  - recordings: ["*grass*"]
    place: grass
log.csv: what was done, with the header date,robot,what; a date without a time means any time of that day (UTC)
  2026-06-02,warthog-1,left tyre changed

Exit code: 0 done, even if some recordings failed; 2 bad usage or input.
"""


def main(argv: list[str]) -> int:
    """Run the command. Raises ConfigError on bad input."""
    parser = command("drd fleet update", DESCRIPTION, EXAMPLES)
    add, cores = parser.add_argument, os.cpu_count() or 1
    add("folders", nargs="+", metavar="FOLDERS", help="folders with recordings, at any depth")
    add("--store", required=True, metavar="STORE", help="folder or bucket of the tables")
    add("--robots", metavar="ROBOTS.yaml", help="robot and place of the recordings")
    add("--maintenance", metavar="LOG.csv", help="maintenance of the robots, with dates")
    where = parser.add_mutually_exclusive_group()
    where.add_argument("--jobs", type=whole(1), default=cores, metavar="N", help=f"processes (default: {cores})")
    where.add_argument("--scheduler", metavar="ADDRESS", help="use a running Dask cluster")
    where.add_argument("--cluster", type=whole(1), metavar="N", help="start a Dask cluster of N workers here")
    chosen = parser.parse_args(argv)
    rules = read_rules(chosen.robots)
    log = None if chosen.maintenance is None else read_maintenance(chosen.maintenance)
    engine = Engine(chosen.jobs, chosen.scheduler, chosen.cluster)
    with writing(chosen.store):
        store = Store(chosen.store)
        if log is not None:
            store.keep_maintenance(log)
        _tell(update(chosen.folders, store, rules, engine))
    return 0


def _tell(done: Updated) -> None:
    print(f"{done.found} recordings: {done.analysed} analysed, {done.found - done.analysed} as they were", end="")
    print(f", {done.relabelled} of these with other labels or times of files" if done.relabelled else "")
    if done.undated:
        print(f"  {done.undated} have no start: give it in ROBOTS.yaml (start_in_name) or in fleet.yaml")
    if done.failures:
        print(f"  {len(done.failures)} failed:")
    for recording, error in done.failures:
        print(f"    {recording}: {error}")
