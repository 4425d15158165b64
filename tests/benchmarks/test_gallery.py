"""The pictures of the gallery: a film becomes a moving picture, and the page shows each with its command."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image

from benchmarks.gallery import PICTURES, animation
from shmoo_mjx.report.video import write_video

PAGE = Path(__file__).parents[2] / "docs" / "gallery.md"


def test_a_film_becomes_a_moving_picture(tmp_path: Path) -> None:
    frames = (np.full((48, 64, 3), 12 * k, np.uint8) for k in range(20))
    write_video(tmp_path / "film.mp4", frames, 30.0)
    animation("film.mp4", width=32, every=5, fps=10.0)(tmp_path, tmp_path / "film.webp")
    with Image.open(tmp_path / "film.webp") as picture:
        assert picture.size == (32, 24) and picture.n_frames == 4  # type: ignore[attr-defined]
        picture.seek(3)
        assert abs(np.asarray(picture.convert("RGB")).mean() - 12 * 15) < 12


def test_the_page_shows_each_picture_after_its_command() -> None:
    page = PAGE.read_text(encoding="utf-8")
    for name, picture in PICTURES.items():
        before = page.partition(f"](figures/{name})")[0].rpartition("](figures/")[2]
        words = picture.command.replace(" --out OUT", "").split()
        assert f"`shmoo {words[0]} " in before or f"`shmoo {words[0]}`" in before, name
