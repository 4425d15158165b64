"""Real pushes: reading, outline, quasi-static model, and the experiment on pushes made here with a known law."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest

from shmoo_mjx.data import real_pushes
from shmoo_mjx.errors import ShmooError
from shmoo_mjx.evaluation import push_outline, push_physics, real_pushing
from shmoo_mjx.evaluation.real_pushing import RealPushing
from shmoo_mjx.evaluation.registry import run_experiment
from shmoo_mjx.evaluation.result import ExperimentOptions
from shmoo_mjx.geometry import se2

SQUARE = np.array([[-0.05, -0.04], [0.05, -0.04], [0.05, 0.04], [-0.05, 0.04]])
RADIUS = 0.00475
SHARED = Path(__file__).parents[2] / ".." / "shared" / "data"


def starts(rng: np.random.Generator, corners: np.ndarray, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Tips that just touch the outline, and the inward normal there."""
    face = rng.integers(len(corners), size=n)
    edge = np.roll(corners, -1, axis=0)[face] - corners[face]
    outward = np.stack([edge[:, 1], -edge[:, 0]], axis=1) / np.linalg.norm(edge, axis=1)[:, None]
    return corners[face] + edge * rng.uniform(0.02, 0.98, (n, 1)) + RADIUS * outward, -outward


def make(directory: Path, pushes: int = 60) -> Path:
    """A folder of the layout: three shapes on two surfaces, pushed by the quasi-static model with other parameters."""
    rng = np.random.default_rng(0)
    shapes = {
        "box": SQUARE,
        "wide": SQUARE * [1.4, 0.8],
        "tri": np.array([[-0.05, -0.04], [0.07, -0.04], [-0.05, 0.07]]),
    }
    rows = []
    for surface, friction in (("smooth", 0.15), ("rough", 0.3)):
        for shape, corners in shapes.items():
            start, inward = starts(rng, corners, pushes)
            end = start + 0.03 * se2.rotate(inward, rng.uniform(-0.8, 0.8, pushes))
            change = [rng.normal(0, 0.1), np.log(friction / 0.2), 0.0, 0.0, *rng.normal(0, 0.04, 2), 0.0]
            law = push_physics.NOMINAL + np.array(change)
            motion = push_physics.push(start, end, corners, RADIUS, parameters=law[None])[0]
            pose = np.concatenate([rng.normal(0, 0.1, (pushes, 2)), rng.uniform(-3, 3, (pushes, 1))], axis=1)
            after = se2.compose(pose, motion)
            guess = after + rng.normal(0, 0.004, after.shape)
            tips = [se2.transform_point(pose, p) for p in (start, end)]
            numbers = np.concatenate([np.full((pushes, 1), 10.0), pose, after, *tips, guess, guess], axis=1)
            rows += [[surface, shape, *map(float, line)] for line in numbers]
    names = ["obj_x0", "obj_y0", "obj_th0", "obj_x1", "obj_y1", "obj_th1", "tip_x0", "tip_y0", "tip_x1", "tip_y1"]
    models = [f"pred_{m}_{a}1" for m in ("quad", "poly4") for a in ("x", "y", "th")]
    (directory / "mit_push").mkdir(parents=True)
    with (directory / "mit_push" / "pushes_heldout_with_model_pred.csv").open("w", newline="") as file:
        csv.writer(file).writerows([["surface", "shape", "vel_mm_s", *names, *models], *rows])
    return directory


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make(tmp_path_factory.mktemp("pushes"))


def test_motion_does_not_depend_on_the_room(folder: Path) -> None:
    condition = real_pushes.load(folder)["mit_push"]["rough/box"]
    assert np.abs(push_outline.contact(condition.start, SQUARE).distance - RADIUS).max() < 1e-9
    assert real_pushing.errors(condition.published["poly4"], condition.motion)[0] == pytest.approx(5.0, abs=1.0)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("tip_x0", "tip_start", "has no column 'tip_x0'"),
        ("smooth,box,10.0,", "smooth,box,10.0,nan", "line 2, obj_x0"),
        ("smooth,box,10.0,", "smooth,box,10.0,?", "line 2, obj_x0"),
    ],
)
def test_says_what_is_wrong_with_a_file(folder: Path, tmp_path: Path, old: str, new: str, said: str) -> None:
    text = (folder / "mit_push" / "pushes_heldout_with_model_pred.csv").read_text()
    bad = tmp_path / "mit_push" / "pushes_heldout_with_model_pred.csv"
    bad.parent.mkdir()
    bad.write_text(text.replace(old, new, 1))
    with pytest.raises(ShmooError, match=said):
        real_pushes.load(tmp_path)


def test_says_what_is_missing(tmp_path: Path) -> None:
    with pytest.raises(ShmooError, match="holds neither mit_push"):
        real_pushes.load(tmp_path)
    with pytest.raises(ShmooError, match="--data"):
        run_experiment("real_pushing", ExperimentOptions(out=tmp_path))


