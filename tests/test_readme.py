"""What README.md and the pages beside the code show works, and what they list is what there is."""

import asyncio
import contextlib
import io
import itertools
import json
import re
import shlex
import socket
import sys
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drd.cli import COMMANDS, main
from drd.config.keys import Output
from drd.output import forms
from drd.output.messages import pose_dict
from drd.output.zenoh_link import ZenohLink
from drd.samples import Pose, Validity
from drd_tools.simulate.missions import make_drive
from drd_tools.simulate.robot import DEFAULT
from drd_tools.simulate.simulator import simulate
from drd_tools.simulate.truth import make_truth

ROOT = Path(__file__).parents[1]
NOT_OURS = {"out", "build", "dist", "node_modules"}  # and hidden folders: environments, caches
PAGES = {
    str(name): file.read_text(encoding="utf-8")
    for file in sorted(ROOT.rglob("*.md"))
    for name in [file.relative_to(ROOT)]
    if not any(part in NOT_OURS or part.startswith(".") for part in name.parts)
}
README = PAGES["README.md"]
OUTPUT = PAGES["drd/output/README.md"]
LONGEST_README = 9000
FENCED = re.compile(r"^```.*?^```", re.MULTILINE | re.DOTALL)
# Rows of README.md's table of missing physics, and of FIGURES.md, which a trial writes.
QUOTED = {
    "nothing is missing, yet something is reported": "nothing is missing, something is reported",
    "one effect, d = 12: its name comes first": "single d=12: the right name first",
    "one effect, d = 12: its class comes first": (
        "single d=12: the right name, or one that the drive cannot tell from it"
    ),
    "two effects, d = 20 each: exactly these classes": (
        "pair d=20: exactly the right set, up to what cannot be told apart"
    ),
    "three effects, d = 20 each: exactly these classes": (
        "triple d=20: exactly the right set, up to what cannot be told apart"
    ),
    "an effect outside the catalogue is flagged as unknown": "in no catalogue: flagged as unknown",
}
POSE = Pose(
    t_ns=1,
    sequence=2,
    x_m=3.0,
    y_m=4.0,
    heading_rad=0.5,
    speed_m_s=1.0,
    rate_rad_s=0.1,
    speed_sigma_m_s=0.01,
    rate_sigma_rad_s=0.001,
    covariance=(1.0, 0.0, 0.0, 1.0, 0.0, 1.0),
    position_bound_m=0.2,
    validity=Validity.VALID,
    reasons=(),
)
DEFAULT_ENDPOINT = Output().listen[0]


def rows(page: str, heading: str) -> list[list[str]]:
    """The cells of the table with this first heading, without its head."""
    lines = PAGES[page].split(f"| {heading} |", 1)[1].split("\n\n", 1)[0].splitlines()[2:]
    return [[cell.strip() for cell in line.split("|")[1:-1]] for line in lines]


def table(page: str, heading: str) -> list[str]:
    """The names in the first column of the table with this first heading."""
    return [name for row in rows(page, heading) for name in re.findall(r"`([^`]+)`", row[0])]


def shown_commands() -> list[tuple[str, str]]:
    """Each line of an indented block that calls drd: the page, and the line from `drd` on, without its comment."""
    pattern = re.compile(r"^ {4,}(?:.*&& )?(?:sudo )?(?:/opt/drd/bin/)?(drd [^#\n]+)", re.MULTILINE)
    texts = {page: FENCED.sub("", text) for page, text in PAGES.items()}
    return [(page, line.strip()) for page, text in texts.items() for line in pattern.findall(text)]


def anchors(page: str) -> set[str]:
    """The names by which GitHub knows the headings of a page."""
    headings = re.findall(r"^#+ (.*)$", FENCED.sub("", PAGES[page]), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading).strip().lower().replace(" ", "-") for heading in headings}


