"""A real browser for tests: headless Chromium spoken to over a pipe, at any width, by day or night."""

import base64
import fcntl
import json
import os
import subprocess
from contextlib import contextmanager
from pathlib import Path

CHROMIUM = Path("/usr/bin/chromium")


class Tab:
    """One page in the browser.

    complaints : what the page wrote to its console, exceptions included
    asked : addresses that it asked for beyond itself
    """

    def __init__(self, wire_in, wire_out):
        self._in, self._out, self._last = wire_in, wire_out, 0
        self._session = None
        self.complaints, self.asked = [], []
        target = self.ask("Target.createTarget", url="about:blank")["targetId"]
        self._session = self.ask("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        for domain in ("Page", "Runtime", "Log", "Network"):
            self.ask(f"{domain}.enable")

    def ask(self, method, **params):
        self._last += 1
        message = {"id": self._last, "method": method, "params": params}
        if self._session:
            message["sessionId"] = self._session
        self._in.write(json.dumps(message).encode() + b"\0")
        self._in.flush()
        while True:
            said = self._read()
            if said.get("id") == self._last:
                assert "error" not in said, said
                return said["result"]

    def _read(self):
        raw = bytearray()
        while (one := self._out.read(1)) != b"\0":
            assert one, "the browser ended"
            raw += one
        said = json.loads(raw)
        if said.get("method") in {"Runtime.exceptionThrown", "Runtime.consoleAPICalled", "Log.entryAdded"}:
            self.complaints.append(json.dumps(said["params"]))
        url = said["params"]["request"]["url"] if said.get("method") == "Network.requestWillBeSent" else "about:blank"
        if not url.startswith(("file:", "data:", "about:")):
            self.asked.append(url)
        self.seen = said
        return said

    def show(self, page, width, height=900, *, phone=False, dark=False, scripts=True):
        """Load a file as a screen of this size shows it."""
        self.complaints.clear()
        self.asked.clear()
        self.ask(
            "Emulation.setDeviceMetricsOverride",
            width=width, height=height, deviceScaleFactor=1, mobile=phone, screenWidth=width, screenHeight=height,
        )  # fmt: skip
        scheme = "dark" if dark else "light"
        self.ask("Emulation.setEmulatedMedia", features=[{"name": "prefers-color-scheme", "value": scheme}])
        self.ask("Emulation.setScriptExecutionDisabled", value=not scripts)
        self.ask("Page.navigate", url=page.as_uri())
        while self.seen.get("method") != "Page.loadEventFired":
            self._read()
        # two frames later observers have run and all is laid out
        if scripts:
            self.run("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")

    def run(self, script):
        """Return the value of an expression in the page."""
        found = self.ask("Runtime.evaluate", expression=script, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in found, found
        return found["result"].get("value")

    def screenshot(self, path, *, whole=True):
        found = self.ask("Page.captureScreenshot", format="png", captureBeyondViewport=whole)
        path.write_bytes(base64.b64decode(found["data"]))


@contextmanager
def browser(folder):
    """Yield a tab of a browser that keeps what it writes in a folder."""
    to_read, to_write = os.pipe()
    from_read, from_write = os.pipe()

    def wire():
        # Chromium reads descriptor 3 and writes 4, which may be taken: moved out of the way first
        reading, writing = (fcntl.fcntl(fd, fcntl.F_DUPFD, 10) for fd in (to_read, from_write))
        os.dup2(reading, 3)
        os.dup2(writing, 4)

    process = subprocess.Popen(
        [CHROMIUM, "--headless=new", "--no-sandbox", "--disable-gpu", "--no-first-run", "--hide-scrollbars",
         "--disable-background-networking", "--disable-component-update", "--disable-sync",
         "--host-resolver-rules=MAP * ~NOTFOUND", f"--user-data-dir={folder / 'tab_profile'}",
         "--remote-debugging-pipe"],
        preexec_fn=wire,  # noqa: PLW1509 - no thread of ours runs yet
        close_fds=False, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
    )  # fmt: skip
    os.close(to_read)
    os.close(from_write)
    with os.fdopen(to_write, "wb") as wire_in, os.fdopen(from_read, "rb") as wire_out:
        try:
            yield Tab(wire_in, wire_out)
        finally:
            process.terminate()
            process.wait(timeout=20)
