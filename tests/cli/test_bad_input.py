"""A generator of bad input: options, scenario files, maps, object files, meshes and weights, through the command.

Each case ends with one sentence and exit code 2, or is a correct run: no traceback, no left part of a file.
300 cases in the fast form, 10,000 in the slow one (uv run pytest -m slow tests/cli/test_bad_input.py).
"""

from __future__ import annotations

import contextlib
import inspect
import io
import math
import os
import re
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from shmoo_mjx import cli
from shmoo_mjx.base.assets import WEIGHTS, asset
from shmoo_mjx.planning.maps import OCCUPIED, OccupancyGrid, save_map

LONGEST = 20.0
"""More is a hang [s]."""
BOX = {"family": "box", "pose": [3.5, 1.5, 0.0], "seed": 3, "properties": {"mass": 3.0, "size": [0.5, 0.5, 0.6]}}
CART = {
    "family": "cart",
    "pose": [2.2, 2.2, 0.3],
    "properties": {"payload": 4.0, "locked": [True, False, False, False]},
}
SCENARIO: dict[str, Any] = {
    "map": "room.yaml",
    "start": [1.0, 1.0, 0.0],
    "goal": [4.2, 2.0],
    "objects": [BOX, CART],
    "seed": 0,
    "limits": {"time_s": 60.0, "goal_tolerance_m": 0.25},
    "senses": "real",
}
TETRAHEDRON = "v 0 0 0\nv 0.5 0 0\nv 0 0.5 0\nv 0 0 0.6\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3\n"
TEXTS = st.one_of(
    st.sampled_from(
        ["", " ", "nan", "-inf", "1e308", "-1", "0", "None", "true", "9" * 400, "../..", "\x00", "\u0663", "-"]
    ),
    st.text(max_size=12),
    st.integers(-(10**40), 10**40).map(str),
    st.floats().map(repr),
)
VALUES = st.recursive(
    st.one_of(
        st.none(),
        st.booleans(),
        st.integers(-(10**40), 10**40),
        st.floats(),
        st.sampled_from([-1, 0, 1e-12, 1e9, "box", "x" * 300, "2026-01-01", "\u00e9", [], {}, [[[]]]]),
        st.text(st.characters(codec="utf-8", exclude_categories=["Cs"]), max_size=8),
    ),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text("abc", max_size=3), inner, max_size=2),
    max_leaves=6,
)


class AcceptedError(Exception):
    """All input was found good and the work would begin."""