async def printed(program: str, endpoint: str, missed: int) -> list[bytes]:
    """What `program` prints first while a link publishes poses at `endpoint`, and next after it has missed some."""
    link = ZenohLink(Output(listen=(endpoint,)), {}, asyncio.get_running_loop())
    pipe = asyncio.subprocess.PIPE
    reader = await asyncio.create_subprocess_exec(sys.executable, "-c", program, stdin=pipe, stdout=pipe)
    assert reader.stdout is not None
    assert reader.stdin is not None
    poses = (replace(POSE, sequence=number, x_m=float(number)) for number in itertools.count())
    lines = []
    try:
        async with asyncio.timeout(20.0):
            for _ in range(2):
                line = asyncio.create_task(reader.stdout.readline())
                while not line.done():
                    link.publish_pose(next(poses), 0)
                    await asyncio.sleep(0.05)
                lines.append(line.result())
                for _ in range(missed):
                    link.publish_pose(next(poses), 0)
                    await asyncio.sleep(0.005)
                reader.stdin.write(b"\n")
        return lines
    finally:
        with contextlib.suppress(ProcessLookupError):
            reader.kill()
        await reader.communicate()
        link.close()


@pytest.mark.process
def test_the_subscriber_prints_the_poses_of_a_running_link_and_the_newest_one_when_it_is_slow() -> None:
    (snippet,) = re.findall(r"```python\n(.*?)```", OUTPUT, re.DOTALL)
    assert DEFAULT_ENDPOINT in snippet
    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        endpoint = f"tcp/127.0.0.1:{s.getsockname()[1]}"
    slow = snippet.replace(DEFAULT_ENDPOINT, endpoint) + "        input()\n"
    first, second = (line.decode().split() for line in asyncio.run(printed(slow, endpoint, missed=100)))
    assert first[1:] == second[1:] == ["4.0", "0.5", "0.2", "valid"]
    assert float(second[0]) > float(first[0]) + 1.0


def test_the_keys_are_those_of_the_link() -> None:
    names = [name.removeprefix("drd/") for name in table("drd/output/README.md", "key")]
    assert sorted(names) == sorted({*forms.QUESTIONS, *forms.COMMANDS, "odom", "alive"})


def test_the_fields_are_those_of_the_pose() -> None:
    assert table("drd/output/README.md", "field of the pose") == list(pose_dict(POSE, 0))


def test_the_words_of_validity_are_explained() -> None:
    row = next(line for line in OUTPUT.splitlines() if line.startswith("| `validity`"))
    assert set(re.findall(r"`([^`]+)`", row)) == {"validity", *(v.value for v in Validity)}


def test_the_payload_of_set_pose_is_json_with_keys_that_are_taken() -> None:
    (payload,) = re.findall(r"payload `(\{.*?\})`", OUTPUT)
    assert json.loads(payload).keys() == {"x_m", "y_m", "heading_rad"}


def test_the_commands_are_those_of_the_program() -> None:
    assert [name.split()[1] for name in table("drd/commands/README.md", "command")] == list(COMMANDS)


def test_every_configuration_is_named() -> None:
    for name in {file.stem for file in (ROOT / "config").glob("*.yaml")} - {"demo"}:
        assert f"`{name}`" in README


def test_the_readme_is_short() -> None:
    assert len(README) <= LONGEST_README


@pytest.mark.parametrize("page", PAGES)
def test_every_relative_link_leads_somewhere(page: str) -> None:
    links = re.findall(r"(?<!\\)\]\(([^)\s]+)\)", FENCED.sub("", PAGES[page]))
    for link in (link for link in links if "://" not in link):
        path, _, anchor = link.partition("#")
        target = (ROOT / page).parent / path if path else ROOT / page
        assert target.exists(), link
        assert not anchor or anchor in anchors(str(target.resolve().relative_to(ROOT))), link


def test_the_readme_leads_to_every_page() -> None:
    """Directly, or by way of a page that it leads to."""
    reached, found = {"README.md"}, ["README.md"]
    while found:
        page = found.pop()
        for link in re.findall(r"\]\(([^)\s#]+)[^)]*\)", FENCED.sub("", PAGES[page])):
            name = str(((ROOT / page).parent / link).resolve()).removeprefix(f"{ROOT}/")
            if name in PAGES and name not in reached:
                reached.add(name)
                found.append(name)
    assert reached == set(PAGES)


