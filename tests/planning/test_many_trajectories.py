"""Paths and local trajectories over many random problems: optimal, safe, within limits, and followed by the plant."""

from __future__ import annotations

from pathlib import Path as FilePath

import numpy as np
import pytest
from scipy import ndimage
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra

from shmoo_mjx.behavior import drive
from shmoo_mjx.planning import flat_qp, flat_trajectory, maps, paths
from shmoo_mjx.planning.distance_field import DistanceField
from shmoo_mjx.planning.flat_model import FlatModel
from shmoo_mjx.planning.flat_qp import TrajectoryConfig
from shmoo_mjx.planning.line_costs import PathConfig
from shmoo_mjx.planning.maps import OCCUPIED, OccupancyGrid
from shmoo_mjx.planning.paths import Path, plan_path
from shmoo_mjx.plant.robot import shmoobot

REAL_MAPS = sorted((FilePath(__file__).resolve().parents[3] / "shared" / "maps").glob("*/*.yaml"))
MODEL = FlatModel(*shmoobot().flatness)
PLANNER = flat_qp.init(MODEL, TrajectoryConfig(robot_radius=0.24))


def world(rng: np.random.Generator) -> tuple[OccupancyGrid, DistanceField]:
    """6 x 5 m with walls and a few blocks."""
    cells = np.zeros((100, 120), dtype=np.int8)
    cells[[0, -1], :] = cells[:, [0, -1]] = OCCUPIED
    for _ in range(rng.integers(2, 7)):
        row, col, high, wide = rng.integers((5, 5, 3, 3), (85, 105, 25, 25))
        cells[row : row + high, col : col + wide] = OCCUPIED
    grid = OccupancyGrid(cells, 0.05)
    return grid, maps.distance_field(grid)


def problem(rng: np.random.Generator) -> tuple[np.ndarray, Path, DistanceField] | None:
    """(flat state, path, field): somewhere near the start of a path, moving and leaning within limits."""
    grid, field = world(rng)
    room = np.argwhere(field.values > 0.35)
    start, goal = grid.cell_to_world(room[rng.integers(len(room), size=2)])
    path = plan_path(grid, start, goal, robot_radius=0.26, wall_clearance=field)
    if path is None or path.length < 0.5:
        return None
    angle = rng.uniform(-np.pi, np.pi, 2)
    velocity = rng.uniform(0.0, 0.3) * np.array([np.cos(angle[0]), np.sin(angle[0])])
    lean = rng.uniform(0.0, 0.03) * np.array([np.cos(angle[1]), np.sin(angle[1])])
    return MODEL.flat_state(start, velocity, lean, np.zeros(2)), path, field


def check_many(count: int) -> float:
    """Solves ``count`` problems; every answer keeps its limits or says why there is none. Share of answers."""
    rng, cfg = np.random.default_rng(0), PLANNER.cfg
    answered = tried = 0
    times = np.linspace(0.0, cfg.horizon, 200)
    while tried < count:
        drawn = problem(rng)
        if drawn is None:
            continue
        tried += 1
        state, path, field = drawn
        found = flat_trajectory.plan(PLANNER, state, path, field)
        if not found.ok:
            assert found.reason and np.isfinite(found.control_points).all()
            continue
        answered += 1
        at = flat_trajectory.evaluate(found, times)
        lean, speed = np.linalg.norm(at.lean, axis=1), np.linalg.norm(at.velocity, axis=1)
        assert lean.max() <= max(1.05 * (cfg.lean_recovery if found.recovery else cfg.lean_max), lean[0])
        assert found.recovery or speed.max() <= 1.05 * cfg.speed_max
        room = field.at(at.position)
        assert room.min() >= min(cfg.robot_radius, room[0]) - 0.5 * float(field.resolution) - 1e-9
        assert speed[-1] < 1e-3 and lean[-1] < 1e-3
    return answered / count


def test_trajectories_keep_their_limits_in_random_problems() -> None:
    assert check_many(60) > 0.85


@pytest.mark.slow
def test_trajectories_keep_their_limits_in_1000_random_problems() -> None:
    assert check_many(1000) > 0.85


def test_infeasible_problems_are_answered_as_such() -> None:
    _, field = world(np.random.default_rng(1))
    wild = MODEL.flat_state([2.0, 2.0], [3.0, 0.0], [0.6, 0.0], [0.0, 0.0])
    path = Path(np.array([[2.0, 2.0], [4.0, 2.0]]), 2.0)
    found = flat_trajectory.plan(PLANNER, wild, path, field)
    assert not found.ok and "no trajectory keeps the limits from a speed of" in found.reason


