"""What the README shows works, and what it lists is what there is."""

import asyncio
import contextlib
import json
import re
import socket
import sys
from pathlib import Path

import pytest

from drd.cli import COMMANDS
from drd.config.keys import Output
from drd.output import queries
from drd.output.messages import pose_dict
from drd.output.zenoh_link import ZenohLink
from drd.samples import Pose, Validity

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text()
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


def table(heading: str) -> list[str]:
    """The names in the first column of the table with this first heading."""
    rows = README.split(f"| {heading} |", 1)[1].split("\n\n", 1)[0].splitlines()[2:]
    return [name for row in rows for name in re.findall(r"`([^`]+)`", row.split("|")[1])]


async def first_line(program: str, endpoint: str) -> bytes:
    """What `program` prints first while a link publishes poses at `endpoint`."""
    link = ZenohLink(Output(listen=(endpoint,)), {}, asyncio.get_running_loop())
    reader = await asyncio.create_subprocess_exec(sys.executable, "-c", program, stdout=asyncio.subprocess.PIPE)
    try:
        assert reader.stdout is not None
        line = asyncio.create_task(reader.stdout.readline())
        async with asyncio.timeout(20.0):
            while not line.done():
                link.publish_pose(POSE, 0)
                await asyncio.sleep(0.05)
        return line.result()
    finally:
        with contextlib.suppress(ProcessLookupError):
            reader.kill()
        await reader.communicate()
        link.close()


@pytest.mark.process
def test_the_subscriber_prints_the_poses_of_a_running_link() -> None:
    (snippet,) = re.findall(r"```python\n(.*?)```", README, re.DOTALL)
    assert DEFAULT_ENDPOINT in snippet
    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        endpoint = f"tcp/127.0.0.1:{s.getsockname()[1]}"
    line = asyncio.run(first_line(snippet.replace(DEFAULT_ENDPOINT, endpoint), endpoint))
    assert line == b"3.0 4.0 0.5 0.2 valid\n"


def test_the_keys_are_those_of_the_link() -> None:
    names = [name.removeprefix("drd/") for name in table("key")]
    assert sorted(names) == sorted({*queries.QUESTIONS, *queries.COMMANDS, "odom", "alive"})


def test_the_fields_are_those_of_the_pose() -> None:
    assert table("field of the pose") == list(pose_dict(POSE, 0))


def test_the_words_of_validity_are_explained() -> None:
    row = next(line for line in README.splitlines() if line.startswith("| `validity`"))
    assert set(re.findall(r"`([^`]+)`", row)) == {"validity", *(v.value for v in Validity)}


def test_the_payload_of_set_pose_is_json_with_keys_that_are_taken() -> None:
    (payload,) = re.findall(r"payload `(\{.*?\})`", README)
    assert json.loads(payload).keys() == {"x_m", "y_m", "heading_rad"}


def test_the_commands_are_those_of_the_program() -> None:
    assert [name.split()[1] for name in table("command")] == list(COMMANDS)


def test_every_configuration_and_every_linked_file_exists() -> None:
    links = [link for link in re.findall(r"(?<!!)\[[^\]]*\]\(([^)]+)\)", README) if "://" not in link]
    assert len(links) >= 5
    assert [link for link in links if not (ROOT / link).is_file()] == []
    for name in {file.stem for file in (ROOT / "config").glob("*.yaml")} - {"demo"}:
        assert f"`{name}`" in README


def test_make_knows_the_two_commands() -> None:
    makefile = (ROOT / "Makefile").read_text()
    for command in re.findall(r"^    make (\w+)", README, re.MULTILINE):
        assert re.search(rf"^{command}:", makefile, re.MULTILINE)