def test_the_maps_name_every_folder() -> None:
    for page, heading, folder in (
        ("drd/README.md", "folder", "drd"),
        ("tools/README.md", "package", "tools/drd_tools"),
    ):
        packages = {file.parent.name for file in (ROOT / folder).glob("*/__init__.py")}
        assert sorted(name.removesuffix("/") for name in table(page, heading)) == sorted(packages), page


def test_make_knows_the_commands() -> None:
    assert re.findall(r"^    make (\w+)", README, re.MULTILINE) == ["demo", "test"]
    makefile = (ROOT / "Makefile").read_text()
    for page in PAGES.values():
        for command in re.findall(r"^    (?:sudo )?make ([\w-]+)", page, re.MULTILINE):
            assert re.search(rf"^{command}:", makefile, re.MULTILINE), command


@cache
def options(*command: str) -> frozenset[str]:
    """The options that `drd COMMAND --help` explains."""
    page = io.StringIO()
    with contextlib.redirect_stdout(page), pytest.raises(SystemExit):
        main([*command, "--help"])
    return frozenset(re.findall(r"(?<![\w-])--[a-z][a-z-]*", page.getvalue()))


@pytest.mark.parametrize(("page", "line"), shown_commands())
def test_a_command_that_is_shown_is_one(page: str, line: str) -> None:
    _, command, *arguments = shlex.split(line)
    assert command in COMMANDS, page
    kind = arguments[:1] if command in ("calibrate", "fleet") else []
    assert {a for a in arguments if a.startswith("--")} <= options(command, *kind), page


def test_a_command_that_is_named_is_one() -> None:
    for page, text in PAGES.items():
        assert set(re.findall(r"`(?:sudo )?(?:/opt/drd/bin/)?drd ([a-z][a-z0-9-]*)", text)) <= set(COMMANDS), page


def test_the_commands_are_found_in_the_pages() -> None:
    pages = {page for page, _ in shown_commands()}
    assert {"README.md", "systemd/README.md", "tools/drd_tools/calibrate/README.md"} <= pages


def test_the_figures_of_the_diagnosis_are_those_of_the_trial() -> None:
    page = "tools/drd_tools/trial/FIGURES.md"
    written = {
        row[0]: [cell.split()[0] for cell in row[2:]] for row in rows(page, "figure (95 % Wilson interval)") if row[3]
    }
    shown = {row[0]: row[1:] for row in rows("README.md", "share of the recordings")}
    assert shown == {label: written[row] for label, row in QUOTED.items()}
    (recordings,) = re.findall(r"(\d+) recordings whose answer was hidden", README)
    assert f" {recordings} recordings whose answer was hidden" in PAGES[page]


def test_the_python_lines_run(capsys: pytest.CaptureFixture[str]) -> None:
    recording = simulate(make_truth(make_drive("slalom", 30.0)), DEFAULT, [], seed=1).recording
    fog, encoders, truth = recording.fog, recording.encoders, recording.reference
    assert fog is not None
    assert truth is not None
    assert encoders.left_counts is not None
    assert encoders.right_counts is not None
    assert DEFAULT.counts_per_revolution is not None
    per_count = 4096 / DEFAULT.counts_per_revolution * DEFAULT.wheel_radius_m / 0.1  # of the robot that the page shows
    names: dict[str, Any] = {
        "gyro": {"time_s": fog.time_s, "rate_deg_s": np.degrees(fog.rate_rad_s)},
        "wheels": {
            "time_s": encoders.time_s,
            "left_counts": np.round(per_count * encoders.left_counts),
            "right_counts": np.round(per_count * encoders.right_counts),
        },
        "pose": {
            "time_s": truth.time_s,
            "x_m": truth.x_m,
            "y_m": truth.y_m,
            "heading_deg": np.degrees(truth.heading_rad),
        },
    }
    for lines in re.findall(r"```python\n(.*?)```", README, re.DOTALL):
        exec(lines, names)
    (columns,) = re.findall(r"`poses` has\s(.*?)\.", README, re.DOTALL)
    for name in re.findall(r"`(\w+)`", columns):
        assert len(getattr(names["poses"], name)) == len(names["poses"].time_s)
    assert names["diagnosis"].verdict in capsys.readouterr().out
