"""Colours, geometry and file output shared by figures and videos."""

from __future__ import annotations

import io
import warnings
from functools import cache
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
    from PIL import ImageFont

# Palette based on Okabe and Ito, which can be distinguished with colour vision deficiencies.
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
"""Fonts with characters that matplotlib's own font lacks, in the order in which they are tried."""
_RIM = 0.1
"""Width of the area shown beyond the end of a map [m]."""
_SIGNS = np.array([[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]])


@cache
def font(size: int, bold: bool = False) -> ImageFont.FreeTypeFont:
    """A font of this size [pixels] for Pillow, whose own font lacks characters such as the superscript in m²."""
    import matplotlib
    from PIL import ImageFont

    file = "DejaVuSans-Bold.ttf" if bold else "DejaVuSans.ttf"
    return ImageFont.truetype(str(Path(matplotlib.get_data_path()) / "fonts" / "ttf" / file), size)


def blank_figure(width: float, height: float) -> Figure:
    """An empty figure with a size in inches. It does not use pyplot, so it needs no display."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), layout="constrained")


def to_png(figure: Figure, dpi: int = 110) -> bytes:
    """The content of a PNG file of the figure. Text is drawn literally, including "$" and characters of any script."""
    _take_literally(figure)
    buffer = io.BytesIO()
    with warnings.catch_warnings():
        # Ignore characters that no installed font has. They appear as boxes.
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
    """Write the figure as PNG, atomically. Missing folders are created."""
    return write_whole(path, to_png(figure, dpi))


def legend_above(figure: Figure) -> None:
    """Add one legend for all panels above them."""
    figure.legend(loc="outside upper center", ncols=3, fontsize=8, frameon=False)


def beside(group: Any, k: int, count: int) -> Any:
    """Position of bar ``k`` of ``count`` in a group of bars with total width 0.8, centred at the integer ``group``."""
    return group + (k - (count - 1) / 2) * 0.8 / count


def draw_reliability(
    axes: Axes, probability: Array, truth: Array, *, colour: str, label: str, marker: str = "o"
) -> None:
    """Draw a reliability diagram: observed frequency against predicted probability, in five bins with counts.

    Args:
        axes: where to draw.
        probability: N predicted probabilities.
        truth: N outcomes, 0 or 1.
        colour: colour of the curve.
        label: name of the curve in the legend.
        marker: marker of the points.
    """
    place = np.minimum((probability * 5).astype(int), 4)
    parts = [place == b for b in np.unique(place)]
    predicted, came = ([np.mean(values[part]) for part in parts] for values in (probability, truth))
    axes.plot((0, 1), (0, 1), color="black", lw=1.0, ls="--")
    axes.plot(predicted, came, marker, color=colour, ms=6, label=label, ls="-", lw=0.8)
    for x, y, part in zip(predicted, came, parts, strict=True):
        place_of_text = {"xytext": (-7, -10), "ha": "right"} if x > 0.9 else {"xytext": (7, -10)}
        axes.annotate(str(part.sum()), (x, y), textcoords="offset points", fontsize=8, color=colour, **place_of_text)


def show_cells(axes: Axes, picture: Array, resolution: float, origin: Numbers | Array, **options: Any) -> None:
    """Draw the cells of a map at their place in {W}.

    Args:
        axes: where to draw.
        picture: cells ``[H, W]`` or ``[H, W, 3]``, row 0 at the bottom.
        resolution: side of a cell [m].
        origin: pose of the lower-left corner in {W}.
        options: options of imshow.
    """
    from matplotlib.transforms import Affine2D

    height, width = picture.shape[:2]
    x, y, yaw = np.asarray(origin, dtype=float)
    place = Affine2D().scale(resolution).rotate(yaw).translate(x, y)
    image = axes.imshow(picture, origin="lower", extent=(0, width, 0, height), interpolation="nearest", **options)
    image.set_transform(place + axes.transData)


def object_colour(item: dict[str, Any], number: int) -> str:
    """Colour of an object of ``result.json``, given by its family, or red if it is registered as an obstacle."""
    if item.get("registered"):
        return COLOURS["registered"]
    return _FAMILIES.get(str(item.get("family")), SERIES[(number + 1) % len(SERIES)])


def outline(pose: Array, half_extents: Numbers | Array) -> np.ndarray:
    """Corners ``[4, 2]`` in {W} of a rectangle with ``half_extents (2,)`` [m] at ``pose (3,)`` in {W}."""
    corners = np.asarray(half_extents, dtype=float)[:2] * _SIGNS
    return se2.transform_point(np.asarray(pose, dtype=float), corners)


def window(result: dict[str, Any], trace: Trace, margin: float = 1.2) -> tuple[float, float, float, float]:
    """Window (x_min, x_max, y_min, y_max) in {W} [m] that shows all paths and objects with a margin.

    A side extends to the end of the map if that is within 3 m or half of the window's size, whichever is larger, so
    that the outer walls are visible. No side extends beyond the map, except for a small border. Unknown cells do not
    count as part of the map.
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
    """Lowest and highest (x, y) in {W} [m] of the marked cells, or of all cells if none is marked.

    Args:
        cells: mask ``[H, W]`` of the marked cells.
        resolution: side of a cell [m].
        origin: pose of the lower-left corner of cell (0, 0) in {W}.
    """
    rows, columns = np.nonzero(cells) if np.any(cells) else np.nonzero(np.ones_like(cells))
    left, right, bottom, top = columns.min(), columns.max() + 1, rows.min(), rows.max() + 1
    corners = np.array([[left, bottom], [right, bottom], [left, top], [right, top]]) * resolution
    corners = se2.transform_point(np.asarray(origin, dtype=float), corners)
    return corners.min(axis=0), corners.max(axis=0)
