"""Chromium without a screen, driven over a pair of pipes."""

import base64
import io
import itertools
import json
import os
import select
import shutil
import subprocess
import time

from PIL import Image

PROGRAM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")

_FLAGS = (
    "--headless=new",
    "--no-sandbox",
    "--no-first-run",
    "--disable-dev-shm-usage",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--hide-scrollbars",
    "--remote-debugging-pipe",
)


class Browser:
    """One page in a browser of its own."""

    def __init__(self, page, profile, size="1100,700"):
        hears, self._to = os.pipe()
        self._from, speaks = os.pipe()
        # The browser takes commands on descriptor 3 and answers on 4.
        shell = f'exec "$0" "$@" 3<&{hears} 4>&{speaks}'
        command = [
            "bash",
            "-c",
            shell,
            PROGRAM,
            *_FLAGS,
            f"--user-data-dir={profile}",
            f"--window-size={size}",
        ]
        self._process = subprocess.Popen(
            command,
            pass_fds=(hears, speaks),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )
        os.close(hears)
        os.close(speaks)
        self._numbers = itertools.count(1)
        self._buffer = b""
        target = self._ask("Target.createTarget", {"url": page})["targetId"]
        self._session = self._ask("Target.attachToTarget", {"targetId": target, "flatten": True})["sessionId"]

    def screenshot(self):
        """What the page looks like now."""
        answer = self._ask("Page.captureScreenshot", {"format": "png"}, self._session)
        return Image.open(io.BytesIO(base64.b64decode(answer["data"]))).convert("RGB")

    def close(self):
        """End it with everything it started."""
        os.killpg(self._process.pid, 9)
        self._process.wait()
        os.close(self._to)
        os.close(self._from)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.close()

    def _ask(self, method, parameters, session=None, within_s=60.0):
        number = next(self._numbers)
        question = {"id": number, "method": method, "params": parameters}
        if session is not None:
            question["sessionId"] = session
        os.write(self._to, json.dumps(question).encode() + b"\0")
        until = time.monotonic() + within_s
        while time.monotonic() < until:
            if not select.select([self._from], [], [], 0.2)[0]:
                continue
            self._buffer += os.read(self._from, 1 << 20)
            *whole, self._buffer = self._buffer.split(b"\0")
            for answer in map(json.loads, whole):
                if answer.get("id") == number:
                    assert "error" not in answer, answer["error"]
                    return answer["result"]
        raise AssertionError(f"the browser did not answer {method} within {within_s:g} s")
