"""A film as a small moving picture for pages that play no films: python -m benchmarks.animation FILM PICTURE."""

from __future__ import annotations

import sys
from itertools import islice

import imageio.v3 as iio
import numpy as np
from PIL import Image

WIDTH, EVERY, FPS = 640, 6, 10.0
"""Of the picture [pixels]; one of so many frames is kept; pictures per second."""


def main(film: str, picture: str) -> None:
    """An animated WebP of an MP4."""
    frames = []
    for frame in islice(iio.imiter(film, plugin="FFMPEG"), 0, None, EVERY):
        image = Image.fromarray(np.asarray(frame))
        frames.append(image.resize((WIDTH, round(WIDTH * image.height / image.width))))
    frames[0].save(
        picture, save_all=True, append_images=frames[1:], duration=round(1000 / FPS), loop=0, quality=45, method=6,
        minimize_size=True,
    )  # fmt: skip


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2])