def test_outline_from_noisy_touches() -> None:
    rng = np.random.default_rng(1)
    touched = starts(rng, SQUARE, 120)[0] + rng.normal(0, 3e-4, (120, 2))
    corners = push_outline.estimate(touched, RADIUS)
    # A right angle may lose its corner to a short face, but no more than the pusher could hide.
    assert np.abs(push_outline.contact(SQUARE, corners).distance).max() < RADIUS
    assert push_outline.size(corners) == pytest.approx(push_outline.size(SQUARE), rel=0.02)


def test_alignment_undoes_a_new_marker() -> None:
    rng = np.random.default_rng(2)
    other, moved = starts(rng, SQUARE, 200)[0], np.array([2e-3, -1e-3, 0.04])
    touched = se2.transform_point(moved, starts(rng, SQUARE, 40)[0])
    aligned = push_outline.align(other, touched)
    assert np.abs(aligned - se2.transform_point(moved, other)).max() < 5e-4


def test_push_through_the_centre_of_friction_does_not_turn() -> None:
    start, end = np.array([[-0.05 - RADIUS, 0.0]]), np.array([[-0.02 - RADIUS, 0.0]])
    motion = push_physics.push(start, end, SQUARE, RADIUS, parameters=push_physics.NOMINAL[None])[0, 0]
    assert motion == pytest.approx([0.03, 0.0, 0.0], abs=1e-4)


def test_pushes_are_equivariant_and_never_end_inside() -> None:
    rng = np.random.default_rng(3)
    start, inward = starts(rng, SQUARE, 50)
    end = start + 0.03 * se2.rotate(inward, rng.uniform(-1, 1, 50))
    motion = push_physics.push(start, end, SQUARE, RADIUS, parameters=push_physics.NOMINAL[None])[0]
    final = push_outline.contact(se2.inverse_transform_point(motion, end), SQUARE)
    assert final.distance.min() > RADIUS - 1e-3
    flip, law = np.array([1, -1]), push_physics.NOMINAL[None]
    mirrored = push_physics.push(start * flip, end * flip, SQUARE, RADIUS, parameters=law)[0]
    assert np.allclose(mirrored, motion * [1, -1, -1], atol=1e-6)


def test_identifies_the_law_that_made_the_pushes() -> None:
    rng = np.random.default_rng(4)
    start, inward = starts(rng, SQUARE, 60)
    end = start + 0.03 * se2.rotate(inward, rng.uniform(-1, 1, 60))
    law = push_physics.NOMINAL + np.array([0.2, -0.3, 0.0, 0.0, 0.08, -0.05, 0.0])
    motion = push_physics.push(start, end, SQUARE, RADIUS, parameters=law[None])[0]
    motion[0, 2] += 1.5  # a lost pose must not matter
    found = push_physics.identify(start, end, motion, corners=SQUARE, radius=RADIUS)
    assert np.abs((found - law) / push_physics.SPREAD).max() < 0.35


def test_outcomes_of_scored_pushes_are_never_used(folder: Path) -> None:
    condition = real_pushes.load(folder)["mit_push"]["rough/tri"]
    known = np.arange(12)
    spoilt = condition.motion.copy()
    spoilt[12:] += 1.0
    touch = condition.touch.copy()
    touch[12:] += 1.0
    whole = real_pushing.fit(condition, known)
    other = real_pushing.fit(condition._replace(motion=spoilt, touch=touch), known)
    assert all(np.array_equal(a, b) for a, b in zip(whole, other, strict=True))


@pytest.mark.slow
def test_experiment_beats_the_poor_guess_and_resumes(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    options, config = ExperimentOptions(quick=True, data=folder, out=tmp_path), RealPushing(seeds=1, workers=1)
    result = run_experiment("real_pushing", options, config)
    metrics = result.metrics
    assert len(result.rows) == 12 and (tmp_path / "real_pushing" / "real_pushing.png").is_file()
    assert metrics["pos_error_mm"] < 0.5 * metrics["published_pos_error_mm"]
    # Twelve pushes show the outline of an unknown shape roughly.
    assert metrics["shape_out_pos_error_mm"] < 0.5 * metrics["shape_out_linear_pos_error_mm"]
    assert all(row["adapted_on"] == 12 and row["scored"] == 48 for row in result.rows)
    shape_out = [row for row in result.rows if row["trial"].endswith("shape_out")]
    assert all(not name.endswith(row["condition"].split("/")[1]) for row in shape_out for name in row["trained_on"])
    monkeypatch.delattr(real_pushing, "fit")  # a trial done again would need it
    assert run_experiment("real_pushing", options, config).metrics == metrics


@pytest.mark.skipif(not (SHARED / "mit_push").is_dir(), reason="the recorded pushes are not beside the repository")
def test_published_predictions_score_as_published() -> None:
    data = real_pushes.load(SHARED)["mit_push"]
    best = np.mean([real_pushing.errors(c.published["poly4"], c.motion) for c in data.values()], axis=0)
    still = np.mean([real_pushing.errors(np.zeros_like(c.motion), c.motion) for c in data.values()], axis=0)
    assert sum(len(c.start) for c in data.values()) == 3708
    assert best == pytest.approx([2.95, 3.75], abs=0.01) and still == pytest.approx([19.67, 12.29], abs=0.01)
