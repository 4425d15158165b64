"""Figures take every name as it is, and show the walls round what happened."""

from __future__ import annotations

import io
import warnings
from typing import Any

import numpy as np
import pytest
from matplotlib.colors import to_rgb
from matplotlib.text import Text
from PIL import Image

from shmoo_mjx.report import html, video
from shmoo_mjx.report.style import COLOURS, blank_figure, to_png, window
from shmoo_mjx.report.trace import Trace

NAMES = ("$", "a$b$c", r"$\frac$", r"cost \$5", "x^2_{", "桌子", "сту́л", "كرسي", "🪑", "_hidden", "a\nb", "%s {0}")


@pytest.mark.parametrize("name", NAMES)
def test_a_name_is_drawn_as_it_is(name: str) -> None:
    figure = blank_figure(4, 3)
    axes = figure.subplots()
    axes.plot([1, 10, 100], [1, 2, 3], label=f"object {name}")
    axes.set(title=name, xlabel=name, xscale="log")
    axes.set_yticks([1, 2, 3], [name, "b", "c"])
    axes.annotate(name, (10, 2), (20, 2), arrowprops={"arrowstyle": "->"})
    axes.legend(title=name)
    figure.suptitle(name)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        picture = Image.open(io.BytesIO(to_png(figure)))
    assert np.asarray(picture.convert("L")).std() > 5
    named = [text for text in figure.findobj(Text) if name in text.get_text() and "mathdefault" not in text.get_text()]  # type: ignore[attr-defined]
    assert len(named) >= 7 and not any(text.get_parse_math() for text in named)
    powers = [text for text in axes.get_xticklabels() if text.get_text()]
    assert powers and all(text.get_parse_math() for text in powers)


def test_a_report_takes_every_name(trace: Trace, result: dict[str, Any]) -> None:
    for item, name in zip(result["objects"], (r"ta$\frac$ 桌子 🪑", "_$hidden$"), strict=True):
        item["family"] = name
    result["name"] = result["transitions"][0]["reason"] = " ".join(NAMES)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        page = html.render_report(result, trace)
        for frame in video.topdown_frames(result, trace, speed=100.0):
            assert frame.shape[2] == 3
    assert page.count("data:image/png") >= 4


def moved(trace: Trace, result: dict[str, Any], shift: float) -> tuple[dict[str, Any], Trace]:
    """The run as it is, in a map that goes on to the right for ``shift`` [m] more."""
    cells = np.zeros((60, 80 + round(10 * shift)), np.int8)
    cells[[0, -1], :] = cells[:, [0, -1]] = 100
    return result, trace._replace(map_cells=cells)


@pytest.mark.parametrize("shift", [0.0, 0.5, 1.5, 3.0])
def test_the_walls_round_a_run_are_in_the_picture(shift: float, trace: Trace, result: dict[str, Any]) -> None:
    result, trace = moved(trace, result, shift)
    x0, x1, y0, y1 = window(result, trace)
    assert (x0, y0) == pytest.approx((-0.1, -0.1)) and (x1, y1) == pytest.approx((8.1 + shift, 6.1))
    view = video.top_down(result, trace, (400, 300))
    picture = video.topdown_image(view, 0.0) / 255
    for point in ((0.05, 3.0), (7.95 + shift, 3.0), (4.0, 0.05), (4.0, 5.95)):
        x, y = np.array(view.pixels(np.array([point]))[0]) / 2
        assert np.abs(picture[int(y), int(x)] - to_rgb(COLOURS["wall"])).max() < 0.3, point


def test_of_a_large_map_what_happened_is_shown(trace: Trace, result: dict[str, Any]) -> None:
    result, trace = moved(trace, result, 60.0)
    assert window(result, trace)[1] == pytest.approx(7.0 + 1.2)


def test_cells_of_which_nothing_is_known_are_no_part_of_the_map(trace: Trace, result: dict[str, Any]) -> None:
    frame = np.pad(np.asarray(trace.map_cells), 30, constant_values=-1)
    framed = trace._replace(map_cells=frame, map_origin=np.array([-3.0, -3.0, 0.0]))
    assert window(result, framed) == pytest.approx(window(result, trace))
    unknown = trace._replace(map_cells=np.full((60, 80), -1))
    assert window(result, unknown) == pytest.approx((-0.1, 8.1, -0.1, 6.1))
