"""The notebook runs, its short form in every test run, and the tutorial has the same code."""

from __future__ import annotations

import json
from pathlib import Path

import matplotlib
import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[2]
NOTEBOOK = ROOT / "examples" / "quickstart.ipynb"
CELLS = json.loads(NOTEBOOK.read_text(encoding="utf-8"))["cells"]
CODE = ["".join(cell["source"]) for cell in CELLS if cell["cell_type"] == "code"]
SHORT = 8
"""Cells without the run through the rooms."""


def executed(cells: list[str]) -> dict[str, object]:
    from matplotlib import pyplot

    matplotlib.use("Agg")
    names: dict[str, object] = {"__name__": "notebook"}
    try:
        for cell in cells:
            exec(compile(cell, str(NOTEBOOK), "exec"), names)
    finally:
        pyplot.close("all")
    return names


def test_it_has_ten_short_cells_with_text_and_pictures() -> None:
    assert len(CODE) == 10 and max(len(cell.splitlines()) for cell in CODE) <= 16
    assert [cell["cell_type"] for cell in CELLS] == ["markdown", "code"] * 10
    outputs = [output for cell in CELLS for output in cell.get("outputs", [])]
    assert sum("image/png" in output.get("data", {}) for output in outputs) >= 5
    assert not any(output["output_type"] == "error" for output in outputs)
    assert NOTEBOOK.stat().st_size < 400_000


def test_the_tutorial_uses_the_same_code() -> None:
    tutorial = (ROOT / "docs" / "tutorial.md").read_text(encoding="utf-8")
    for cell in CODE:
        assert f"```python\n{cell}\n```" in tutorial


@pytest.mark.slow
def test_the_short_form_pushes_adapts_and_plans() -> None:
    names = executed(CODE[:SHORT])
    log_mass = np.asarray(names["log_mass"])
    known = np.exp(log_mass[np.isfinite(log_mass)])
    assert abs(known[-1] - 6.0) < abs(known[0] - 6.0) - 1.0  # it has learned what the box weighs
    assert np.hypot(names["x"][-1] - 0.5, names["y"][-1]) < 0.1  # type: ignore[index]
    assert names["around"] is None and names["shortest"].length > 5.0  # type: ignore[attr-defined]


@pytest.mark.slow
def test_all_of_it_runs() -> None:
    names = executed(CODE)
    assert names["episode"].result["outcome"] == "success"  # type: ignore[attr-defined]