def paths(tree: Any, here: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Places in a tree of mappings and lists."""
    items = tree.items() if isinstance(tree, dict) else enumerate(tree) if isinstance(tree, list) else ()
    for key, value in items:
        yield (*here, key)
        yield from paths(value, (*here, key))


def mutated(tree: Any, path: tuple[Any, ...], change: Callable[[Any, Any], None]) -> Any:
    """A copy with ``change(parent, key)`` applied at ``path``."""
    copy: Any = yaml.safe_load(yaml.safe_dump(tree))
    parent = copy
    for key in path[:-1]:
        parent = parent[key]
    change(parent, path[-1])
    return copy


@st.composite
def documents(draw: st.DrawFn, good: dict[str, Any]) -> bytes:
    """A YAML file near a good one: values, keys or the text itself are changed."""
    tree: Any = good
    for _ in range(draw(st.integers(0, 2))):
        places = list(paths(tree))
        if not places:
            break
        path, kind = draw(st.sampled_from(places)), draw(st.sampled_from(["set", "set", "drop", "add"]))
        value = draw(VALUES)

        def change(parent: Any, key: Any, kind: str = kind, value: Any = value) -> None:
            if kind == "drop":
                del parent[key]
            elif kind == "add" and isinstance(parent, dict):
                parent[f"{key}x"] = value
            elif kind == "add":
                parent.append(value)
            else:
                parent[key] = value

        tree = mutated(tree, path, change)
    text = yaml.safe_dump(tree, allow_unicode=True)
    how = draw(st.sampled_from(["no", "no", "no", "cut", "twice", "nested", "anchors", "binary", "python", "tabs"]))
    broken = {
        "cut": text[: draw(st.integers(0, len(text)))],
        "twice": text + f"{draw(st.sampled_from(list(good)))}: 1\n",
        "nested": "a: " + "[" * draw(st.sampled_from([1, 40, 3000])),
        "anchors": "a: &a [x, x]\nb: &b [*a, *a]\nobjects: [*b, *b]\n" + text,
        "python": text + "map: !!python/object/apply:os.system ['touch executed']\n",
        "tabs": text.replace("  ", "\t"),
    }
    if how == "binary":
        return draw(st.binary(max_size=60)) + text.encode()
    return broken.get(how, text).encode("utf-8", "surrogatepass")


@st.composite
def files(draw: st.DrawFn, good: bytes) -> bytes:
    """A binary file near a good one: cut, with other bytes in it, or something else."""
    how = draw(st.sampled_from(["cut", "bytes", "other", "empty"]))
    if how == "cut":
        return good[: draw(st.integers(0, len(good)))]
    if how == "bytes":
        spoilt = bytearray(good)
        for _ in range(draw(st.integers(1, 4))):
            spoilt[draw(st.integers(0, min(len(good), 400) - 1))] = draw(st.integers(0, 255))
        return bytes(spoilt)
    return draw(st.binary(max_size=40)) if how == "other" else b""


def parsed_only() -> dict[str, Callable[..., int]]:
    """The commands, each doing nothing once its options are read."""

    def idle(command: Callable[..., int]) -> Callable[..., int]:
        def stand_in(*arguments: object, **options: object) -> int:
            raise AcceptedError

        stand_in.__signature__ = inspect.signature(command)  # type: ignore[attr-defined]
        stand_in.__annotations__ = inspect.get_annotations(command, eval_str=True)
        return stand_in

    return {name: idle(command) for name, command in cli._COMMANDS.items()}


@st.composite
def options(draw: st.DrawFn) -> list[str]:
    """Words of a command with up to three options that it has, or has not, at any value."""
    name = draw(st.sampled_from(sorted(cli._COMMANDS)))
    known = [f"--{p.replace('_', '-')}" for p in inspect.signature(cli._COMMANDS[name]).parameters]
    words = [name, *draw(st.lists(TEXTS, max_size=2))]
    for _ in range(draw(st.integers(0, 3))):
        words.append(draw(st.sampled_from([*known, "--no-such", "--"])))
        if draw(st.booleans()):
            words.append(draw(TEXTS))
    return [word.replace("\x00", "") for word in words]


@pytest.fixture(scope="module")
def good(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of good files to spoil copies of."""
    folder = tmp_path_factory.mktemp("good")
    cells = np.zeros((60, 100), np.int8)
    cells[:2] = cells[-2:] = cells[:, :2] = cells[:, -2:] = OCCUPIED
    save_map(OccupancyGrid(cells, 0.05), folder / "room.yaml")
    (folder / "chair.obj").write_text(TETRAHEDRON)
    (folder / "scenario.yaml").write_text(yaml.safe_dump(SCENARIO))
    return folder


def cases(good: Path) -> st.SearchStrategy[tuple[list[str], dict[str, bytes]]]:
    """(words of a command, files that it finds spoilt)."""
    image = next(p for p in good.iterdir() if p.suffix in (".pgm", ".png"))
    room: dict[str, Any] = yaml.safe_load((good / "room.yaml").read_text())
    drive = ["navigate", "--no-video", "--scenario", "scenario.yaml", "--out", "out"]
    show = ["map", "show", "room.yaml", "--out", "map.png"]
    add = ["object", "add", "chair.obj", "--mass", "4", "--friction", "0.4"]
    weights = asset(WEIGHTS).read_bytes()
    starts = st.lists(TEXTS, min_size=1, max_size=4).map(",".join) | st.just("9" * 700)
    point = [*("navigate", "--no-video", "--out", "out", "--map", "room.yaml", "--goal", "4,2")]
    return st.one_of(
        documents(SCENARIO).map(lambda content: (drive, {"scenario.yaml": content})),
        documents(SCENARIO).map(lambda content: (drive, {"scenario.yaml": content})),
        documents(room).map(lambda content: (show, {"room.yaml": content})),
        files(image.read_bytes()).map(lambda content: (show, {image.name: content})),
        files(TETRAHEDRON.encode()).map(lambda content: (add, {"chair.obj": content})),
        files(weights).map(lambda content: ([*drive, "--weights", "w.safetensors"], {"w.safetensors": content})),
        documents({"pickle": 1}).map(lambda content: (["view", "thing.json", "--no-window"], {"thing.json": content})),
        files(b'{"experiment": "x", "rows": []}').map(
            lambda content: (["bench", "compare", "a.json", "a.json"], {"a.json": content})
        ),
        starts.map(lambda text: ([*point, f"--start={text}".replace("\x00", "")], {})),
    )


def ended(words: list[str], monkeypatch: pytest.MonkeyPatch) -> tuple[int | None, str]:
    """Exit code, None where the work would have begun, and what stands on stderr."""
    said = io.StringIO()
    monkeypatch.setattr(sys, "argv", ["shmoo", *words])
    began = time.process_time()  # a busy neighbour is no hang
    with contextlib.redirect_stderr(said), contextlib.redirect_stdout(io.StringIO()):
        try:
            cli.main()
        except SystemExit as end:
            code: int | None = int(end.code or 0)
        except AcceptedError:
            code = None
    assert time.process_time() - began < LONGEST, words
    return code, said.getvalue()


def check_files(case: tuple[list[str], dict[str, bytes]], folder: Path, good: Path, mp: pytest.MonkeyPatch) -> None:
    words, spoilt = case
    for old in folder.iterdir():
        old.unlink()
    for path in good.iterdir():
        (folder / path.name).write_bytes(path.read_bytes())
    for name, content in spoilt.items():
        (folder / name).write_bytes(content)
    before = {path.name for path in folder.iterdir()}
    code, said = ended(words, mp)
    left = {path.name for path in folder.iterdir()} - before
    assert code in (None, 0, 2), (words, spoilt, said)
    if code == 2:
        assert re.fullmatch(r"shmoo: [^\n]{5,600}[.;!?)]\n", said), (words, spoilt, said)
        assert not left, (words, left)
    assert not any(".tmp" in name or name == "executed" for name in left), left


def check_options(words: list[str], mp: pytest.MonkeyPatch) -> None:
    with mp.context() as stand_ins:
        for name, command in parsed_only().items():
            stand_ins.setitem(cli._COMMANDS, name, command)
        code, said = ended(words, mp)
    assert code in (None, 0, 2) and "Traceback" not in said, (words, said)
    if code == 2 and said.startswith("shmoo: "):
        assert said.count("\n") == 1, (words, said)


@pytest.fixture
def spoiling(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """An empty folder to work in; what would take long ends as accepted."""

    def begins(*_: object, **__: object) -> None:
        raise AcceptedError

    from shmoo_mjx.run import view

    monkeypatch.setattr("shmoo_mjx.run.episode.run_episode", begins)
    monkeypatch.setattr(view, "film", begins)
    monkeypatch.setattr("shmoo_mjx.control.pushing.PushController", lambda weights: weights)
    monkeypatch.chdir(tmp_path)
    yield tmp_path
    os.chdir("/")


def tries(count: int) -> Any:
    ignored = [HealthCheck.function_scoped_fixture, HealthCheck.too_slow, HealthCheck.data_too_large]
    return settings(max_examples=count, deadline=None, suppress_health_check=ignored)


@pytest.mark.parametrize("count", [25, pytest.param(5000, marks=pytest.mark.slow)])
def test_spoilt_files(count: int, spoiling: Path, good: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    tries(count)(given(cases(good))(lambda case: check_files(case, spoiling, good, monkeypatch)))()


@pytest.mark.parametrize("count", [25, pytest.param(5000, marks=pytest.mark.slow)])
def test_options_at_any_value(count: int, monkeypatch: pytest.MonkeyPatch) -> None:
    tries(count)(given(options())(lambda words: check_options(words, monkeypatch)))()


def test_the_good_files_are_good(spoiling: Path, good: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without this every case above might fail for one and the same reason."""
    for path in good.iterdir():
        (spoiling / path.name).write_bytes(path.read_bytes())
    assert ended(["navigate", "--no-video", "--scenario", "scenario.yaml", "--out", "out"], monkeypatch)[0] is None
    assert ended(["map", "show", "room.yaml", "--out", "map.png"], monkeypatch)[0] == 0
    assert ended(["object", "add", "chair.obj", "--mass", "4", "--friction", "0.4"], monkeypatch)[0] == 0
    assert math.isfinite(LONGEST)
