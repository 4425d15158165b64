"""Films: the file can be read back, and the view from above puts things where they are."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import imageio.v2 as iio
import numpy as np
import pytest
from matplotlib.colors import to_rgb

from shmoo_mjx.report import style, video
from shmoo_mjx.report.style import COLOURS
from shmoo_mjx.report.trace import Trace


def colour_at(view: video.TopDown, image: np.ndarray, point: tuple[float, float]) -> np.ndarray:
    x, y = np.array(view.pixels(np.array([point]))[0]) / 2
    return image[int(y), int(x)] / 255


def test_film_is_h264_and_keeps_the_pictures(tmp_path: Path) -> None:
    frames = [np.full((49, 65, 3), (20 * k, 40, 200 - 20 * k), dtype=np.uint8) for k in range(8)]
    path = video.write_video(tmp_path / "episode.mp4", iter(frames), fps=4)
    reader = iio.get_reader(path)
    meta = reader.get_meta_data()
    assert meta["codec"] == "h264" and meta["size"] == (64, 48) and meta["fps"] == 4
    assert "yuv420p" in meta["pix_fmt"]
    back = [np.asarray(frame) for frame in reader.iter_data()]
    assert len(back) == 8
    np.testing.assert_allclose(back[5].mean(axis=(0, 1)), [100, 40, 100], atol=12)
    assert [p.name for p in tmp_path.iterdir()] == ["episode.mp4"]


def test_interrupted_film_leaves_nothing(tmp_path: Path) -> None:
    def breaks() -> Iterator[np.ndarray]:
        yield np.zeros((48, 64, 3), dtype=np.uint8)
        raise RuntimeError("renderer lost")

    with pytest.raises(RuntimeError, match="renderer lost"):
        video.write_video(tmp_path / "episode.mp4", breaks())
    with pytest.raises(ValueError, match="frame"):
        video.write_video(tmp_path / "episode.mp4", [])
    assert not list(tmp_path.iterdir())


def test_view_from_above_shows_each_thing_in_its_place(trace: Trace, result: dict[str, Any]) -> None:
    view = video.top_down(result, trace, (400, 300))
    early, late = video.topdown_image(view, 0.0), video.topdown_image(view, 39.9)
    assert early.shape == (300, 400, 3) and early.dtype == np.uint8
    box, wall = to_rgb("#E69F00"), to_rgb(COLOURS["wall"])
    np.testing.assert_allclose(colour_at(view, early, (3.2, 1.5)), box, atol=0.05)
    np.testing.assert_allclose(colour_at(view, late, (4.3, 1.4)), box, atol=0.05)
    np.testing.assert_allclose(colour_at(view, early, (3.0, 2.65)), wall, atol=0.05)
    np.testing.assert_allclose(colour_at(view, early, (1.0, 1.2)), to_rgb(COLOURS["robot"]), atol=0.05)
    assert np.abs(colour_at(view, late, (1.0, 1.2)) - to_rgb(COLOURS["robot"])).max() > 0.2
    # The wheelchair turns red only when the decision has been taken.
    np.testing.assert_allclose(colour_at(view, late, (5.8, 3.4)), to_rgb(COLOURS["registered"]), atol=0.05)
    assert np.abs(colour_at(view, early, (5.8, 3.4)) - to_rgb(COLOURS["registered"])).max() > 0.2


def test_turned_map_is_drawn_turned(trace: Trace, result: dict[str, Any]) -> None:
    turned = trace._replace(map_origin=np.array([8.0, 6.0, np.pi]))
    view = video.top_down(result, turned, (400, 300))
    image = video.topdown_image(view, 0.0)
    # The wall at (4.5, 2.65) of the map's own frame lies at (3.5, 3.35) in {W}.
    np.testing.assert_allclose(colour_at(view, image, (3.5, 3.35)), to_rgb(COLOURS["wall"]), atol=0.05)
    np.testing.assert_allclose(colour_at(view, image, (2.5, 2.65)), to_rgb(COLOURS["free"]), atol=0.05)


def test_composed_frame_holds_scene_inset_and_caption(trace: Trace, result: dict[str, Any]) -> None:
    frame = np.full((241, 321, 3), 90, dtype=np.uint8)
    view = video.topdown_image(video.top_down(result, trace, video.fitting(result, trace, (100, 90))), 15.0)
    out = video.compose(frame, ("pushes the box", "it moves"), view, clock="15 s")
    assert out.shape[0] % 2 == 0 and out.shape[1] % 2 == 0
    assert out.shape[1] == 322 and out.shape[0] > 241
    # The caption is above: a player's controls lie over the lower edge.
    strip = next(n for n in range(out.shape[0] - 240) if (out[n : n + 241, :200] == 90).all())
    assert (out[:strip, :200] > 200).any() and (out[:strip, 280:] > 150).any()  # letters
    # The map keeps its proportions and lies in the upper right corner.
    height, width = view.shape[:2]
    assert 100 in (width, round(100 * width / 90)) and abs(height / width - 6.2 / 8.2) < 0.02
    found = [
        (i, j)
        for i in range(strip, strip + 50)
        for j in range(200, 322 - width)
        if (out[i : i + height, j : j + width] == view).all()
    ]
    assert len(found) == 1


def test_long_captions_break_between_words() -> None:
    font = style.font(14)
    text = "object 1 blocks the path 2.16 m ahead and the way round is 3.53 m longer " * 3
    lines = video._lines(text, font, 300)
    assert len(lines) == 2 and lines[1].endswith("...") and text.startswith(lines[0] + " ")
    assert max(font.getlength(line) for line in lines) <= 300
    assert video._lines("short", font, 300) == ["short"] and video._lines("", font, 300) == []


def test_fallback_film_covers_the_run(trace: Trace, result: dict[str, Any]) -> None:
    frames = list(video.topdown_frames(result, trace, fps=2, speed=8.0, size=(160, 120)))
    assert len(frames) == 11  # 39.9 s at 4 s per frame
    assert len({f.shape for f in frames}) == 1
    assert np.abs(frames[0].astype(int) - frames[-1]).max() > 100
