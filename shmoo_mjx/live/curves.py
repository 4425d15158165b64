"""Curves of the live page: the estimate of the pushed object beside the truth, the probability, lean and force."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import viser
from viser import uplot

from shmoo_mjx.live import words
from shmoo_mjx.live.session import Session
from shmoo_mjx.report.style import SERIES

_KEPT = 30.0
"""Time span of the curves [s]."""
_BLUE, _ORANGE, _GREEN, _RED = SERIES[0], SERIES[1], SERIES[2], SERIES[5]
_QUANTITIES = {"friction_y": _ORANGE, "friction_x": _BLUE, "mass": _GREEN}
"""Colour of each estimated quantity (`online.summary`), in the order of drawing."""
_X: Any = uplot.Series(label="t [s]")
_TIME: Any = {"x": {"time": False}}


class Curves:
    """Curves of the last seconds. They are made at the place where the panel has come to."""

    def __init__(self, gui: viser.GuiApi) -> None:
        self._rows: list[tuple[float, float, float, float]] = []
        self._estimates: list[tuple[float, ...]] = []
        self._object: int | None = None
        self.friction = _estimate_plot(gui, ("friction_y", "friction_x"))
        self.mass = _estimate_plot(gui, ("mass",))
        chance = (_X, uplot.Series(label="probability", stroke=_GREEN, width=2))
        scale: Any = {"x": {"time": False}, "y": {"auto": False, "range": (0.0, 1.05)}}
        self.chance = _plot(gui, chance, "Probability that the push frees the path", scales=scale, visible=False)
        motion = (
            _X,
            uplot.Series(label="lean [deg]", stroke=_BLUE, width=2),
            uplot.Series(label="force of the hands [10 N]", stroke=_RED, width=2),
        )
        self.motion = _plot(gui, motion, "Robot")

    def forget(self) -> None:
        """Clears the curves for a new run."""
        self._rows.clear()
        self._estimates.clear()
        self._object = None

    def note(self, session: Session) -> None:
        """Adds the session's last sample."""
        time, true, chance = session.simulation.time, session.simulation.true, session.probability
        if self._rows and time <= self._rows[-1][0]:
            return
        lean = float(np.rad2deg(np.linalg.norm(true.lean[0])))
        self._rows.append((time, lean, session.force / 10, np.nan if chance is None else chance))
        self._rows = [row for row in self._rows if row[0] > time - _KEPT]
        learned = session.simulation.navigator.learned
        if learned is None or "mass" not in learned[1]:
            return
        index, values = learned
        if index != self._object:
            self._object = index
            self._estimates.clear()
        true_values = session.true_values(index)
        row = [time]
        for name in _QUANTITIES:
            row += [values[f"{name}_low"], values[name], values[f"{name}_high"], true_values[name]]
        self._estimates.append(tuple(row))

    def draw(self, session: Session) -> None:
        """Sends the curves to the browsers."""
        t, lean, force, chance = _columns(self._rows, 4)
        self.chance.data, self.motion.data = (t, chance), (t, lean, force)
        for plot in (self.friction, self.mass):
            plot.visible = self._object is not None
        self.chance.visible = bool(np.isfinite(chance).any())
        if self._object is None:
            return
        name = words.object_name(self._object, session.simulation.conditions[self._object])
        t, *columns = _columns(self._estimates, 13)
        self.friction.title = f"Friction of {name} [N]: along blue, across orange; dashed true"
        self.friction.data = (t, *columns[:8])
        self.mass.title = f"Mass of {name} [kg]; dashed: true"
        self.mass.data = (t, *columns[8:])


def _columns(rows: Sequence[tuple[float, ...]], count: int) -> list[np.ndarray]:
    """The columns of a table; one row of zeros if it is empty, because a plot needs data."""
    return list(np.array(rows or [(0.0,) * count], dtype=float).T)


def _estimate_plot(gui: viser.GuiApi, names: tuple[str, ...]) -> Any:
    """A plot of estimated quantities: median with an 80 % band, and the true value as a dashed line."""
    series, bands = [_X], []
    for name in names:
        colour, low = _QUANTITIES[name], len(series)
        series += [
            uplot.Series(stroke=f"{colour}55", width=1),
            uplot.Series(stroke=colour, width=2),
            uplot.Series(stroke=f"{colour}55", width=1),
            uplot.Series(stroke=colour, width=2, dash=(6, 4)),
        ]
        bands.append(uplot.Band(series=(low + 2, low), fill=f"{colour}22"))
    return _plot(gui, tuple(series), "", bands=tuple(bands), legend=False, visible=False)


def _plot(
    gui: viser.GuiApi, series: tuple[Any, ...], title: str, *, scales: Any = None, legend: bool = True, **more: Any
) -> Any:
    """A plot over time. Its legend shows no values, because they would change its height."""
    return gui.add_uplot(
        tuple(np.zeros(1) for _ in series),
        series,
        title=title,
        scales=scales or _TIME,
        legend={"show": legend, "live": False},
        aspect=2.2,
        padding=(10, 24, 0, 0),
        **more,
    )
