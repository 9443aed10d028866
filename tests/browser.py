"""Drives headless Chromium through its DevTools protocol."""

import base64
import json
import subprocess
import time
import urllib.request
from pathlib import Path

import websocket

KEYS = {"Tab": 9, "Enter": 13, "ArrowRight": 39}


class Browser:
    """Chromium with a profile of its own and one tab; ended with the block."""

    def __init__(self, program, profile):
        self.process = subprocess.Popen(
            [
                program,
                "--headless=new",
                "--no-sandbox",
                "--disable-gpu",
                "--disable-dev-shm-usage",
                "--hide-scrollbars",
                "--no-first-run",
                "--disable-background-networking",
                "--disable-component-update",
                "--disable-sync",
                "--remote-debugging-port=0",
                f"--user-data-dir={profile}",
                "about:blank",
            ],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        port_file = Path(profile) / "DevToolsActivePort"
        wait(lambda: port_file.exists() and port_file.read_text().count("\n"), 30, "Chromium's port")
        port = port_file.read_text().split()[0]
        with urllib.request.urlopen(f"http://127.0.0.1:{port}/json/list", timeout=10) as answer:
            tab = next(tab for tab in json.load(answer) if tab["type"] == "page")
        self.socket = websocket.create_connection(tab["webSocketDebuggerUrl"], timeout=30, suppress_origin=True)
        self.count, self.complaints = 0, []
        for domain in ("Page", "Runtime", "Log", "Accessibility"):
            self.call(f"{domain}.enable")

    def call(self, method, **parameters):
        """One command of the protocol, and its result; meanwhile keeps what the page complains of."""
        self.count += 1
        self.socket.send(json.dumps({"id": self.count, "method": method, "params": parameters}))
        while True:
            message = json.loads(self.socket.recv())
            if message.get("id") == self.count:
                if "error" in message:
                    raise RuntimeError(f"{method}: {message['error']}")
                return message["result"]
            self._hear(message)

    def _hear(self, message):
        parameters = message.get("params", {})
        if message.get("method") == "Runtime.exceptionThrown":
            details = parameters["exceptionDetails"]
            self.complaints.append(details.get("exception", {}).get("description", details["text"]))
        elif message.get("method") == "Log.entryAdded" and parameters["entry"]["level"] == "error":
            self.complaints.append(f"{parameters['entry']['text']} {parameters['entry'].get('url', '')}")

    def value(self, expression):
        """What an expression of the page's script gives."""
        result = self.call("Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True)
        if "exceptionDetails" in result:
            raise RuntimeError(f"{expression}: {result['exceptionDetails']['exception']['description']}")
        return result["result"].get("value")

    def text(self, selector):
        return self.value(f"document.querySelector({json.dumps(selector)})?.textContent ?? null")

    def wait(self, expression, seconds=10):
        """Whether it becomes true in time."""
        end = time.monotonic() + seconds
        while not self.value(expression):
            if time.monotonic() > end:
                return False
            time.sleep(0.1)
        return True

    def show(self, width, height, scheme):
        """The size of the screen, and whether the person at it likes it dark."""
        self.shown = width, height, scheme
        self.call(
            "Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=width < 600
        )
        self.call("Emulation.setEmulatedMedia", features=[{"name": "prefers-color-scheme", "value": scheme}])

    def focus(self, selector):
        self.value(f"document.querySelector({json.dumps(selector)}).focus()")

    def type(self, selector, text):
        """Puts a text in place of what a field holds."""
        self.value(f"(field => {{ field.focus(); field.select(); }})(document.querySelector({json.dumps(selector)}))")
        self.call("Input.insertText", text=text)

    def choose(self, selector, value):
        """Chooses of a list, as a choice of the user does."""
        self.value(
            f"(list => {{ list.value = {json.dumps(value)}; "
            "list.dispatchEvent(new Event('change', { bubbles: true })); "
            f"}})(document.querySelector({json.dumps(selector)}))"
        )

    def key(self, name):
        text = {"text": "\r"} if name == "Enter" else {}
        for kind in ("keyDown", "keyUp"):
            self.call(
                "Input.dispatchKeyEvent",
                type=kind,
                key=name,
                code=name,
                windowsVirtualKeyCode=KEYS[name],
                **(text if kind == "keyDown" else {}),
            )

    def screenshot(self, path):
        """The whole page, however long, on a screen as long as it is."""
        size = self.call("Page.getLayoutMetrics")["cssContentSize"]
        shown = self.shown
        self.show(shown[0], int(size["height"]), shown[2])
        time.sleep(0.7)
        Path(path).write_bytes(base64.b64decode(self.call("Page.captureScreenshot")["data"]))
        self.show(*shown)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.socket.close()
        self.process.terminate()
        try:
            self.process.wait(10)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()


def wait(done, seconds, what):
    """Waits until `done` is true; raises when it is not in time."""
    end = time.monotonic() + seconds
    while not done():
        if time.monotonic() > end:
            raise RuntimeError(f"no {what} within {seconds} s")
        time.sleep(0.05)
