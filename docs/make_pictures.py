"""Make the pictures of the pages with our own commands: `python docs/make_pictures.py` (nine minutes).

The moving one is `make_movie.py`'s. Then the demo is driven and recorded; its `map.png` and what a browser
shows of `hallway view --web` are kept. Needs chromium.
"""

import importlib.util
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import make_movie
from PIL import Image

ROOT = Path(__file__).parents[1]
PICTURES = ROOT / "docs" / "pictures"
DRIVE_S = 370
BAR_PX = 36
"""Height of the viewer's own bar, which is left out: it tells of this machine's graphics."""
PORT, PAGE_PORT = 19886, 19887
PATIENCE_S = 400.0


def hallway(*arguments: str) -> "subprocess.Popen[str]":
    """Start one of our commands."""
    command = [sys.executable, "-m", "runtime.cli", *arguments]
    return subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True)


def drive(folder: Path) -> None:
    """Let the demo drive its round, and record it from the first message on."""
    graph = folder / "demo.yaml"
    recorder = "  recorder: {module: recorder, required: false}\n"
    graph.write_text((ROOT / "launch" / "demo.yaml").read_text() + recorder)
    run = hallway("up", str(graph), "--headless", "--duration", str(DRIVE_S), "--out", str(folder / "run"))
    sys.stdout.write(run.communicate()[0].splitlines()[-1] + "\n")


def look(folder: Path, size: str) -> Image.Image:
    """Return what a browser shows of the recording."""
    spec = importlib.util.spec_from_file_location("browser", ROOT / "tests" / "integration" / "browser.py")
    browser = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(browser)
    recording = next((folder / "run").rglob("recording*.mcap"))
    view = hallway("view", str(recording), "--web", "--port", str(PORT), "--web-port", str(PAGE_PORT))
    try:
        view.stdout.readline()
        address = view.stdout.readline().strip()
        with browser.Browser(address, folder / "profile", size) as page:
            return settled(page)
    finally:
        view.send_signal(2)
        view.wait()


def settled(page: Any) -> Image.Image:
    """Return what a page shows when it has not changed for a while; without a graphics card that takes."""
    until = time.monotonic() + PATIENCE_S
    before, same = b"", 0
    while same < 5 and time.monotonic() < until:
        time.sleep(4.0)
        shot = page.screenshot()
        now = shot.crop((0, 40, shot.width, shot.height)).tobytes()
        same, before = (same + 1 if now == before else 0), now
    return shot


def main() -> None:
    """Make them all."""
    PICTURES.mkdir(exist_ok=True)
    make_movie.main()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        drive(folder)
        shutil.copy(folder / "run" / "map.png", PICTURES / "demo-map.png")
        seen = look(folder, "1360,880")
        few = seen.crop((0, BAR_PX, *seen.size)).quantize(96, dither=Image.Dither.NONE)
        few.save(PICTURES / "viewer.png", optimize=True)
    for picture in sorted(PICTURES.glob("*.png")):
        sys.stdout.write(f"{picture.relative_to(ROOT)}: {picture.stat().st_size / 1000:.0f} kB\n")


if __name__ == "__main__":
    main()
