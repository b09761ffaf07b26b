"""A headless Chromium that tests talk to by its DevTools protocol, over a pipe."""

import contextlib
import json
import os
import shutil
import subprocess
import time

import pytest

NAME = shutil.which("chromium")
BROWSER = pytest.mark.skipif(NAME is None, reason="no chromium on this machine: apt-get install chromium")
LIMIT = 60.0  # s for one answer; a busy machine is slow


class Browser:
    """One page at a time: what it says on the console, what scripts of the test find in it."""

    def __init__(self, folder, *flags, core=None):
        there, here = os.pipe(), os.pipe()
        quiet = ["--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars", f"--user-data-dir={folder}"]
        command = f'exec "$@" 3<&{there[0]} 4>&{here[1]}'
        self._process = subprocess.Popen(
            [
                *([] if core is None else ["taskset", "-c", str(core)]),
                "bash",
                "-c",
                command,
                "browser",
                NAME,
                "--remote-debugging-pipe",
                *quiet,
                *flags,
                "about:blank",
            ],
            pass_fds=(there[0], here[1]),
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        os.close(there[0])
        os.close(here[1])
        self._to, self._from = there[1], here[0]
        os.set_blocking(self._from, False)
        self._left, self._count = b"", 0
        self.console, self.requests, self._events = [], [], []
        targets = self.call("Target.getTargets", session=False)["targetInfos"]
        page = next(t for t in targets if t["type"] == "page")
        given = {"targetId": page["targetId"], "flatten": True}
        self._session = self.call("Target.attachToTarget", session=False, **given)["sessionId"]
        for room in ("Page", "Runtime", "Log", "Network"):
            self.call(f"{room}.enable")

    def __enter__(self):
        return self

    def __exit__(self, *what):
        with contextlib.suppress(Exception):
            self.call("Browser.close", session=False)
        try:
            self._process.wait(20)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        os.close(self._to)
        os.close(self._from)

    def call(self, method, session=True, **given):
        """What the browser answers to a command."""
        self._count += 1
        message = {"id": self._count, "method": method, "params": given}
        if session:
            message["sessionId"] = self._session
        os.write(self._to, json.dumps(message).encode() + b"\0")
        number, until = self._count, time.monotonic() + LIMIT
        while True:
            answer = self._next(until)
            assert answer is not None, f"{method} was not answered"
            if answer.get("id") == number:
                assert "error" not in answer, (method, answer["error"])
                return answer["result"]
            self._hear(answer)

    def _next(self, until):
        while b"\0" not in self._left:
            with contextlib.suppress(BlockingIOError):
                got = os.read(self._from, 1 << 20)
                assert got, "the browser is gone"
                self._left += got
                continue
            if time.monotonic() > until:
                return None
            time.sleep(0.005)
        first, _, self._left = self._left.partition(b"\0")
        return json.loads(first)

    def _hear(self, event):
        method, said = event.get("method"), event.get("params", {})
        self._events.append(method)
        if method == "Runtime.consoleAPICalled":
            self.console.append(" ".join(str(a.get("value", a.get("description"))) for a in said["args"]))
        elif method == "Runtime.exceptionThrown":
            self.console.append(said["exceptionDetails"].get("exception", {}).get("description", "exception"))
        elif method == "Log.entryAdded":
            self.console.append(said["entry"]["text"])
        elif method == "Network.requestWillBeSent":
            self.requests.append(said["request"]["url"])

    def open(self, page, width=1280, height=900):
        """Load a file and wait until it has loaded."""
        size = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": width < 600}
        self.call("Emulation.setDeviceMetricsOverride", **size)
        self._events.clear()
        self.call("Page.navigate", url=page.as_uri())
        until = time.monotonic() + LIMIT
        while "Page.loadEventFired" not in self._events:
            event = self._next(until)
            assert event is not None, "the page did not load"
            self._hear(event)

    def run(self, script):
        """The value of a script's last expression, awaited."""
        given = {"expression": script, "awaitPromise": True, "returnByValue": True}
        answer = self.call("Runtime.evaluate", **given)
        assert "exceptionDetails" not in answer, answer["exceptionDetails"]
        return answer["result"].get("value")

    def wait(self, condition):
        """Until a script's value is true."""
        until = time.monotonic() + LIMIT
        while not self.run(condition):
            assert time.monotonic() < until, f"this did not come true: {condition}"
            time.sleep(0.02)

    def press(self, key, code=0):
        """A key, such as ArrowRight or Tab."""
        for kind in ("keyDown", "keyUp"):
            self.call("Input.dispatchKeyEvent", type=kind, key=key, code=key, windowsVirtualKeyCode=code)
