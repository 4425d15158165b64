"""Summary and figures of a sweep: success and fall rates by one parameter and over two parameters."""

from __future__ import annotations

import itertools
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np

from shmoo_mjx.report.style import SERIES, blank_figure, save_figure
from shmoo_mjx.sweep.config import SweepConfig
from shmoo_mjx.sweep.parameters import PARAMETERS, RESISTANCE

Table = dict[str, list[Any]]

_OUTCOMES = ("success", "astray", "stuck", "unfelt", "fell", "unstable")
_COLUMNS = 5


def rate(successes: np.ndarray, trials: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Success rate with Wilson's 95 % interval.

    Args:
        successes: number of successes.
        trials: number of trials.

    Returns:
        Rate, and lower and upper end of the interval; NaN if there are no trials.
    """
    k, n, z = np.asarray(successes, float), np.asarray(trials, float), 1.96
    with np.errstate(invalid="ignore", divide="ignore"):
        share = k / n
        middle = (share + z * z / (2 * n)) / (1 + z * z / n)
        half = z * np.sqrt(share * (1 - share) / n + z * z / (4 * n * n)) / (1 + z * z / n)
    return share, middle - half, middle + half


def binned(values: np.ndarray, happened: np.ndarray, bins: int = 8) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Count events in bins of a parameter.

    Args:
        values: parameter value of each world.
        happened: whether the event happened in each world.
        bins: largest number of bins B. If there are at most this many distinct values, each is a bin. Otherwise all
            bins contain about the same number of worlds.

    Returns:
        Median value, number of events and number of worlds per bin, ``[B]`` each.
    """
    values, happened = np.asarray(values, float), np.asarray(happened, bool)
    distinct = np.unique(values)
    if len(distinct) <= bins:
        which = np.searchsorted(distinct, values)
    else:
        edges = np.quantile(values, np.linspace(0, 1, bins + 1)[1:-1])
        which = np.searchsorted(edges, values, side="right")
    groups = [which == b for b in range(which.max() + 1) if (which == b).any()]
    return (
        np.array([np.median(values[g]) for g in groups]),
        np.array([happened[g].sum() for g in groups]),
        np.array([g.sum() for g in groups]),
    )


def groups_of(table: Table) -> dict[tuple[str, str], np.ndarray]:
    """Row masks of each (family, controller), in order of appearance."""
    pairs = list(zip(table["family"], table["controller"], strict=True))
    return {pair: np.array([p == pair for p in pairs]) for pair in dict.fromkeys(pairs)}


def summary(config: SweepConfig, table: Table) -> str:
    """Text summary: outcomes per family and controller, and successes by resistance and over the map's parameters."""
    lines = [config.question] if config.question else []
    head = f"{'family':12} {'controller':14} {'worlds':>7} {'success':>8} {'95 %':>13}"
    lines.append(head + "".join(f" {name:>9}" for name in _OUTCOMES[1:]))
    success, outcome = np.array(table["success"]), np.array(table["outcome"])
    for (family, controller), mine in groups_of(table).items():
        share, low, high = rate(success[mine].sum(), mine.sum())
        counts = Counter(outcome[mine].tolist())
        line = f"{family:12} {controller:14} {mine.sum():7d} {share:8.3f} {low:6.3f} {high:6.3f}"
        lines.append(line + "".join(f" {counts[name]:9d}" for name in _OUTCOMES[1:]))
    lines += _resistance_lines(table)
    if config.map:
        lines += _map_lines(config.map, table)
    return "\n".join(lines)


def _resistance_lines(table: Table) -> list[str]:
    lines = ["", "successes of worlds by the object's resistance [N]"]
    for (family, controller), mine in groups_of(table).items():
        values = np.array(table[RESISTANCE])[mine]
        middle, successes, trials = binned(values, np.array(table["success"])[mine], _bins(int(mine.sum())))
        text = "".join(f"{f'{m:.3g}: {k}/{n}':>14}" for m, k, n in zip(middle, successes, trials, strict=True))
        lines.append(f"{family:12} {controller:14}{text}")
    return lines


def _bins(worlds: int) -> int:
    """Number of bins, so that each bin has at least about twelve worlds; from 2 to 8."""
    return int(np.clip(worlds // 12, 2, 8))


def _map_lines(axes: tuple[str, str], table: Table) -> list[str]:
    lines = []
    for (family, controller), mine in groups_of(table).items():
        x, y, successes, trials = cells(axes, table, mine)
        lines += ["", f"{family}, {controller}: successes of worlds, {axes[0]} across, {axes[1]} down"]
        lines.append(" " * 16 + "".join(f"{f'{a:.3g}-{b:.3g}':>13}" for a, b in itertools.pairwise(x)))
        for j in range(len(y) - 1):
            text = "".join(f"{f'{successes[j, i]}/{trials[j, i]}':>13}" for i in range(len(x) - 1))
            lines.append(f"{f'{y[j]:.3g}-{y[j + 1]:.3g}':16}{text}")
    return lines


def cells(
    axes: tuple[str, str], table: Table, mine: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Count successes and worlds in the cells of a two-parameter map.

    The edges are quantiles over all worlds of the family, so that its controllers share them.

    Args:
        axes: names of the two parameters.
        table: columns of the sweep's rows.
        mine: mask of the rows to count, of one family.

    Returns:
        Edges along the first and the second parameter, and successes and worlds per cell. The second parameter is the
            first axis of the cells.
    """
    x, y = (np.array(table[name], dtype=float) for name in axes)
    family = np.array(table["family"]) == np.array(table["family"])[mine][0]
    bins = int(np.clip(np.sqrt(mine.sum() / 8), 2, 6))
    edges = [np.unique(np.quantile(v[family], np.linspace(0, 1, bins + 1))) for v in (x, y)]
    success = np.array(table["success"])
    counted = [np.histogram2d(y[rows], x[rows], [edges[1], edges[0]])[0].astype(int) for rows in (mine & success, mine)]
    return edges[0], edges[1], counted[0], counted[1]


def draw_figures(config: SweepConfig, table: Table, out: Path) -> list[Path]:
    """Write ``parameters.png`` if parameters are varied, and ``map.png`` if the sweep has a map. Returns the paths."""
    paths = []
    if config.varied:
        paths.append(_draw_parameters(config, table, out / "parameters.png"))
    if config.map:
        paths.append(_draw_map(config, config.map, table, out / "map.png"))
    return paths


def _draw_parameters(config: SweepConfig, table: Table, path: Path) -> Path:
    """Draw one panel per parameter with the rates of success (solid) and of falls (dashed)."""
    names = [RESISTANCE, *config.varied]
    columns = min(len(names), _COLUMNS)
    rows = -(-len(names) // columns)
    figure = blank_figure(2.6 * columns + 0.8, 2.4 * rows + 0.9)
    axes = figure.subplots(rows, columns, squeeze=False, sharey=True)
    for axis, name in zip(axes.flat, names, strict=False):
        for number, ((family, controller), mine) in enumerate(groups_of(table).items()):
            colour = SERIES[number % len(SERIES)]
            for column, line, word in (("success", "-", "success"), ("fell", "--", "fall")):
                label = f"{word}: {family}, {controller}"
                _draw_rate(axis, table, (name, column), mine, color=colour, linestyle=line, label=label)
        _scale(axis, "x", name == RESISTANCE or bool(config.vary[name].log_uniform))
        unit = "N" if name == RESISTANCE else PARAMETERS[name].unit
        axis.set_xlabel(f"{name} [{unit}]", fontsize=8)
        axis.set_ylim(-0.03, 1.03)
        axis.tick_params(labelsize=7)
    for axis in list(axes.flat)[len(names) :]:
        axis.remove()
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4, fontsize=7, frameon=False)
    figure.suptitle(config.question or "by parameter", fontsize=10)
    figure.supylabel("share of worlds, with 95 % intervals", fontsize=8)
    return save_figure(path, figure, 130)


def _scale(axes: Any, which: str, logarithmic: bool) -> None:
    """Make an axis (x or y) logarithmic if asked, with ticks at 1, 2 and 5 in plain numbers."""
    from matplotlib.ticker import LogLocator, NullFormatter, ScalarFormatter

    if logarithmic:
        getattr(axes, f"set_{which}scale")("log")
        axis = getattr(axes, f"{which}axis")
        axis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        axis.set_major_formatter(ScalarFormatter())
        axis.set_minor_formatter(NullFormatter())


def _draw_rate(axis: Any, table: Table, columns: tuple[str, str], mine: np.ndarray, **style: str) -> None:
    """Draw the rate at which the second column (an event) is true over the first column (a parameter)."""
    name, happened = columns
    # A parameter is missing for families that lack it, such as the rolling resistance of families without wheels.
    values = np.array([np.nan if v is None else v for v in table.get(name, [None] * len(mine))], dtype=float)
    mine = mine & np.isfinite(values)
    if not mine.any():
        return
    x, times, trials = binned(values[mine], np.array(table[happened])[mine], _bins(int(mine.sum())))
    share, low, high = rate(times, trials)
    axis.plot(x, share, marker="o", ms=2.5, lw=1.2, **style)
    axis.fill_between(x, low, high, color=style["color"], alpha=0.12, lw=0)


def _draw_map(config: SweepConfig, names: tuple[str, str], table: Table, path: Path) -> Path:
    """Draw the map of success rates, with each world as a mark."""
    groups = groups_of(table)
    figure = blank_figure(4.4 * len(groups) + 1.0, 4.6)
    axes = figure.subplots(1, len(groups), squeeze=False)
    shown: Any = None
    for axis, (pair, mine) in zip(axes[0], groups.items(), strict=True):
        x, y, successes, trials = cells(names, table, mine)
        share = np.ma.masked_invalid(rate(successes, trials)[0])
        axis.set_facecolor("#F4F4F4")
        shown = axis.pcolormesh(x, y, share, vmin=0, vmax=1, cmap="viridis", alpha=0.45)
        _draw_outcomes(axis, names, table, mine)
        _scale(axis, "x", bool(config.vary[names[0]].log_uniform))
        _scale(axis, "y", bool(config.vary[names[1]].log_uniform))
        axis.set_title(", ".join(pair), fontsize=9)
        axis.set_xlabel(f"{names[0]} [{PARAMETERS[names[0]].unit}]")
    axes[0, 0].set_ylabel(f"{names[1]} [{PARAMETERS[names[1]].unit}]")
    figure.colorbar(shown, ax=axes[0].tolist(), label="share of successes")
    figure.suptitle(config.question, fontsize=10)
    return save_figure(path, figure, 130)


def _draw_outcomes(axis: Any, names: tuple[str, str], table: Table, mine: np.ndarray) -> None:
    x, y = (np.array(table[name], dtype=float) for name in names)
    outcome = np.array(table["outcome"])
    for name, mark, colour in zip(_OUTCOMES, "o.xv*s", (*SERIES[2:3], *SERIES[7:], "k", *SERIES[3:6]), strict=False):
        some = mine & (outcome == name)
        if some.any():
            axis.scatter(x[some], y[some], s=14, marker=mark, color=colour, lw=0.7, label=f"{name}: {some.sum()}")
    axis.legend(fontsize=7, ncols=3, loc="upper center", bbox_to_anchor=(0.5, -0.14), frameon=False)
