"""Saves a picture of the live page during the first push, as a browser shows it.

Run: python -m benchmarks.live_picture docs/figures/live.webp (needs Chromium with its chromedriver)
"""

from __future__ import annotations

import argparse
import io
import tempfile
import threading
import time
from collections.abc import Callable
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import Any

from PIL import Image
from selenium.common.exceptions import TimeoutException
from selenium.webdriver.common.by import By

from benchmarks.live_rate import browser
from shmoo_mjx.base.environment import prepare_environment

_LOADING = 15.0
"""Time until the browser shows the page [s]."""
_DRAWING = 6.0
"""Time for the browser to draw the last frame [s]."""
_LONGEST = 300.0
"""Limit of the wall-clock time until the push [s]."""


def picture(scene: str, size: tuple[int, int], *, tab: str, view: str, pushed: float) -> Image.Image:
    """The page after ``pushed`` seconds of the first push.

    Args:
        scene: name of the scene.
        size: width and height of the window [pixels].
        tab: tab of the panel to open.
        view: camera, one of `cameras.VIEWS`.
        pushed: duration of the push [s].
    """
    from shmoo_mjx.learning.weights import load_weights
    from shmoo_mjx.live.command import go_on
    from shmoo_mjx.live.page import Page
    from shmoo_mjx.live.scenes import scene_named
    from shmoo_mjx.live.session import Session

    with tempfile.TemporaryDirectory() as out:
        session = Session(load_weights(), partial(scene_named, scene, Path(out)), "real", Path(out))
        session.compile()
        with closing(session), closing(Page(session, port=8120, scene=scene)) as page, closing(_Window(size)) as window:
            page.paused = True
            page.panel.view.value, page.speed = view, 0.0
            runner = threading.Thread(target=go_on, args=(page, _LONGEST), daemon=True)
            runner.start()
            window.chrome.get(page.url)
            time.sleep(_LOADING)
            _wait(lambda: window.opened(tab))
            page.paused = False
            _wait(lambda: _pushed_for(session) >= pushed)
            page.paused = True
            time.sleep(2.0)
            # Stop new frames, because a browser that draws in software is too busy for a screenshot.
            page.pictures.close()
            runner.join()
            time.sleep(_DRAWING)
            return window.screenshot()


class _Window:
    """A browser whose page has exactly the given size, also below the smallest window of Chromium."""

    def __init__(self, size: tuple[int, int]) -> None:
        self.chrome: Any = browser()
        metrics = {"width": size[0], "height": size[1], "deviceScaleFactor": 1, "mobile": size[0] < 600}
        self.chrome.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", metrics)

    def opened(self, tab: str) -> bool:
        """Close the notice about software rendering and open the tab, if it is there already."""
        for button in self.chrome.find_elements(By.XPATH, "//*[contains(@class, 'Notification-closeButton')]"):
            self.chrome.execute_script("arguments[0].click()", button)
        # A script's click does not open a tab. On a phone, a tab is only its text.
        found = self.chrome.find_elements(By.XPATH, f"//*[@role='tab'][@title='{tab}'] | //*[text()='{tab}']")
        for element in found[:1]:
            element.click()
        return bool(found)

    def screenshot(self, tries: int = 5) -> Image.Image:
        """The page as the browser shows it."""
        for left in reversed(range(tries)):
            try:
                return Image.open(io.BytesIO(self.chrome.get_screenshot_as_png())).convert("RGB")
            except TimeoutException:
                if not left:
                    raise
        raise AssertionError

    def close(self) -> None:
        """End the browser."""
        self.chrome.quit()


def _pushed_for(session: Any) -> float:
    """Contact time of the current push [s]; 0 without one."""
    segment = session.simulation.navigator.segment
    return 0.0 if segment is None or segment.push is None else float(segment.push.contact_time)


def _wait(done: Callable[[], bool]) -> None:
    until = time.monotonic() + _LONGEST
    while not done():
        if time.monotonic() > until:
            raise RuntimeError(f"there was no such push within {_LONGEST:g} s")
        time.sleep(0.05)


def main() -> None:
    """Write the picture."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("file", type=Path)
    parser.add_argument("--scene", default="demo 0")
    parser.add_argument("--size", type=int, nargs=2, default=(1280, 800))
    parser.add_argument("--tab", default="Run", help="tab of the panel: Run, World, MPPI, View or Files")
    parser.add_argument("--view", default="follow the robot")
    parser.add_argument("--pushed", type=float, default=3.0, help="duration of the push [s]")
    args = parser.parse_args()
    prepare_environment()
    size = (args.size[0], args.size[1])
    picture(args.scene, size, tab=args.tab, view=args.view, pushed=args.pushed).save(args.file, quality=90)


if __name__ == "__main__":
    main()