def shortest(grid: OccupancyGrid, start: np.ndarray, goal: np.ndarray, radius: float) -> float:
    """Length [m] of the shortest 8-connected path over cells with ``radius`` to spare, by Dijkstra: slow and exact."""
    free = maps.obstacle_distance(grid) >= radius
    index = np.where(free, np.arange(free.size).reshape(free.shape), -1)
    rows, cols, lengths = [], [], []
    for move in ((0, 1), (1, 0), (1, 1), (1, -1)):
        here = index[: index.shape[0] - move[0], max(0, -move[1]) : index.shape[1] - max(0, move[1])]
        there = index[move[0] :, max(0, move[1]) : index.shape[1] + min(0, move[1])]
        both = (here >= 0) & (there >= 0)
        rows.append(here[both])
        cols.append(there[both])
        lengths.append(np.full(both.sum(), np.hypot(*move) * grid.resolution))
    graph = csr_matrix((np.concatenate(lengths), (np.concatenate(rows), np.concatenate(cols))), shape=(free.size,) * 2)
    ends = [index[tuple(grid.world_to_cell(p))] for p in (start, goal)]
    return float(dijkstra(graph, directed=False, indices=ends[0])[ends[1]])


@pytest.mark.parametrize("seed", range(6))
def test_paths_are_no_longer_than_an_exact_search_finds(seed: int) -> None:
    rng = np.random.default_rng(seed)
    grid, field = world(rng)
    room = np.argwhere(field.values >= 0.26)
    for start, goal in grid.cell_to_world(room[rng.integers(len(room), size=(8, 2))]):
        exact = shortest(grid, start, goal, 0.26)
        path = plan_path(grid, start, goal, robot_radius=0.26, cfg=PathConfig(soft_weight=0.0), wall_clearance=field)
        assert (path is None) == (not np.isfinite(exact))
        if path is not None:
            # Pulled straight, a path is shorter than any of eight directions; it is never shorter than the air line.
            assert np.linalg.norm(goal - start) - 1e-9 <= path.length <= exact + 0.02


@pytest.mark.slow
@pytest.mark.parametrize("file", REAL_MAPS or [None], ids=lambda f: "none" if f is None else f.parent.name)
def test_a_hundred_paths_across_each_real_map(file: FilePath | None) -> None:
    if file is None:
        pytest.skip("real maps are not in shared/maps beside the repository")
    grid = maps.load_map(file)
    field = maps.distance_field(grid)
    labels, _ = ndimage.label(field.values > 0.27)
    room = np.argwhere(labels == np.bincount(labels.ravel())[1:].argmax() + 1)
    rng = np.random.default_rng(0)
    for start, goal in grid.cell_to_world(room[rng.integers(len(room), size=(100, 2))]):
        path = plan_path(grid, start, goal, robot_radius=0.26, wall_clearance=field)
        assert path is not None
        along = paths.point_at(path, np.arange(0.0, path.length, 0.05))
        assert field.at(along).min() >= 0.26 - 0.5 * grid.resolution


@pytest.mark.slow
def test_the_plant_follows_a_path_round_a_corner() -> None:
    """Largest distance of the driven path from the global one, which the local trajectory may cut, and at the end."""
    from shmoo_mjx.geometry.hands import TUCKED_HEIGHT, TUCKED_REACH
    from shmoo_mjx.plant.engine_mujoco import MujocoEngine
    from shmoo_mjx.plant.scene import build_scene
    from shmoo_mjx.types import Command

    grid = OccupancyGrid(np.zeros((100, 100), dtype=np.int8), 0.05)
    grid.cells[:2] = grid.cells[-2:] = grid.cells[:, :2] = grid.cells[:, -2:] = OCCUPIED
    path = Path(np.array([[1.0, 1.0], [3.5, 1.0], [3.5, 3.5]]), 5.0)
    field = maps.distance_field(grid)
    engine = MujocoEngine([build_scene([], (1.0, 1.0, 0.0))])
    state, body = drive.init(), engine.init()
    seen = engine.observe(body)
    off, tracking = [], []
    while float(seen.time[0]) < 22.0:
        state, lean = drive.follow(PLANNER, state, seen, path, clearance=lambda: field)
        yaw = drive.yaw_ahead(seen, path)
        u = np.array([[*lean, 0.0]])
        body, seen = engine.step(body, Command(u, np.array([yaw]), np.array([TUCKED_REACH]), np.array([TUCKED_HEIGHT])))
        here = seen.robot_pose[0, :2]
        off.append(float(np.linalg.norm(paths.point_at(path, paths.project(path, here)) - here)))
        if state.trajectory is not None:
            wanted = flat_trajectory.evaluate(state.trajectory, float(seen.time[0]) - state.start)
            tracking.append(float(np.linalg.norm(wanted.position - here)))
    assert not engine.fallen(body)[0]
    assert np.linalg.norm(seen.robot_pose[0, :2] - path.points[-1]) < 0.10
    print(f"end {np.linalg.norm(seen.robot_pose[0, :2] - path.points[-1]):.3f} m, off the path {max(off):.3f} m")
    print(f"off the trajectory: rms {np.sqrt(np.mean(np.square(tracking))):.3f} m, max {max(tracking):.3f} m")
    assert max(off) < 0.25
    assert np.sqrt(np.mean(np.square(tracking))) < 0.05 and max(tracking) < 0.12
