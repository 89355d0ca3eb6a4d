"""A headless Chromium that a test drives: opens pages, runs their scripts, and tells
which addresses they asked for."""

import base64
import json
import shutil
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import count
from pathlib import Path
from time import monotonic
from typing import Any
from urllib.request import urlopen

import pytest
from websockets.sync.client import connect

from tests.waiting import until

PROGRAM = shutil.which("chromium") or shutil.which("google-chrome")
# Nothing of the browser's own may be taken for a request of a page.
QUIET = (
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--disable-dev-shm-usage",
    "--remote-debugging-port=0",
)


class Tab:
    """One tab."""

    def __init__(self, socket: Any):
        self._socket, self._number = socket, count(1)
        self.asked: dict[str, str] = {}
        self.refused: list[str] = []
        self.said: list[str] = []
        for domain in ("Page", "Runtime", "Network", "Log"):
            self._call(f"{domain}.enable")

    def open(self, address: str) -> None:
        self._call("Page.navigate", url=address)

    def run(self, script: str) -> Any:
        done = self._call(
            "Runtime.evaluate", expression=script, awaitPromise=True, returnByValue=True
        )
        assert "exceptionDetails" not in done, done["exceptionDetails"]
        return done["result"].get("value")

    def wait(self, script: str, what: str) -> Any:
        return until(lambda: self.run(script), what, 0.3)

    def listen(self, seconds: float) -> None:
        last = monotonic() + seconds
        while (left := last - monotonic()) > 0:
            try:
                self._note(json.loads(self._socket.recv(timeout=left)))
            except TimeoutError:
                return

    def log_in(self, ui: str, key: str) -> None:
        """Show the key to the pages of a server, as its owner does at the login."""
        signed = base64.b64encode(key.encode()).decode()
        headers = {"Authorization": f"Basic {signed}"}
        self._call("Network.setExtraHTTPHeaders", headers=headers)
        self.open(ui)
        self.wait("location.pathname.startsWith('/v2') && !!document.title", "open")
        self.run(f"localStorage.setItem('prefect-password', '{signed}')")

    def resize(self, width: int, height: int) -> None:
        size = {"width": width, "height": height}
        self._call(
            "Emulation.setDeviceMetricsOverride", **size, deviceScaleFactor=1, mobile=width < 600
        )

    def prefer(self, scheme: str) -> None:
        """Ask pages for "light" or "dark"."""
        wish = [{"name": "prefers-color-scheme", "value": scheme}]
        self._call("Emulation.setEmulatedMedia", features=wish)

    def press_tab(self) -> None:
        for kind in ("rawKeyDown", "keyUp"):
            key = {"key": "Tab", "code": "Tab", "windowsVirtualKeyCode": 9}
            self._call("Input.dispatchKeyEvent", type=kind, **key)

    def _call(self, method: str, **params: Any) -> dict:
        number = next(self._number)
        order = {"id": number, "method": method, "params": params}
        self._socket.send(json.dumps(order))
        while True:
            message = json.loads(self._socket.recv(timeout=120))
            if message.get("id") == number:
                assert "error" not in message, message
                return message["result"]
            self._note(message)

    def _note(self, message: dict) -> None:
        event = message.get("params", {})
        match message.get("method"):
            case "Network.requestWillBeSent":
                self.asked[event["requestId"]] = event["request"]["url"]
            case "Network.webSocketCreated":
                self.asked[event["requestId"]] = event["url"]
            case "Network.loadingFailed":
                if event.get("blockedReason"):
                    self.refused.append(self.asked.pop(event["requestId"], "?"))
            case "Log.entryAdded" if event["entry"]["level"] == "error":
                self.said.append(event["entry"]["text"])
            case "Runtime.exceptionThrown":
                about = event["exceptionDetails"]
                said = about.get("exception", {}).get("description")
                self.said.append(said or about["text"])


@contextmanager
def browser(folder: Path, *options: str) -> Iterator[Tab]:
    words = [PROGRAM, *QUIET, f"--user-data-dir={folder}", *options, "about:blank"]
    with (folder / "log").open("wb") as log:
        process = subprocess.Popen(words, stdout=log, stderr=log)
    try:
        note = folder / "DevToolsActivePort"
        until(lambda: note.exists() and note.read_text().count("\n"), "it runs", 0.1)
        port = note.read_text().split("\n")[0]
        with urlopen(f"http://127.0.0.1:{port}/json/list") as told:
            tabs = [t for t in json.load(told) if t["type"] == "page"]
        with connect(tabs[0]["webSocketDebuggerUrl"], max_size=None) as socket:
            yield Tab(socket)
    finally:
        process.terminate()
        process.wait(30)


@contextmanager
def alone(folder: Path, rule: str) -> Iterator[Tab]:
    if PROGRAM is None:
        pytest.skip("no chromium on this machine (Debian: apt-get install chromium)")
    folder.mkdir(exist_ok=True)
    with browser(folder, f"--host-resolver-rules=MAP * ~NOTFOUND{rule}") as tab:
        yield tab
