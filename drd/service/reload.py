"""A new configuration for a running daemon: read and checked completely before anything changes."""

from dataclasses import dataclass, replace
from pathlib import Path

from drd.config.file import load_config
from drd.config.keys import Config
from drd.config.schema import ConfigError, Loaded, values
from drd.output.session import check_output
from drd.pipeline import Pipeline
from drd.recording.in_force import AS_WRITTEN, files_in_force


@dataclass(frozen=True)
class Prepared:
    """The parts that a reload will put into force.

    `pipeline`: built from it, without samples yet. `files`: the texts of all files in force, for a replay. `waiting`:
    keys whose new values take effect only at the next start.
    """

    loaded: Loaded[Config]
    pipeline: Pipeline
    files: dict[str, str]
    waiting: list[str]


def prepare(running: Loaded[Config], base: Path) -> Prepared:
    """Read the running configuration's file again, with all files that it names. Raises ConfigError; changes nothing.

    Takes as long as a start, so do not call it in the event loop.
    """
    written = load_config(Path(running.file))
    try:
        check_output(written.value.output.beside(base))
        loaded, waiting = _with_what_stays(running, written)
        pipeline = Pipeline(loaded.value, base, lambda *_: None)
        files = files_in_force(loaded, base)
    except ConfigError as error:
        if error.path not in written.origins:  # an error in another file, which it names
            raise
        raise ConfigError(written.place(error.path), error.path, error.expected, error.got) from error
    texts = {name: data.decode("utf-8", "replace") for name, data in files.items() if name != AS_WRITTEN}
    return Prepared(loaded, pipeline, texts, waiting)


def _with_what_stays(running: Loaded[Config], written: Loaded[Config]) -> tuple[Loaded[Config], list[str]]:
    """The new values, except for keys that are set up once: name, session, recorder, state, scheduling."""
    old, new = running.value, written.value
    output = replace(old.output, publish_on=new.output.publish_on, health_period_s=new.output.health_period_s)
    config = replace(
        new,
        robot=replace(new.robot, name=old.robot.name),
        output=output,
        recording=old.recording,
        state=old.state,
        realtime=old.realtime,
    )
    found = values(config)
    waiting = [path for path, value in values(new).items() if found[path] != value]
    return Loaded(config, written.origins | {path: running.origins[path] for path in waiting}, running.file), waiting
