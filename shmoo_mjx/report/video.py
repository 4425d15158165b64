"""The video of a run: an MP4 writer, a top-down view that needs no GL, and frames with caption and map."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import ExitStack
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from shmoo_mjx.arrays import Array
from shmoo_mjx.base.files import whole
from shmoo_mjx.geometry import se2
from shmoo_mjx.report import words
from shmoo_mjx.report.style import COLOURS, font, object_colour, outline, window
from shmoo_mjx.report.trace import Trace

if TYPE_CHECKING:
    from PIL import Image

_ROBOT_RADIUS = 0.19
"""Radius with which the robot's body is drawn [m]."""
SPEED = 3.0
"""Seconds of the run per second of video [1]. Larger is faster."""
_DARK = "#1f2430"
"""Colour around the picture."""
_OVERSAMPLE = 2
"""Oversampling factor of the top-down view, which smooths its edges [1]."""


class TopDown(NamedTuple):
    """Data shared by all frames of the top-down view."""

    result: dict[str, Any]
    """Content of ``result.json``."""
    trace: Trace
    """Trace of the run."""
    base: Image.Image
    """Oversampled picture of the map and the goal."""
    corner: np.ndarray
    """(x, y) of the picture's upper-left corner in {W} [m]."""
    scale: float
    """Oversampled pixels per metre."""
    size: tuple[int, int]
    """(width, height) of a final picture [pixels]."""

    def pixels(self, points: Array) -> list[tuple[float, float]]:
        """Oversampled picture coordinates of ``points [M, 2]`` in {W}."""
        flat = (np.asarray(points, dtype=float)[:, :2] - self.corner) * (self.scale, -self.scale)
        return [(float(x), float(y)) for x, y in flat]


