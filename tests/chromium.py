"""The system's Chromium, headless, driven through its DevTools protocol."""

import asyncio
import base64
import contextlib
import json
import shutil
import subprocess
import tempfile
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import aiohttp

PROGRAM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
PATIENCE_S = 30.0
SWITCHES = (
    "--headless=new",
    "--remote-debugging-port=0",
    "--no-sandbox",  # root has none in a container; the pages are our own
    "--disable-gpu",
    "--disable-dev-shm-usage",
    "--disable-background-networking",
    "--disable-component-update",
    "--no-first-run",
    "--hide-scrollbars",
)


class Tab:
    """One page; commands have their names in the protocol."""

    def __init__(self, socket: aiohttp.ClientWebSocketResponse):
        self._socket = socket
        self._number = 0
        self.complaints: list[str] = []  # exceptions and errors on the page's console

    async def command(self, method: str, **parameters: Any) -> dict[str, Any]:
        """Send a command and wait for its result."""
        self._number += 1
        await self._socket.send_json({"id": self._number, "method": method, "params": parameters})
        while True:
            message = await self._socket.receive_json(timeout=PATIENCE_S)
            self._listen(message)
            if message.get("id") == self._number:
                assert "error" not in message, message["error"]
                result: dict[str, Any] = message["result"]
                return result

    def _listen(self, message: dict[str, Any]) -> None:
        about = message.get("params", {})
        if message.get("method") == "Runtime.exceptionThrown":
            self.complaints.append(json.dumps(about["exceptionDetails"]))
        elif message.get("method") == "Log.entryAdded" and about["entry"]["level"] == "error":
            self.complaints.append(about["entry"]["text"])

    async def open(self, url: str) -> None:
        """Open an address, and wait until it is loaded."""
        await self.command("Runtime.enable")
        await self.command("Log.enable")
        await self.command("Page.enable")
        await self.command("Page.navigate", url=url)
        await self.until("location.protocol != 'about:' && document.readyState == 'complete'")

    async def value(self, expression: str) -> Any:
        """Value of a JavaScript expression; a promise is awaited."""
        result = await self.command("Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in result, result["exceptionDetails"]
        return result["result"].get("value")

    async def until(self, expression: str) -> None:
        """Wait until an expression is true."""
        deadline = asyncio.get_running_loop().time() + PATIENCE_S
        while not await self.value(f"Boolean({expression})"):
            if asyncio.get_running_loop().time() > deadline:
                text = await self.value("document.body.innerText")
                raise AssertionError(f"{expression}: not within {PATIENCE_S:g} s; the page says {text!r}")
            await asyncio.sleep(0.05)

    async def text(self, element: str) -> str:
        """The text of the element with this id."""
        return str(await self.value(f"document.getElementById({json.dumps(element)}).textContent"))

    async def look(
        self, width: int, height: int, scheme: str = "light", ratio: float = 1.0, phone: bool = False
    ) -> None:
        """Set the window's size in CSS pixels, and whether the system is light or dark."""
        size = {"width": width, "height": height, "deviceScaleFactor": ratio, "mobile": phone}
        await self.command("Emulation.setDeviceMetricsOverride", **size)
        feature = {"name": "prefers-color-scheme", "value": scheme}
        await self.command("Emulation.setEmulatedMedia", features=[feature])

    async def picture(self, file: Path, whole: bool = False) -> None:
        """Save a screenshot as PNG; `whole`: including the part below the window's edge."""
        answer = await self.command("Page.captureScreenshot", format="png", captureBeyondViewport=whole)
        file.write_bytes(base64.b64decode(answer["data"]))


@contextlib.asynccontextmanager
async def chromium() -> AsyncIterator[Tab]:
    """A separate browser with an empty page."""
    assert PROGRAM is not None
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile:
        line = [PROGRAM, *SWITCHES, f"--user-data-dir={profile}", "about:blank"]
        process = subprocess.Popen(line, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        try:
            port = await _port(process, Path(profile) / "DevToolsActivePort")
            async with aiohttp.ClientSession() as session:
                async with session.get(f"http://127.0.0.1:{port}/json") as answer:
                    [page] = [target for target in await answer.json() if target["type"] == "page"]
                async with session.ws_connect(page["webSocketDebuggerUrl"], max_msg_size=0) as socket:
                    yield Tab(socket)
        finally:
            process.terminate()
            process.wait(PATIENCE_S)


async def _port(process: "subprocess.Popen[bytes]", file: Path) -> str:
    deadline = asyncio.get_running_loop().time() + PATIENCE_S
    while not (file.exists() and "\n" in (text := file.read_text())):
        assert process.poll() is None, "Chromium ended"
        assert asyncio.get_running_loop().time() < deadline, "Chromium does not open its port"
        await asyncio.sleep(0.05)
    return text.splitlines()[0]
