"""Measures the live page: samples, pictures sent and pictures drawn per second, by number of browsers.

Run: python -m benchmarks.live_rate --seconds 40 --picture page.png (needs Chromium with its chromedriver)
"""

from __future__ import annotations

import argparse
import shutil
import tempfile
import time
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from selenium import webdriver

from shmoo_mjx.base.environment import prepare_environment
from shmoo_mjx.types import DT

_COUNT = "window.drawn = 0; (function draw() { window.drawn++; requestAnimationFrame(draw); })()"
"""Script that counts the pictures that a browser draws."""


def browser() -> Any:
    """A headless Chromium that draws in software, as on a machine without a graphics card."""
    options = webdriver.ChromeOptions()
    options.binary_location = str(shutil.which("chromium"))
    for argument in ("--headless=new", "--no-sandbox", "--window-size=1280,800", "--use-angle=swiftshader"):
        options.add_argument(argument)
    return webdriver.Chrome(options=options, service=webdriver.ChromeService(shutil.which("chromedriver")))


def measure(scene: str, seconds: float, clients: int, picture: Path | None) -> str:
    """The row of the table for ``clients`` browsers that watch the page.

    Args:
        scene: name of the scene.
        seconds: duration of the measurement [s].
        clients: number of browsers.
        picture: file for a picture of the page, or None.
    """
    from shmoo_mjx.learning.weights import load_weights
    from shmoo_mjx.live.command import go_on
    from shmoo_mjx.live.page import Page
    from shmoo_mjx.live.scenes import scene_named
    from shmoo_mjx.live.session import Session

    with tempfile.TemporaryDirectory() as out:
        session = Session(load_weights(), partial(scene_named, scene, Path(out)), "real", Path(out))
        session.compile()
        with closing(session), closing(Page(session, port=8100, scene=scene)) as page:
            watching = [browser() for _ in range(clients)]
            try:
                for one in watching:
                    one.get(page.url)
                go_on(page, 15.0)  # until the page has loaded
                for one in watching:
                    one.execute_script(_COUNT)
                began, late = time.perf_counter(), session.late
                pictures, simulated = page.pictures.count, session.simulation.time
                go_on(page, seconds)
                passed = time.perf_counter() - began
                drawn = [one.execute_script("return window.drawn") / passed for one in watching]
                if watching and picture is not None:
                    watching[0].save_screenshot(str(picture))
            finally:
                for one in watching:
                    one.quit()
            rates = (session.simulation.time - simulated) / DT / passed, (page.pictures.count - pictures) / passed
            step = 1e3 * np.median(session.spent)
            seen = ", ".join(f"{rate:.0f}" for rate in drawn)
            return f"| {clients} | {rates[0]:.1f} | {rates[1]:.1f} | {seen} | {step:.0f} | {session.late - late} |"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scene", default="demo 3")
    parser.add_argument("--seconds", type=float, default=40.0)
    parser.add_argument("--clients", type=int, nargs="+", default=[0, 1, 2])
    parser.add_argument("--picture", type=Path, help="file for a picture of the page")
    args = parser.parse_args()
    prepare_environment()
    print("| browsers | samples/s | sent/s | drawn/s | control step, median [ms] | steps over 100 ms |")
    print("|---|---|---|---|---|---|")
    for clients in args.clients:
        print(measure(args.scene, args.seconds, clients, args.picture), flush=True)


if __name__ == "__main__":
    main()
