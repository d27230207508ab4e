"""The page in a real browser; on pictures that people should see, `Tab.picture` saves them."""

import asyncio
import contextlib
import math
from collections.abc import AsyncIterator

import pytest
from chromium import PROGRAM, Tab, chromium
from links import free_endpoint
from web_robot import RADIUS_M, Robot, a_robot, a_web

from drd.samples import Validity

pytestmark = pytest.mark.skipif(PROGRAM is None, reason="Chromium is not installed (Debian: apt install chromium)")

MINUS = "\N{MINUS SIGN}"
LIVE = "document.body.dataset.link == 'live'"
# How many pixels of the canvas have, but for smoothing, the colour of this CSS variable.
PIXELS = """(() => {{
  const probe = document.body.appendChild(document.createElement("i"));
  probe.style.color = "var({colour})";
  const wanted = getComputedStyle(probe).color.match(/\\d+/g).map(Number);
  probe.remove();
  const canvas = document.getElementById("{canvas}");
  const data = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height).data;
  let count = 0;
  for (let i = 0; i < data.length; i += 4) {{
    if (data[i + 3] > 200 && wanted.every((value, k) => Math.abs(value - data[i + k]) < 12)) count++;
  }}
  return count;
}})()"""


def pixels(canvas: str, colour: str) -> str:
    return PIXELS.format(canvas=canvas, colour=colour)


def click(element: str) -> str:
    return f"document.getElementById('{element}').click()"


@contextlib.asynccontextmanager
async def a_page(commands: bool = True) -> AsyncIterator[tuple[Tab, Robot]]:
    """A page that is live, and the robot that it shows."""
    with a_robot(free_endpoint(), commands) as robot:
        async with a_web(robot.endpoint) as url, chromium() as tab:
            await tab.look(1280, 800)
            await tab.open(url)
            await tab.until(LIVE)
            yield tab, robot
            assert tab.complaints == []


def test_path_pose_bound_and_what_was_learned_are_drawn_from_this_server_alone() -> None:
    async def test() -> None:
        async with a_page() as (tab, _):
            await tab.until("Number(document.getElementById('x').textContent) > 0.5")
            x_m, y_m = [float((await tab.text(name)).replace(MINUS, "-")) for name in ("x", "y")]
            assert math.hypot(x_m, y_m - RADIUS_M) == pytest.approx(RADIUS_M, abs=0.05)
            assert await tab.text("validity") == "valid"
            assert await tab.text("bound") == "0.90 m"
            assert await tab.text("sigma") == "0.20 m, 0.30 m"
            assert await tab.value(pixels("map-canvas", "--accent")) > 100
            assert await tab.value(pixels("strip-canvas", "--valid")) > 1000
            assert "0.6100± 0.0020 m" in await tab.text("learned")
            assert "Gyro scale 1.200" in await tab.text("findings")
            assert await tab.text("fog-rate") == "10.0 Hz"
            await tab.value("document.querySelectorAll('details').forEach((part) => part.open = true)")
            await tab.until("document.getElementById('counters').textContent.includes('samples77')")
            loaded = (
                "performance.getEntriesByType('resource').filter((e) => !e.name.startsWith(location.origin)).length"
            )
            assert await tab.value(loaded) == 0

    asyncio.run(test())


def test_a_degraded_pose_says_why_and_the_past_can_be_looked_at() -> None:
    async def test() -> None:
        async with a_page() as (tab, robot):
            await tab.until("Number(document.getElementById('x').textContent) > 0.5")
            robot.validity, robot.reasons = Validity.DEGRADED, (("fog", "no gyro samples"), ("<b>", "<img src=x>"))
            await tab.until("document.getElementById('validity').textContent == 'degraded'")
            assert "fog: no gyro samples" in await tab.text("findings")
            assert "<b>: <img src=x>" in await tab.text("findings"), "text stays text"
            await tab.until(f"{pixels('strip-canvas', '--degraded')} > 20")
            await tab.until(f"{pixels('map-canvas', '--degraded')} > 20")
            scrub = "document.getElementById('scrub')"
            await tab.value(f"{scrub}.value = {scrub}.min; {scrub}.dispatchEvent(new Event('input'))")
            await tab.until("document.getElementById('when').textContent.startsWith('as it was at')")
            assert await tab.text("validity") == "valid"
            assert float(await tab.text("x")) < 0.5
            assert "no gyro samples" not in await tab.text("findings")
            await tab.value("document.querySelector('#events button').click()")
            await tab.until("document.getElementById('validity').textContent == 'degraded'")
            assert "fog: no gyro samples" in await tab.text("findings")
            await tab.value(click("live"))
            await tab.until("document.getElementById('when').textContent.startsWith('fog: no gyro samples')")

    asyncio.run(test())


