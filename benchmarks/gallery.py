"""Makes pictures of the gallery with commands of ``shmoo``: python -m benchmarks.gallery [PICTURE ...].

The command of each picture runs in a temporary folder, and the picture is written to docs/figures. Films become
animated WebP pictures, because pages such as the README play no films.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from collections.abc import Callable
from contextlib import closing
from itertools import islice
from pathlib import Path
from typing import NamedTuple

import imageio.v2 as iio
import numpy as np
from PIL import Image

from shmoo_mjx.report.figures import map_figure
from shmoo_mjx.report.style import save_figure
from shmoo_mjx.report.trace import load_result, load_trace

FIGURES = Path("docs/figures")


class Picture(NamedTuple):
    """Command and drawing function of a picture."""

    command: str
    """Command. OUT stands for the folder or file that it writes."""
    draw: Callable[[Path, Path], None]
    """Makes the picture (second path) from the output of the command (first path)."""


def animation(film: str, *, width: int, every: int, fps: float) -> Callable[[Path, Path], None]:
    """A function that makes an animated WebP from a film.

    Args:
        film: file below the command's folder.
        width: width of the picture [pixels].
        every: stride over the film's frames.
        fps: pictures per second.
    """

    def draw(out: Path, picture: Path) -> None:
        frames = []
        with closing(iio.get_reader(out / film)) as reader:
            for frame in islice(reader.iter_data(), 0, None, every):
                image = Image.fromarray(np.asarray(frame))
                size = (width, round(width * image.height / image.width))
                frames.append(image.resize(size, Image.Resampling.LANCZOS))
        # The last picture stays for 2 s, so that a reader sees the end.
        duration = [round(1000 / fps)] * (len(frames) - 1) + [2000]
        frames[0].save(
            picture, save_all=True, append_images=frames[1:], duration=duration, loop=0, quality=40, method=2
        )

    return draw


def report_map(out: Path, picture: Path) -> None:
    """Draw the map of the demo's report."""
    run = out / "demo-0"
    save_figure(picture, map_figure(load_result(run / "result.json"), load_trace(run / "trace.npz")))


def copied(out: Path, picture: Path) -> None:
    """Copy the picture that the command has drawn."""
    picture.write_bytes(out.read_bytes())


PICTURES = {
    "demo.webp": Picture("demo --seed 0 --out OUT", animation("demo-0/episode.mp4", width=800, every=4, fps=10.0)),
    "push.webp": Picture(
        "push wheelchair --goal 1.5,0,0.3 --set mass=20 --out OUT",
        animation("episode.mp4", width=640, every=6, fps=8.0),
    ),
    "view.webp": Picture(
        "view cart --seed 3 --no-window --out OUT", animation("view.mp4", width=480, every=4, fps=8.0)
    ),
    "report_map.png": Picture("demo --seed 0 --no-video --out OUT", report_map),
    "map_show.png": Picture("map show experiments/maps/office.yaml --out OUT", copied),
}


def main(names: list[str]) -> None:
    """Make the pictures with these names, or all pictures."""
    for name in names or PICTURES:
        command, draw = PICTURES[name]
        with tempfile.TemporaryDirectory() as folder:
            out = Path(folder) / ("out.png" if draw is copied else "out")
            words = [str(out) if word == "OUT" else word for word in command.split()]
            subprocess.run([Path(sys.executable).with_name("shmoo"), *words], check=True)
            draw(out, FIGURES / name)
        print(f"{FIGURES / name}: {(FIGURES / name).stat().st_size / 1e3:.0f} kB")


if __name__ == "__main__":
    main(sys.argv[1:])
