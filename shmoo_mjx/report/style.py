"""Colours, geometry and files that figures and films share."""

from __future__ import annotations

import io
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from shmoo_mjx.arrays import Array, Numbers
from shmoo_mjx.base.files import write_whole
from shmoo_mjx.geometry import se2
from shmoo_mjx.report.trace import Trace

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Okabe and Ito's palette, told apart with any colour vision.
SERIES = ("#0072B2", "#E69F00", "#009E73", "#CC79A7", "#56B4E9", "#D55E00", "#7A6A00", "#555555")
COLOURS = {
    "free": "#FFFFFF",
    "unknown": "#E4E6EA",
    "wall": "#3A3F4A",
    "plan": "#009E73",
    "robot": "#0072B2",
    "goal": "#009E73",
    "decision": "#D55E00",
    "contact": "#555555",
    "rollout": "#56B4E9",
    "candidate": "#0072B2",
    "object": "#E69F00",
    "registered": "#D55E00",
}
_FAMILIES = {"box": "#E69F00", "cart": "#CC79A7", "wheelchair": "#8E5BB5"}
_OTHER_SCRIPTS = (
    "Noto Sans CJK JP", "Noto Sans CJK SC", "Source Han Sans", "WenQuanYi Zen Hei", "Droid Sans Fallback",
    "Microsoft YaHei", "Yu Gothic", "Malgun Gothic", "PingFang SC", "Hiragino Sans", "Arial Unicode MS",
)  # fmt: skip
"""Fonts that have characters which matplotlib's own lacks, in the order in which they are tried."""
_RIM = 0.1
"""What is shown beyond a map's end [m]."""
_SIGNS = np.array([[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]])


