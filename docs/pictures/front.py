"""Draws the pictures of the front from the demo: a film of the patrol, and the page beside its record.

python docs/pictures/front.py [FOLDER]; it needs `mdm[demo,page,record]`, Pillow, Playwright and Chromium.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from PIL import Image
from playwright.sync_api import sync_playwright

HERE = Path(__file__).parent
PATROL = HERE.parent.parent / "examples" / "patrol"
PIXELS = "400"
"""The longer side of the film's pictures: its words are read at that size, and not where it is made smaller."""

MOMENT = 760, 187
"""The place on the timeline, in pixels, of the moment that the page shows."""


def film(folder: Path) -> None:
    """Draw the patrol as an animated picture, narrow enough for a page of text."""
    drawn = folder / "demo.gif"
    command = [sys.executable, PATROL / "patrol.py", "--fast", "--pixels", PIXELS, "--film", drawn]
    subprocess.run(command, check=True, stdout=sys.stderr)
    with Image.open(drawn) as whole:
        pictures = []
        for number in range(whole.n_frames):
            whole.seek(number)
            pictures.append(whole.convert("RGB").quantize(64, dither=Image.Dither.NONE))
        pause = whole.info["duration"]
    pictures[0].save(drawn, save_all=True, append_images=pictures[1:], duration=pause // 2, loop=0, optimize=True)


def page(folder: Path) -> None:
    """Draw the page beside a record of the patrol."""
    with tempfile.TemporaryDirectory() as kept:
        record = Path(kept) / "patrol.mcap"
        command = [sys.executable, "-m", "mdm"]
        options = ["--virtual", "--seconds", "40", "--quiet", "--record", record]
        subprocess.run([*command, "run", PATROL / "patrol.toml", *options], check=True)
        serving = subprocess.Popen([*command, "page", record, "--port", "0"], stderr=subprocess.PIPE, text=True)
        try:
            assert serving.stderr is not None
            address = serving.stderr.readline().split()[-1]
            with sync_playwright() as playwright:
                browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=["--no-sandbox"])
                sheet = browser.new_page(viewport={"width": 1300, "height": 900}, color_scheme="light")
                sheet.goto(address, wait_until="commit")  # it goes on loading: pictures come as a stream
                sheet.get_by_text("TIMELINE").wait_for()
                sheet.wait_for_timeout(3000)
                sheet.mouse.click(*MOMENT)
                sheet.wait_for_timeout(3000)
                sheet.screenshot(path=folder / "page.png")
                browser.close()
        finally:
            serving.terminate()
            serving.wait()


if __name__ == "__main__":
    target = Path(sys.argv[1]) if len(sys.argv) > 1 else HERE
    film(target)
    page(target)
