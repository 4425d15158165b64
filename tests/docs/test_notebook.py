"""The notebook runs, its committed outputs are those of a run, and the tutorial has the same code.

WRITE_NOTEBOOK=1 uv run pytest -m slow tests/docs/test_notebook.py writes the outputs of this run into the notebook.
"""

from __future__ import annotations

import ast
import base64
import contextlib
import io
import json
import os
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any
from unittest.mock import patch

import matplotlib
import numpy as np
import pytest

from shmoo_mjx.base.files import write_whole
from shmoo_mjx.plant.render import can_render

ROOT = Path(__file__).resolve().parents[2]
NOTEBOOK = ROOT / "examples" / "quickstart.ipynb"
WRITE = "WRITE_NOTEBOOK"
NUMBER = re.compile(r"[-+]?\d+\.?\d*")
Output = dict[str, Any]


def cells() -> list[dict[str, Any]]:
    return json.loads(NOTEBOOK.read_text(encoding="utf-8"))["cells"]


CODE = ["".join(cell["source"]) for cell in cells() if cell["cell_type"] == "code"]


def picture(figure: Any) -> dict[str, Any]:
    """A figure as Jupyter keeps it."""
    png = io.BytesIO()
    figure.savefig(png, format="png", metadata={"Software": None})
    return {"image/png": base64.b64encode(png.getvalue()).decode() + "\n", "text/plain": [repr(figure)]}


def outputs_of(cell: str, number: int, names: dict[str, Any]) -> list[Output]:
    """Run a cell in the name space ``names``; its outputs in the form of Jupyter's."""
    from matplotlib import pyplot

    shown: list[Output] = []

    def show() -> None:
        for figure in map(pyplot.figure, pyplot.get_fignums()):
            shown.append({"data": picture(figure), "metadata": {}, "output_type": "display_data"})
        pyplot.close("all")

    tree = ast.parse(cell)
    last = tree.body.pop() if isinstance(tree.body[-1], ast.Expr) else None
    with contextlib.redirect_stdout(io.StringIO()) as printed, patch.object(pyplot, "show", show):
        exec(compile(tree, f"cell {number}", "exec"), names)
        value = eval(compile(ast.Expression(last.value), f"cell {number}", "eval"), names) if last else None
        show()  # what the cell leaves open, as Jupyter does
    if text := printed.getvalue():
        shown.insert(0, {"name": "stdout", "output_type": "stream", "text": text.splitlines(keepends=True)})
    if value is not None:
        data = picture(value) if hasattr(value, "savefig") else {"text/plain": [repr(value)]}
        shown.append({"data": data, "execution_count": number, "metadata": {}, "output_type": "execute_result"})
    return shown


@pytest.fixture(scope="module")
def run() -> tuple[dict[str, Any], list[list[Output]]]:
    """The names that all cells leave, and the outputs of each."""
    from matplotlib import pyplot

    matplotlib.use("Agg")
    names: dict[str, Any] = {"__name__": "notebook"}
    try:
        return names, [outputs_of(cell, number, names) for number, cell in enumerate(CODE, 1)]
    finally:
        pyplot.close("all")


def difference(kept: list[list[Output]], fresh: list[list[Output]]) -> str:
    """Where the outputs of two runs differ by more than numbers do from machine to machine; empty if nowhere."""
    for number, (old, new) in enumerate(zip(kept, fresh, strict=True), 1):
        kinds = [[(output["output_type"], *sorted(output.get("data", {}))) for output in some] for some in (old, new)]
        if kinds[0] != kinds[1]:
            return f"cell {number}: the kinds of output {kinds[0]} and {kinds[1]}"
        for before, after in zip(old, new, strict=True):
            texts = ["".join(o.get("text", o.get("data", {}).get("text/plain", []))) for o in (before, after)]
            if len({NUMBER.sub("0", text) for text in texts}) == 2:
                return f"cell {number}: {texts[0]!r} and {texts[1]!r}"
            numbers = [np.array(NUMBER.findall(text), dtype=float) for text in texts]
            if not np.allclose(*numbers, rtol=0.25, atol=1.0):
                return f"cell {number}: the numbers of {texts[0]!r} and {texts[1]!r}"
    return ""


def test_it_has_ten_short_cells_with_text_and_pictures() -> None:
    assert len(CODE) == 10 and max(len(cell.splitlines()) for cell in CODE) <= 16
    assert [cell["cell_type"] for cell in cells()] == ["markdown", "code"] * 10
    outputs = [output for cell in cells() for output in cell.get("outputs", [])]
    assert sum("image/png" in output.get("data", {}) for output in outputs) >= 5
    assert not any(output["output_type"] == "error" for output in outputs)
    assert NOTEBOOK.stat().st_size < 400_000


def test_the_tutorial_uses_the_same_code() -> None:
    tutorial = (ROOT / "docs" / "tutorial.md").read_text(encoding="utf-8")
    for cell in CODE:
        assert f"```python\n{cell}\n```" in tutorial


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda cell: cell.replace("12 kg", "12.4 kg"), ""),
        (lambda cell: cell.replace("12 kg", "20 kg"), "cell 1: the numbers"),
        (lambda cell: cell.replace("cart", "box"), "cell 1: "),
        (lambda cell: cell.replace("plt.figure()", "pass"), "cell 1: the kinds"),
    ],
)
def test_stale_outputs_are_told_and_other_digits_are_not(change: Callable[[str], str], said: str) -> None:
    cell = "import matplotlib.pyplot as plt\nprint('a cart of 12 kg')\nplt.figure()\nplt.show()\n1 + 1"
    names: dict[str, Any] = {}
    kept = outputs_of(cell, 1, names)
    assert [output["output_type"] for output in kept] == ["stream", "display_data", "execute_result"]
    found = difference([kept], [outputs_of(change(cell), 1, names)])
    assert found.startswith(said) and bool(found) == bool(said)


@pytest.mark.slow
def test_it_pushes_adapts_plans_and_arrives(run: tuple[dict[str, Any], list[list[Output]]]) -> None:
    names, _ = run
    # A slow push tells mass worse than friction; both bands hold the truth.
    for name, most in (("friction_x", 0.15), ("mass", 0.45)):
        low, known, high = (
            values[np.isfinite(values)][-1]
            for values in (names["known"][f"{name}{end}"] for end in ("_low", "", "_high"))
        )
        true = names["true"][name]
        assert abs(np.log(known / true)) < most and low <= true <= high, name
    assert np.hypot(names["x"][-1] - 0.5, names["y"][-1]) < 0.1
    assert names["around"] is None and names["shortest"].length > 5.0
    assert names["episode"].result["outcome"] == "success"


@pytest.mark.slow
def test_its_outputs_are_those_of_a_run(run: tuple[dict[str, Any], list[list[Output]]]) -> None:
    if why := can_render():
        pytest.skip(f"MuJoCo cannot draw here: {why}")
    _, fresh = run
    if os.environ.get(WRITE):
        notebook = json.loads(NOTEBOOK.read_text(encoding="utf-8"))
        code = [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]
        for number, (cell, outputs) in enumerate(zip(code, fresh, strict=True), 1):
            cell |= {"execution_count": number, "outputs": outputs}
        write_whole(NOTEBOOK, (json.dumps(notebook, indent=1, ensure_ascii=False) + "\n").encode())
    kept = [cell["outputs"] for cell in cells() if cell["cell_type"] == "code"]
    found = difference(kept, fresh)
    assert not found, f"{found}; {WRITE}=1 uv run pytest -m slow tests/docs/test_notebook.py writes the outputs anew"
