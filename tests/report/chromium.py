"""Chromium without a screen, spoken to over a pipe (Chrome DevTools Protocol): what a page does and asks for."""

import fcntl
import json
import os
import select
import shutil
import subprocess
import time
from base64 import b64decode
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import pytest

PROGRAM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
QUIET = (
    *("--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--hide-scrollbars"),
    *("--disable-background-networking", "--disable-component-update", "--disable-sync"),
)
LIMIT_S = 120.0
PHONE, DESKTOP = (390, 844, True), (1280, 900, False)  # width and height [px], whether fingers are used
needs_chromium = pytest.mark.skipif(PROGRAM is None, reason="chromium is not installed")


class Page:
    """A page in a browser of its own; a context manager.

    Attributes:
        errors: what went wrong in the page, in the browser's words.
        requests: what the page asked for, but for its own file and data; by the number of the request.
        forbidden: those of them that the page's own policy has stopped.
    """

    def __init__(self, file: Path, scratch: Path, size: tuple[int, int, bool] = DESKTOP, scheme: str = "light") -> None:
        self.errors: list[str] = []
        self.requests: dict[str, str] = {}
        self.forbidden: list[str] = []
        self._number = 0
        self._buffer = b""
        ends = [fcntl.fcntl(end, fcntl.F_DUPFD, 10) for end in (*os.pipe(), *os.pipe())]
        theirs_in, self._out, self._in, theirs_out = ends
        command = [str(PROGRAM), *QUIET, "--remote-debugging-pipe", f"--user-data-dir={scratch / 'profile'}"]
        # the protocol is spoken on file descriptors 3 and 4
        self._process = subprocess.Popen(
            ["bash", "-c", f'exec "$0" "$@" 3<&{theirs_in} 4>&{theirs_out}', *command],
            pass_fds=(theirs_in, theirs_out),
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        os.close(theirs_in)
        os.close(theirs_out)
        self._session: str | None = None
        target = self.call("Target.createTarget", url="about:blank")["targetId"]
        self._session = self.call("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        for domain in ("Page", "Network", "Runtime", "Log"):
            self.call(f"{domain}.enable")
        width, height, touch = size
        self.call("Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=touch)
        self.call("Emulation.setTouchEmulationEnabled", enabled=touch)
        self.call("Emulation.setEmulatedMedia", features=[{"name": "prefers-color-scheme", "value": scheme}])
        self.call("Page.navigate", url=file.as_uri())
        self._wait_for("document.readyState === 'complete'")

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._process.terminate()
        self._process.wait()
        os.close(self._out)
        os.close(self._in)

    def wait_until_drawn(self, figures: int) -> None:
        """Wait until the script of the page has drawn so many figures."""
        self._wait_for(f"document.documentElement.dataset.drawn === '{figures}'")

    def value_of(self, expression: str) -> Any:
        """Return what an expression in JavaScript gives."""
        return self.call("Runtime.evaluate", expression=expression, returnByValue=True)["result"].get("value")

    def printed(self) -> bytes:
        """Return the page as PDF."""
        return b64decode(self.call("Page.printToPDF", preferCSSPageSize=True)["data"])

    def screenshot(self) -> bytes:
        """Return the whole page as PNG."""
        return b64decode(self.call("Page.captureScreenshot", captureBeyondViewport=True)["data"])

    def call(self, method: str, **parameters: Any) -> Any:
        """Send a command, and return its result; what happens meanwhile is kept."""
        self._number += 1
        command = {"id": self._number, "method": method, "params": parameters}
        if self._session is not None:
            command["sessionId"] = self._session
        os.write(self._out, json.dumps(command).encode() + b"\0")
        deadline = time.monotonic() + LIMIT_S
        while True:
            message = self._receive(deadline)
            if message.get("id") == self._number:
                assert "error" not in message, f"{method}: {message['error']}"
                return message["result"]
            self._note(message)

    def _receive(self, deadline: float) -> dict[str, Any]:
        while b"\0" not in self._buffer:
            readable, _, _ = select.select([self._in], [], [], max(0.0, deadline - time.monotonic()))
            data = os.read(self._in, 1 << 20) if readable else b""
            assert data, "the browser ended, or does not answer"
            self._buffer += data
        message, _, self._buffer = self._buffer.partition(b"\0")
        found: dict[str, Any] = json.loads(message)
        return found

    def _note(self, message: dict[str, Any]) -> None:
        parameters = message.get("params", {})
        if message.get("method") == "Network.requestWillBeSent":
            url = parameters["request"]["url"]
            if not url.startswith(("file:", "data:", "blob:", "about:")):
                self.requests[parameters["requestId"]] = url
        elif message.get("method") == "Network.loadingFailed" and parameters.get("blockedReason") == "csp":
            self.forbidden.append(self.requests.pop(parameters["requestId"]))
        elif message.get("method") == "Runtime.exceptionThrown":
            self.errors.append(str(parameters["exceptionDetails"]))
        elif message.get("method") == "Log.entryAdded" and parameters["entry"]["level"] == "error":
            self.errors.append(parameters["entry"]["text"])

    def _wait_for(self, condition: str) -> None:
        deadline = time.monotonic() + LIMIT_S
        while not self.value_of(condition):
            assert time.monotonic() < deadline, f"in vain: {condition}; {self.errors}"
            time.sleep(0.05)


def check_page(file: Path, scratch: Path, size: tuple[int, int, bool], figures: int) -> None:
    """Check that every figure is drawn at its full width, without errors, requests or a page that is too wide."""
    with Page(file, scratch, size) as page:
        page.wait_until_drawn(figures)
        assert page.errors == []
        assert page.value_of("document.documentElement.dataset.errors") == ""
        assert page.requests == {}
        assert page.forbidden == []
        assert page.value_of("window.innerWidth") == size[0]
        assert page.value_of("document.documentElement.scrollWidth") <= size[0]
        boxes = page.value_of(
            "Array.from(document.querySelectorAll('.plot')).map((box) => [box.getBoundingClientRect().width,"
            " box.querySelector('.main-svg').getBoundingClientRect().width, box.querySelector('.main-svg')"
            ".querySelectorAll('path, image').length])"
        )
        assert len(boxes) == figures
        for width, drawn, shapes in boxes:
            assert abs(width - drawn) <= 1.0
            assert 0.0 < width <= size[0]
            assert shapes > 0
