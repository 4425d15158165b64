"""A film as a small moving picture for pages that play no films: python -m shmoo_mjx.report.animation FILM PICTURE."""

from __future__ import annotations

import io
import sys
from itertools import islice
from pathlib import Path

import numpy as np

from shmoo_mjx.files import write_whole

__all__ = ["animate"]


def animate(film: str | Path, picture: str | Path, width: int = 640, every: int = 6, fps: float = 10.0) -> Path:
    """Write an animated WebP of every so many frames of an MP4.

    Args:
        film: as `video.write_video` writes it.
        picture: file to write.
        width: of the picture [pixels].
        every: one of so many frames is kept.
        fps: pictures per second.
    """
    import imageio.v3 as iio
    from PIL import Image

    frames = []
    for frame in islice(iio.imiter(film, plugin="FFMPEG"), 0, None, every):
        image = Image.fromarray(np.asarray(frame))
        frames.append(image.resize((width, round(width * image.height / image.width))))
    if not frames:
        raise ValueError(f"{film} has no frames")
    content = io.BytesIO()
    frames[0].save(
        content,
        "WEBP",
        save_all=True,
        append_images=frames[1:],
        duration=round(1000 / fps),
        loop=0,
        quality=45,
        method=6,
        minimize_size=True,
    )
    return write_whole(picture, content.getvalue())


if __name__ == "__main__":
    animate(sys.argv[1], sys.argv[2])
