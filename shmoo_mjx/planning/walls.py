"""Covers the occupied cells of a map with few rectangles, which become wall geoms."""

from __future__ import annotations

import numpy as np

from shmoo_mjx.arrays import Bool, Int, Scalar


def cover_rectangles(mask: Bool[np.ndarray, "H W"]) -> Int[np.ndarray, "K 4"]:
    """Rectangles that cover every True cell and no False cell.

    Greedy: cells are processed in decreasing order of the longest straight run through them. For each uncovered cell
    there are two maximal rectangles, grown from its row run and from its column run; the one that covers more uncovered
    cells is taken. Rectangles may overlap: where walls cross, this needs fewer of them than a partition.

    Returns:
        One row per rectangle: first row, last row + 1, first column, last column + 1.
    """
    mask = np.asarray(mask, dtype=bool)
    rows, cols = np.nonzero(mask)
    if rows.size == 0:
        return np.zeros((0, 4), dtype=int)
    left, right = _runs(mask)
    top, bottom = (edge.T for edge in _runs(mask.T))
    longest = np.maximum(right - left, bottom - top)[rows, cols]
    uncovered = mask.copy()
    boxes = []
    for i in np.argsort(-longest, kind="stable"):
        row, col = rows[i], cols[i]
        if not uncovered[row, col]:
            continue
        wide = _grow(mask, row, left[row, col], right[row, col])
        c0, c1, r0, r1 = _grow(mask.T, col, top[row, col], bottom[row, col])
        tall = (r0, r1, c0, c1)
        best = max(wide, tall, key=lambda r: int(uncovered[r[0] : r[1], r[2] : r[3]].sum()))
        uncovered[best[0] : best[1], best[2] : best[3]] = False
        boxes.append(best)
    return np.array(boxes, dtype=int)


def _runs(mask: Bool[np.ndarray, "H W"]) -> tuple[Int[np.ndarray, "H W"], Int[np.ndarray, "H W"]]:
    """First column and end column of the run of True cells through each cell, along its row."""
    width = mask.shape[1]
    columns = np.arange(width)
    last_gap = np.maximum.accumulate(np.where(mask, -1, columns), axis=1)
    next_gap = np.minimum.accumulate(np.where(mask, width, columns)[:, ::-1], axis=1)[:, ::-1]
    return last_gap + 1, next_gap


def _grow(mask: Bool[np.ndarray, "H W"], row: Scalar, start: Scalar, end: Scalar) -> tuple[int, int, int, int]:
    """Extends the run ``mask[row, start:end]`` to the adjacent rows in which all of it is True."""
    full = mask[:, start:end].all(axis=1)
    gaps = np.flatnonzero(~full)
    at = int(np.searchsorted(gaps, row))
    low = int(gaps[at - 1]) + 1 if at > 0 else 0
    high = int(gaps[at]) if at < gaps.size else mask.shape[0]
    return low, high, int(start), int(end)
