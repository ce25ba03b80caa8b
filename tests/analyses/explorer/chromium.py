"""A headless Chromium that is driven by the DevTools protocol over a pipe, in real time."""

import json
import os
import select
import shutil
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome", "chrome"))), None)
needs_chromium = pytest.mark.skipif(CHROMIUM is None, reason="no Chromium to open a page; install chromium")
FLAGS = (
    "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-component-update",
    "--disable-background-networking", "--disable-sync", "--remote-debugging-pipe",
)  # fmt: skip
SOFTWARE = ("--enable-unsafe-swiftshader", "--use-angle=swiftshader", "--hide-scrollbars")
SOFTWARE_WEBGL = (*(flag for flag in FLAGS if flag != "--disable-gpu"), *SOFTWARE)
SECONDS = 60  # for an answer


class Page:
    """One page of a browser."""

    def __init__(self, send: int, receive: int) -> None:
        self._send, self._receive, self._held, self._number = send, receive, b"", 0
        self.errors: list[str] = []
        target = self.ask("Target.createTarget", url="about:blank")["targetId"]
        self._session = None
        self._session = self.ask("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        for domain in ("Page", "Runtime", "Log"):
            self.ask(f"{domain}.enable")

    _session: str | None = None

    def ask(self, method: str, **params: Any) -> dict[str, Any]:
        """The answer to a command of the protocol."""
        self._number += 1
        message: dict[str, Any] = {"id": self._number, "method": method, "params": params}
        if self._session is not None:
            message["sessionId"] = self._session
        os.write(self._send, json.dumps(message).encode() + b"\0")
        while True:
            found = self._read()
            if found.get("id") == self._number:
                assert "error" not in found, found
                return found["result"]
            self._note(found)

    def _read(self) -> dict[str, Any]:
        until = time.monotonic() + SECONDS
        while b"\0" not in self._held:
            ready, _, _ = select.select([self._receive], [], [], max(until - time.monotonic(), 0))
            assert ready, "Chromium does not answer"
            part = os.read(self._receive, 1 << 20)
            assert part, "Chromium has ended"
            self._held += part
        text, _, self._held = self._held.partition(b"\0")
        return json.loads(text)

    def _note(self, event: dict[str, Any]) -> None:
        params = event.get("params", {})
        if event.get("method") == "Runtime.exceptionThrown":
            self.errors.append(json.dumps(params["exceptionDetails"])[:500])
        elif event.get("method") == "Log.entryAdded" and params["entry"]["level"] == "error":
            self.errors.append(params["entry"]["text"])

    def open(self, address: str, width: int = 1400, height: int = 1300) -> None:
        """Open an address in a window of a size in pixels."""
        self.ask("Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=False)
        self.ask("Page.navigate", url=address)

    def run(self, code: str) -> Any:
        """What an expression, or a promise, comes to."""
        found = self.ask("Runtime.evaluate", expression=code, awaitPromise=True, returnByValue=True)
        assert "exceptionDetails" not in found, found["exceptionDetails"]
        return found["result"].get("value")

    def like(self, scheme: str) -> None:
        """Prefer light or dark colours."""
        self.ask("Emulation.setEmulatedMedia", features=[{"name": "prefers-color-scheme", "value": scheme}])

    def is_white(self) -> bool:
        return bool(self.run("getComputedStyle(document.body).backgroundColor === 'rgb(255, 255, 255)'"))

    def violations(self) -> list[tuple[str, str]]:
        """What the rules of axe find: names of controls, texts of pictures, contrast, order of headings."""
        axe = pytest.importorskip("axe_core_python.base", reason="no axe; pip install axe-core-python")
        self.run(Path(axe.__file__).with_name("axe.min.js").read_text(encoding="utf-8") + "; 0")
        found = self.run("axe.run({ exclude: ['svg > *'] })")  # a drawing is one picture
        return [(one["id"], one["nodes"][0]["html"][:200]) for one in found["violations"]]

    def until(self, code: str, seconds: float = SECONDS) -> float:
        """Wait until an expression is true; seconds that took."""
        began = time.monotonic()
        while not self.run(f"Boolean({code})"):
            assert time.monotonic() - began < seconds, f"not within {seconds} s: {code}"
            time.sleep(0.02)
        return time.monotonic() - began


@contextmanager
def page(profile: Path, flags: tuple[str, ...] = FLAGS) -> Iterator[Page]:
    """A page of a browser that ends with the block."""
    to_read, send = os.pipe()
    receive, to_write = os.pipe()

    def pipes() -> None:  # the browser reads from 3 and writes to 4
        read, write = os.dup(to_read), os.dup(to_write)
        os.dup2(read, 3)
        os.dup2(write, 4)

    browser = subprocess.Popen(
        [str(CHROMIUM), *flags, f"--user-data-dir={profile}", "about:blank"],
        stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, preexec_fn=pipes, close_fds=False,
    )  # fmt: skip
    os.close(to_read)
    os.close(to_write)
    try:
        yield Page(send, receive)
    finally:
        browser.terminate()
        browser.wait(20)
        os.close(send)
        os.close(receive)