def test_a_lost_server_and_a_silent_daemon_are_said_and_the_page_comes_back() -> None:
    async def test() -> None:
        port = int(free_endpoint().rpartition(":")[2])
        with a_robot(free_endpoint()) as robot:
            async with chromium() as tab:
                async with a_web(robot.endpoint, port=port) as url:
                    await tab.open(url)
                    await tab.until(LIVE)
                    robot.is_silent = True
                    await tab.until("document.body.dataset.link == 'silent'")
                    assert "The daemon runs but sends none" in await tab.text("banner")
                    assert await tab.text("validity") == "was valid"
                    assert await tab.value("document.getElementById('commands').hidden")
                await tab.until("document.body.dataset.link == 'lost'")
                assert "Connection lost" in await tab.text("banner")
                assert not await tab.value("document.getElementById('banner').hidden")
                robot.is_silent = False
                async with a_web(robot.endpoint, port=port):
                    await tab.until(LIVE)
                    assert await tab.value("document.getElementById('banner').hidden")
                    assert await tab.text("validity") == "valid"

    asyncio.run(test())


def test_light_dark_and_a_phone() -> None:
    async def test() -> None:
        async with a_page() as (tab, _):
            ground = (
                "getComputedStyle(document.body).backgroundColor.match(/\\d+/g).reduce((sum, v) => sum + Number(v), 0)"
            )
            assert await tab.value(ground) > 600
            await tab.look(1280, 800, "dark")
            await tab.until(f"{ground} < 150")
            await tab.until(f"{pixels('strip-canvas', '--valid')} > 1000")
            for width in (320, 390):
                await tab.look(width, 844, "dark", 2.0, phone=True)
                await tab.until(f"innerWidth == {width} && document.getElementById('map-canvas').width > {width}")
                assert await tab.value("document.documentElement.scrollWidth") <= width
                assert await tab.value("document.getElementById('map').getBoundingClientRect().bottom") < 844
                await tab.until(f"{pixels('map-canvas', '--accent')} > 100")

    asyncio.run(test())


@pytest.mark.parametrize("allowed", [True, False])
def test_buttons_are_there_where_commands_are_allowed_and_ask_first(allowed: bool) -> None:
    async def test() -> None:
        async with a_page(allowed) as (tab, robot):
            if not allowed:
                await tab.until("document.getElementById('fog-rate').textContent == '10.0 Hz'")
                assert await tab.value("document.getElementById('commands').hidden")
                return
            await tab.until("!document.getElementById('commands').hidden")
            await tab.value(f"document.querySelector('[name=x_m]').value = '{MINUS}1,5'")
            await tab.value("document.querySelector('[name=heading_deg]').value = '90'")
            await tab.value("document.querySelector('#set-pose button').click()")
            await tab.until("document.getElementById('confirm').open")
            assert robot.requests == []
            await tab.value(click("confirm-yes"))
            await tab.until("document.getElementById('outcome').textContent.startsWith('The pose is set')")
            [(name, request)] = robot.requests
            expected = {"x_m": -1.5, "y_m": 0, "heading_rad": math.pi / 2, "sigma_m": 0, "sigma_rad": 0}
            assert name == "set_pose"
            assert request == pytest.approx(expected)
            await tab.value(click("reset"))
            await tab.value("document.querySelector('#confirm button[value=no]').click()")
            await tab.until("!document.getElementById('confirm').open")
            assert len(robot.requests) == 1

    asyncio.run(test())


def test_a_token_in_the_address_opens_the_page_and_disappears() -> None:
    async def test() -> None:
        with a_robot(free_endpoint()) as robot:
            async with a_web(robot.endpoint, token="a-token-of-letters") as url, chromium() as tab:
                await tab.open(url)
                assert "token" in await tab.value("document.body.innerText")
                await tab.open(f"{url}/?token=a-token-of-letters")
                await tab.until(LIVE)
                assert await tab.value("location.search") == ""

    asyncio.run(test())