def blank_figure(width: float, height: float) -> Figure:
    """An empty figure [inches], apart from pyplot and whatever display it would look for."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), layout="constrained")


def to_png(figure: Figure, dpi: int = 110) -> bytes:
    """The figure as a PNG file. All text is drawn as it is: a name may hold a "$" or characters of any script."""
    _take_literally(figure)
    buffer = io.BytesIO()
    with warnings.catch_warnings():
        # No font of this machine has the character: a box stands in its place.
        warnings.filterwarnings("ignore", r"Glyph \d+ .* missing from", UserWarning)
        figure.savefig(buffer, format="png", dpi=dpi, facecolor="white")
    return buffer.getvalue()


def _take_literally(figure: Figure) -> None:
    from matplotlib import font_manager
    from matplotlib.text import Text
    from matplotlib.ticker import LogFormatter

    axes = [axis for part in figure.axes for axis in (part.xaxis, part.yaxis)]
    powers = [axis for axis in axes if isinstance(axis.get_major_formatter(), LogFormatter)]
    mathematics = {label for axis in powers for label in axis.get_ticklabels(which="both")}
    installed = set(font_manager.get_font_names())
    families = ["DejaVu Sans", *(name for name in _OTHER_SCRIPTS if name in installed)]
    for text in figure.findobj(Text):
        if text not in mathematics:
            text.set_parse_math(False)
            text.set_fontfamily(families)


def save_figure(path: Path, figure: Figure, dpi: int = 110) -> Path:
    """Write the figure as PNG, whole or not at all; missing folders are made."""
    return write_whole(path, to_png(figure, dpi))


def legend_above(figure: Figure, columns: int = 4) -> None:
    """A legend of all panels above them."""
    figure.legend(loc="outside upper center", ncols=columns, fontsize=8, frameon=False)


def beside(group: Any, k: int, count: int) -> Any:
    """Place of bar ``k`` of ``count`` on an axis with a group of bars at each whole number; they take up 0.8 of it."""
    return group + (k - (count - 1) / 2) * 0.8 / count


def draw_reliability(
    axes: Axes, probability: Array, truth: Array, *, colour: str, label: str, marker: str = "o"
) -> None:
    """How often what is predicted with ``probability [N]`` comes true (``truth [N]``), with counts, in five bins."""
    place = np.minimum((probability * 5).astype(int), 4)
    parts = [place == b for b in np.unique(place)]
    predicted, came = ([np.mean(values[part]) for part in parts] for values in (probability, truth))
    axes.plot((0, 1), (0, 1), color="black", lw=1.0, ls="--")
    axes.plot(predicted, came, marker, color=colour, ms=6, label=label, ls="-", lw=0.8)
    for x, y, part in zip(predicted, came, parts, strict=True):
        place_of_text = {"xytext": (-7, 6), "ha": "right"} if x > 0.8 else {"xytext": (7, -10)}
        axes.annotate(str(part.sum()), (x, y), textcoords="offset points", fontsize=8, color=colour, **place_of_text)


def show_cells(axes: Axes, picture: Array, resolution: float, origin: Numbers | Array, **options: Any) -> None:
    """Draw a map's cells, ``[H, W]`` or ``[H, W, 3]``, row 0 at the bottom, where they lie in {W}.

    ``resolution`` is a cell's side [m], ``origin`` the pose of the lower-left corner, ``options`` are imshow's.
    """
    from matplotlib.transforms import Affine2D

    height, width = picture.shape[:2]
    x, y, yaw = np.asarray(origin, dtype=float)
    place = Affine2D().scale(resolution).rotate(yaw).translate(x, y)
    image = axes.imshow(picture, origin="lower", extent=(0, width, 0, height), interpolation="nearest", **options)
    image.set_transform(place + axes.transData)


def object_colour(item: dict[str, Any], number: int) -> str:
    """Colour of an object of ``result.json``: by its family, or red once it is registered as an obstacle."""
    if item.get("registered"):
        return COLOURS["registered"]
    return _FAMILIES.get(str(item.get("family")), SERIES[(number + 1) % len(SERIES)])


def outline(pose: Array, half_extents: Numbers | Array) -> np.ndarray:
    """Corners ``[4, 2]`` in {W} of a rectangle with ``half_extents (2,)`` [m] at ``pose (3,)``."""
    corners = np.asarray(half_extents, dtype=float)[:2] * _SIGNS
    return se2.transform_point(np.asarray(pose, dtype=float), corners)


def window(result: dict[str, Any], trace: Trace, margin: float = 1.2) -> tuple[float, float, float, float]:
    """(x_min, x_max, y_min, y_max) in {W} [m] of all that happened, with a margin.

    Where the map ends soon beyond, which is within 3 m or half of what is shown, the side reaches to the map's end: its
    outer walls are in the picture. It never reaches past it. Cells of which nothing is known are no part of the map.
    """
    parts = [np.asarray(trace.robot_pose)[:, :2], *(np.asarray(p)[:, :2] for p in trace.plans if len(p))]
    parts += [
        outline(item[key], item["half_extents"]) for item in result["objects"] for key in ("start_pose", "final_pose")
    ]
    parts += [
        np.asarray(result[key], dtype=float)[None, :2] for key in ("start", "goal") if result.get(key) is not None
    ]
    points = np.concatenate(parts)
    points = points[np.isfinite(points).all(axis=1)]
    low, high = points.min(axis=0) - margin, points.max(axis=0) + margin
    first, last = extent(np.asarray(trace.map_cells) != -1, trace.map_resolution, trace.map_origin)
    reach = np.maximum(3.0, 0.5 * (high - low))
    low = np.where(low - reach <= first, first - _RIM, low)
    high = np.where(high + reach >= last, last + _RIM, high)
    return float(low[0]), float(high[0]), float(low[1]), float(high[1])


def extent(cells: Array, resolution: float, origin: Numbers | Array) -> tuple[np.ndarray, np.ndarray]:
    """Lowest and highest (x, y) in {W} [m] of the marked ``cells [H, W]``; of all cells if none is marked.

    ``resolution`` is a cell's side [m], ``origin`` the pose of the lower-left corner of cell (0, 0).
    """
    rows, columns = np.nonzero(cells) if np.any(cells) else np.nonzero(np.ones_like(cells))
    left, right, bottom, top = columns.min(), columns.max() + 1, rows.min(), rows.max() + 1
    corners = np.array([[left, bottom], [right, bottom], [left, top], [right, top]]) * resolution
    corners = se2.transform_point(np.asarray(origin, dtype=float), corners)
    return corners.min(axis=0), corners.max(axis=0)
