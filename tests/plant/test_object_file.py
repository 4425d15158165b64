"""Object files: what can't be an object is refused in one sentence that names the file and the field."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from subprocess import CompletedProcess
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from shmoo_mjx.errors import ShmooError
from shmoo_mjx.learning.contact_prior import true_values
from shmoo_mjx.plant.object_file import ObjectFile, read_object
from shmoo_mjx.plant.objects import draw_condition
from shmoo_mjx.plant.scene import build_scene

CORNERS = [[x, y, z] for x in (-0.25, 0.25) for y in (-0.2, 0.2) for z in (0.0, 0.7)]
GOOD: dict[str, Any] = {
    "schema": 1,
    "source": {"file": "crate.stl", "sha256": "0" * 64},
    "size": [0.5, 0.4, 0.7],
    "mass": 8.0,
    "friction": 0.4,
    "com": [0.0, 0.0, 0.35],
    "inertia_per_mass": [0.0542, 0.0617, 0.0342, 0.0, 0.0, 0.0],
    "hull": CORNERS,
    "feet": [[-0.24, -0.19], [-0.24, 0.19], [0.24, 0.19], [0.24, -0.19]],
    "wheels": "casters",
    "wheel_radius": 0.04,
    "rolling": 0.02,
    "swivel_friction": 0.05,
}


def _written(folder: Path, data: object) -> Path:
    path = folder / "crate.json"
    path.write_text(data if isinstance(data, str) else json.dumps(data))
    return path


def test_a_good_file_is_read_as_it_is_and_becomes_a_scene(tmp_path: Path) -> None:
    path = _written(tmp_path, GOOD)
    assert json.loads(json.dumps(read_object(path))) == GOOD
    build_scene([(draw_condition(str(path), 0), (1.0, 0.0, 0.0))])
    without_source = {key: value for key, value in GOOD.items() if key != "source"}
    assert read_object(_written(tmp_path, without_source))["mass"] == 8.0


@pytest.mark.parametrize("key", [key for key in GOOD if key != "source"])
def test_a_missing_key_is_named(tmp_path: Path, key: str) -> None:
    path = _written(tmp_path, {k: v for k, v in GOOD.items() if k != key})
    with pytest.raises(ShmooError, match=f"crate.json: '{key}' is missing"):
        draw_condition(str(path), 0)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"friction": "0.4"}, ("'friction'", "'0.4'", "without quotes")),
        ({"mass": True}, ("'mass'", "true")),
        ({"mass": None}, ("'mass'",)),
        ({"mass": float("nan")}, ("'mass'", "finite")),
        ({"mass": 1e9}, ("'mass'", "500")),
        ({"mass": [8.0]}, ("'mass'", "number")),
        ({"mass": 0.55}, ("'mass'", "wheels")),
        ({"friction": -0.4}, ("'friction'", "0.05")),
        ({"size": [0.5, 0.4]}, ("'size[2]'", "missing")),
        ({"size": [0.5, 0.4, 0.7, 1.0]}, ("'size'", "3 items")),
        ({"size": [500, 400, 700]}, ("'size[0]'", "2.5")),
        ({"com": [0.0, 0.0, 5.0]}, ("'com'", "outside the hull")),
        ({"com": [0.0, 0.0, -0.1]}, ("'com'", "outside the hull")),
        ({"com": [0.245, 0.0, 0.35]}, ("'com'", "topple")),
        ({"com": "middle"}, ("'com'", "list")),
        ({"inertia_per_mass": [0.0542, 0.0617, -0.03, 0, 0, 0]}, ("'inertia_per_mass'",)),
        ({"inertia_per_mass": [0.01, 0.01, 0.03, 0, 0, 0]}, ("'inertia_per_mass'",)),
        ({"inertia_per_mass": [0.05, 0.06, 0.03, 0.06, 0, 0]}, ("'inertia_per_mass'",)),
        ({"inertia_per_mass": [0.54, 0.61, 0.34, 0, 0, 0]}, ("'inertia_per_mass'", "divided by the mass")),
        ({"inertia_per_mass": [0.0542, 0.0617, 0.0342]}, ("'inertia_per_mass[3]'", "missing")),
        ({"hull": []}, ("'hull'", "at least 4")),
        ({"hull": CORNERS[::2]}, ("'hull'", "volume")),
        ({"hull": [[2 * x, y, z] for x, y, z in CORNERS]}, ("'hull'", "'size'")),
        ({"hull": [[0, 0]] * 8}, ("'hull[0][2]'",)),
        ({"feet": []}, ("'feet'", "at least 3")),
        ({"feet": [[0.1, 0.1], [0.2, 0.1]]}, ("'feet'", "at least 3")),
        ({"feet": [[-0.2, 0], [0, 0], [0.2, 0]]}, ("'com'", "feet", "topple")),
        ({"feet": [[-2, -2], [-2, 2], [2, 2]]}, ("'feet'", "below")),
        ({"feet": [[0.0] * 3] * 4}, ("'feet[0]'", "2 items")),
        ({"wheels": "four"}, ("'wheels'", "casters")),
        ({"wheel_radius": 0.3}, ("'wheel_radius'", "half")),
        ({"rolling": 3}, ("'rolling'", "0.5")),
        ({"schema": 2}, ("'schema'",)),
        ({"colour": "red"}, ("'colour'", "not a known key")),
        ({"frction": 0.4}, ("'frction'", "did you mean 'friction'?")),
        ({"source": "me"}, ("'source'",)),
    ],
)
def test_faults_are_said_in_one_sentence(tmp_path: Path, change: dict[str, Any], words: tuple[str, ...]) -> None:
    path = _written(tmp_path, GOOD | change)
    with pytest.raises(ShmooError) as error:
        draw_condition(str(path), 0)
    text = str(error.value)
    assert text.startswith(f"{path}: ") and all(word in text for word in words), text
    assert "\n" not in text and text.endswith((".", "?")) and "Value error" not in text


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "no object file"), ("[1, 2]", "no object file"), ("{", "no object file"), ("[" * 10**5, "no object file"),
        ('{"mass": 1, "mass": 2}', "'mass' stands twice"),
    ],
)  # fmt: skip
def test_what_is_no_object_file_is_said(tmp_path: Path, text: str, words: str) -> None:
    with pytest.raises(ShmooError, match=words):
        read_object(_written(tmp_path, text))
    with pytest.raises(ShmooError, match="no object file"):
        read_object(tmp_path)
    with pytest.raises(ShmooError, match=r"gone\.json: there is no such object file"):
        read_object(tmp_path / "gone.json")


def _inertia(points: np.ndarray, weights: np.ndarray) -> tuple[list[float], list[float]]:
    """Centre of mass and inertia per mass of point masses."""
    share = weights / weights.sum()
    com = share @ points
    r = points - com
    full = np.einsum("n,nij->ij", share, (r**2).sum(axis=1)[:, None, None] * np.eye(3) - r[:, :, None] * r[:, None])
    return com.tolist(), full[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]].tolist()


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(0.02, 1.0))
def test_every_distribution_of_mass_in_the_hull_is_accepted(seed: int, spread: float) -> None:
    rng = np.random.default_rng(seed)
    points = spread * rng.uniform((-0.2, -0.15, -0.3), (0.2, 0.15, 0.3), (12, 3)) + (0, 0, 0.35)
    com, inertia = _inertia(points, rng.uniform(0.1, 1.0, 12))
    ObjectFile.model_validate(GOOD | {"com": com, "inertia_per_mass": inertia})


def test_a_scenario_with_a_damaged_object_file_ends_with_one_sentence(
    shmoo: Callable[..., CompletedProcess[str]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for change in ({"friction": "0.4"}, {"com": [0, 0, 5]}, {"feet": []}):
        _written(tmp_path, GOOD | change)
        done = shmoo("view", "crate.json", "--no-window")
        assert done.returncode == 2 and done.stderr.startswith("shmoo: crate.json: '"), done.stderr
        assert done.stderr.count("\n") == 1


@pytest.mark.parametrize(("wheels", "coefficient"), [("none", 0.4), ("casters", 0.02)])
def test_its_true_friction_is_that_of_its_feet_or_wheels(wheels: str, coefficient: float, tmp_path: Path) -> None:
    crate = draw_condition(str(_written(tmp_path, GOOD | {"wheels": wheels})), 0, {"payload": 2.0})
    true = true_values(crate)
    weight = 9.81 * 10.0
    assert true["mass"] == pytest.approx(10.0, rel=0.05)
    assert true["friction_x"] == pytest.approx(coefficient * weight, rel=0.05) == true["friction_y"]