def write_video(path: str | Path, frames: Iterable[np.ndarray], fps: float = 10.0) -> Path:
    """Write frames as an H.264 video (yuv420p), atomically.

    Frames of odd size lose their last row or column, because yuv420p needs even sizes.

    Args:
        path: the file to write.
        frames: images, uint8 ``[H, W, 3]``, all of one size.
        fps: frames per second.

    Returns:
        ``path``.

    Raises:
        ValueError: ``frames`` is empty.
    """
    import imageio.v2 as iio

    with ExitStack() as end:
        temporary, writer = end.enter_context(whole(path, ".mp4")), None
        for frame in frames:
            even = np.ascontiguousarray(frame[: frame.shape[0] // 2 * 2, : frame.shape[1] // 2 * 2, :3])
            if writer is None:
                writer = iio.get_writer(
                    temporary,
                    format="FFMPEG",  # type: ignore[arg-type]
                    fps=fps,
                    codec="libx264",
                    pixelformat="yuv420p",
                    quality=None,
                    macro_block_size=2,
                    output_params=["-crf", "24", "-preset", "veryfast", "-movflags", "+faststart"],
                )
                end.callback(writer.close)
            writer.append_data(even)
        if writer is None:
            raise ValueError("a film needs at least one frame")
    return Path(path)


def top_down(result: dict[str, Any], trace: Trace, size: tuple[int, int] = (640, 480)) -> TopDown:
    """The data for top-down pictures of a run with ``size`` = (width, height) [pixels]."""
    from PIL import Image, ImageDraw

    width, height = (n * _OVERSAMPLE for n in size)
    x0, x1, y0, y1 = window(result, trace)
    scale = min(width / (x1 - x0), height / (y1 - y0))
    corner = np.array([(x0 + x1) / 2 - width / scale / 2, (y0 + y1) / 2 + height / scale / 2])
    view = TopDown(
        result, trace, Image.fromarray(_map_pixels(trace, corner, scale, (width, height))), corner, scale, size
    )
    draw = ImageDraw.Draw(view.base)
    if result.get("goal") is not None and result.get("push_to") is None:
        _star(draw, view, np.asarray(result["goal"], dtype=float)[:2])
    if result.get("push_to") is not None:
        corners = outline(np.asarray(result["push_to"], dtype=float), result["objects"][0]["half_extents"])
        draw.polygon(view.pixels(corners), outline=COLOURS["goal"], width=max(2, round(0.035 * scale)))
    return view


def topdown_image(view: TopDown, t: float) -> np.ndarray:
    """Top-down picture at time ``t`` [s], uint8 ``[H, W, 3]``, with +x to the right and +y up."""
    from PIL import Image, ImageDraw

    trace, image = view.trace, view.base.copy()
    draw = ImageDraw.Draw(image)
    k = int(np.clip(np.searchsorted(trace.t, t, side="right") - 1, 0, len(trace.t) - 1))
    line = max(2, round(0.035 * view.scale))
    plans = np.flatnonzero(np.asarray(trace.plan_times, dtype=float) <= t + 1e-6)
    if len(plans) and len(trace.plans[plans[-1]]) > 1:
        draw.line(view.pixels(trace.plans[plans[-1]]), fill=COLOURS["plan"], width=line, joint="curve")
    if k > 0:
        draw.line(view.pixels(trace.robot_pose[: k + 1]), fill=COLOURS["rollout"], width=line, joint="curve")
    for number, item in enumerate(view.result["objects"]):
        if not np.isfinite(trace.object_pose[k, number]).all():
            continue  # not observed at that time
        now = {**item, "registered": words.registered_at(view.result, item["id"], t)}
        corners = view.pixels(outline(trace.object_pose[k, number], item["half_extents"]))
        draw.polygon(corners, fill=object_colour(now, number), outline="#333333", width=max(1, line // 2))
    past = [d for d in view.result["decisions"] if float(d["t"]) <= t + 1e-6]
    decision = past[-1] if past else None
    if decision is not None and decision.get("goal") is not None:
        (x, y), radius = view.pixels(np.array([decision["goal"]]))[0], 2.5 * line
        draw.ellipse([x - radius, y - radius, x + radius, y + radius], fill=COLOURS["decision"])
    _robot(draw, view, np.asarray(trace.robot_pose[k], dtype=float), line)
    return np.asarray(image.resize(view.size, Image.Resampling.BOX))


def fitting(result: dict[str, Any], trace: Trace, most: tuple[int, int]) -> tuple[int, int]:
    """The largest size (width, height) [pixels] within ``most`` that has the proportions of the run's window."""
    x0, x1, y0, y1 = window(result, trace)
    scale = min(most[0] / (x1 - x0), most[1] / (y1 - y0))
    return round(scale * (x1 - x0)), round(scale * (y1 - y0))


def topdown_frames(
    result: dict[str, Any], trace: Trace, *, fps: float = 10.0, speed: float = 1.0, size: tuple[int, int] = (800, 600)
) -> Iterator[np.ndarray]:
    """Top-down video frames with captions, for machines on which MuJoCo can't render.

    Args:
        result: content of ``result.json``.
        trace: trace of the run.
        fps: frames per second of video.
        speed: seconds of the run per second of video.
        size: (width, height) of the view without the caption [pixels].
    """
    view = top_down(result, trace, size)
    end = float(trace.t[-1])
    for t in np.arange(float(trace.t[0]), end + 0.5 * speed / fps, speed / fps):
        clock = f"{min(t, end):.0f} s   {speed:g}x speed"
        yield compose(topdown_image(view, float(t)), words.caption_at(result, float(min(t, end))), clock=clock)


def compose(
    frame: np.ndarray, caption: tuple[str, str] = ("", ""), inset: np.ndarray | None = None, *, clock: str = ""
) -> np.ndarray:
    """A frame of even size with a caption in a strip above.

    Caption and inset are above because the controls of a video player cover the lower edge.

    Args:
        frame: image, uint8 ``[H, W, 3]``.
        caption: headline and detail.
        inset: image for the upper right corner of the frame, uint8.
        clock: text at the right of the headline.
    """
    from PIL import Image

    height, width = frame.shape[:2]
    strip = _strip(caption, clock, height, width)
    canvas = Image.new("RGB", ((width + 1) // 2 * 2, (height + strip.height + 1) // 2 * 2), _DARK)
    canvas.paste(strip, (0, 0))
    canvas.paste(Image.fromarray(np.ascontiguousarray(frame[..., :3])), (0, strip.height))
    if inset is not None:
        edge = height // 60
        framed = np.pad(inset[..., :3], ((2, 2), (2, 2), (0, 0)), constant_values=31)
        corner = (width - framed.shape[1] - edge, strip.height + edge)
        canvas.paste(Image.fromarray(framed), corner)
    return np.asarray(canvas)


@lru_cache(maxsize=8)
def _strip(caption: tuple[str, str], clock: str, height: int, width: int) -> Image.Image:
    """The strip with the caption for a frame of this size."""
    from PIL import Image, ImageDraw

    rows = 1 if width >= 1000 else 2  # of the detail
    big, small = max(14, height // 26), max(11, height // 36)
    strip = Image.new("RGB", (width, round(1.85 * big + 1.8 * small + 1.35 * small * (rows - 1))), _DARK)
    draw, left = ImageDraw.Draw(strip), big // 2
    draw.text((left, 0.35 * big), caption[0], fill="white", font=font(big, bold=True))
    right = width - left - font(small).getlength(clock)
    draw.text((right, 0.35 * big + 0.6 * (big - small)), clock, fill="#c5cad6", font=font(small))
    for row, line in enumerate(_lines(caption[1], font(small), width - 2 * left, most=rows)):
        draw.text((left, 1.85 * big + 1.35 * row * small), line, fill="#c5cad6", font=font(small))
    return strip


def _map_pixels(trace: Trace, corner: np.ndarray, scale: float, size: tuple[int, int]) -> np.ndarray:
    """Picture of the map, uint8 ``[H, W, 3]``. Pixels outside the map have the colour of unknown cells."""
    from matplotlib.colors import to_rgb

    cells = np.asarray(trace.map_cells)
    cols, rows = np.meshgrid(np.arange(size[0]) + 0.5, np.arange(size[1]) + 0.5)
    points = corner + np.stack([cols, -rows], axis=-1) / scale
    local = se2.inverse_transform_point(np.asarray(trace.map_origin, dtype=float), points) / trace.map_resolution
    i, j = np.floor(local[..., 0]).astype(int), np.floor(local[..., 1]).astype(int)
    inside = (i >= 0) & (j >= 0) & (i < cells.shape[1]) & (j < cells.shape[0])
    value = np.where(inside, cells[np.where(inside, j, 0), np.where(inside, i, 0)], -1)
    kind = np.where(value >= 65, 2, np.where(value == 0, 0, 1))
    palette = np.array([to_rgb(COLOURS[name]) for name in ("free", "unknown", "wall")])
    return (palette * 255).round().astype(np.uint8)[kind]


def _robot(draw: Any, view: TopDown, pose: np.ndarray, line: int) -> None:
    (x, y), tip = view.pixels(np.stack([pose[:2], se2.transform_point(pose, np.array([0.45, 0.0]))]))
    radius = _ROBOT_RADIUS * view.scale
    draw.line([(x, y), tip], fill=COLOURS["robot"], width=line)
    draw.ellipse([x - radius, y - radius, x + radius, y + radius], fill=COLOURS["robot"], outline="white", width=line)


def _star(draw: Any, view: TopDown, point: np.ndarray) -> None:
    angles = np.pi / 2 + np.arange(10) * np.pi / 5
    radii = np.where(np.arange(10) % 2 == 0, 0.28, 0.12)
    corners = point + radii[:, None] * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    draw.polygon(view.pixels(corners), fill=COLOURS["goal"])


def _lines(text: str, font: Any, width: float, most: int = 2) -> list[str]:
    """``text`` wrapped at words into at most ``most`` lines of ``width`` pixels. Further text is cut off."""
    lines: list[str] = []
    words = text.split()
    while words and len(lines) < most:
        count = max((n for n in range(1, len(words) + 1) if font.getlength(" ".join(words[:n])) <= width), default=1)
        lines.append(" ".join(words[:count]))
        words = words[count:]
    if words:
        while lines[-1] and font.getlength(lines[-1] + "...") > width:
            lines[-1] = lines[-1][:-1]
        lines[-1] += "..."
    return lines
