"""Global paths: length against an exact reference, safety, and the questions asked about a path."""

from __future__ import annotations

import json
import pickle
from pathlib import Path as FilePath

import numpy as np
import pytest
import shapely
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st
from scipy import ndimage, sparse
from scipy.sparse.csgraph import dijkstra

from shmoo_mjx.planning import footprints, lattice, maps, path_search, paths
from shmoo_mjx.planning.footprints import footprint_polygon
from shmoo_mjx.planning.line_costs import DiscSpace, PathConfig, line_costs
from shmoo_mjx.planning.maps import FREE, OCCUPIED, UNKNOWN, OccupancyGrid
from shmoo_mjx.planning.paths import Path, plan_path

REAL_MAPS = FilePath(__file__).resolve().parents[3] / "shared" / "maps"
SHORTEST = PathConfig(soft_weight=0.0)


def random_grid(seed: int, shape: tuple[int, int] = (24, 30)) -> OccupancyGrid:
    rng = np.random.default_rng(seed)
    cells = np.where(rng.random(shape) < 0.04, OCCUPIED, FREE).astype(np.int8)
    cells[rng.random(shape) < 0.01] = UNKNOWN
    return OccupancyGrid(cells, 0.1, (-1.0, 2.0, 0.0))


def shortest_by_dijkstra(free: np.ndarray, goal: tuple[int, int], side: float) -> np.ndarray:
    """Length of the shortest 8-connected path to the goal from every cell, by SciPy's Dijkstra."""
    height, width = free.shape
    number = np.arange(free.size).reshape(free.shape)
    links = []
    for dr, dc in ((0, 1), (1, 0), (1, 1), (1, -1)):
        a = (slice(0, height - dr), slice(max(0, -dc), width - max(0, dc)))
        b = (slice(dr, height), slice(max(0, dc), width + min(0, dc)))
        both = free[a] & free[b]
        links.append((number[a][both], number[b][both], np.full(both.sum(), np.hypot(dr, dc) * side)))
    start, end, length = (np.concatenate(part) for part in zip(*links, strict=True))
    graph = sparse.csr_matrix((length, (start, end)), shape=(free.size, free.size))
    return dijkstra(graph, directed=False, indices=number[goal]).reshape(free.shape)


@pytest.mark.parametrize("seed", range(4))
def test_cost_to_go_equals_an_exact_search(seed: int) -> None:
    grid = random_grid(seed)
    free = maps.inflate(grid, 0.15)
    goal = tuple(np.argwhere(free)[len(np.argwhere(free)) // 3])
    found = paths.cost_to_go(grid, grid.cell_to_world(goal), robot_radius=0.15, cfg=SHORTEST)
    exact = shortest_by_dijkstra(free, goal, grid.resolution)
    assert np.isfinite(exact).sum() > 50
    np.testing.assert_allclose(found, exact, rtol=1e-6)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10**6))
def test_paths_are_safe_complete_and_not_longer_than_the_grid_allows(seed: int) -> None:
    grid, radius = random_grid(seed), 0.15
    rng = np.random.default_rng(seed)
    free = np.argwhere(maps.inflate(grid, radius + 0.1))
    assume(len(free) > 1)
    ends = free[rng.choice(len(free), 2, replace=False)]
    start, goal = grid.cell_to_world(ends)
    exact = shortest_by_dijkstra(maps.inflate(grid, radius), tuple(ends[1]), grid.resolution)[tuple(ends[0])]
    path = plan_path(grid, start, goal, robot_radius=radius, cfg=SHORTEST)
    assert (path is None) == np.isinf(exact)
    if path is None:
        return
    assert np.allclose(path.points[0], start) and np.allclose(path.points[-1], goal)
    assert np.linalg.norm(goal - start) - 1e-9 <= path.length <= exact * 1.003 + 1e-9
    steps = np.arange(0.0, path.length, 0.02)
    distance = maps.distance_field(grid).at(paths.point_at(path, steps))
    assert distance.min() >= radius - 0.5 * grid.resolution


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10**6))
def test_a_sparse_lattice_finds_a_way_exactly_where_the_cells_have_one(seed: int) -> None:
    """Blocks of three cells among clutter and obstacles: the answer to "is there a way" is that of all cells."""
    grid, radius = random_grid(seed, (36, 40)), 0.12
    rng = np.random.default_rng(seed)
    boxes = [
        footprint_polygon((*grid.cell_to_world(rng.uniform(0, 36, 2)), rng.uniform(-3, 3)), (0.3, 0.2))
        for _ in range(2)
    ]
    field = footprints.add_obstacles(maps.distance_field(grid), boxes)
    free = np.argwhere(field.values >= radius + 0.1)
    assume(len(free) > 1)
    ends = free[rng.choice(len(free), 2, replace=False)]
    exact = shortest_by_dijkstra(field.values >= radius, tuple(ends[1]), grid.resolution)[tuple(ends[0])]
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(lattice, "_POINTS", 1)
        path = plan_path(grid, *grid.cell_to_world(ends), boxes, robot_radius=radius, cfg=SHORTEST)
    assert (path is None) == np.isinf(exact)
    if path is None:
        return
    steps = np.arange(0.0, path.length, 0.02)
    assert field.at(paths.point_at(path, steps)).min() >= radius - 0.5 * grid.resolution
    line = shapely.LineString(path.points)
    assert min(line.distance(box) for box in boxes) >= radius - 0.5 * grid.resolution


def test_answers_do_not_depend_on_what_was_asked_before() -> None:
    grid = corridor()
    field, start, goal = maps.distance_field(grid), (1.0, 0.8), (7.0, 0.8)
    box = footprint_polygon((3.95, 1.5, 0.3), (0.2, 0.2))
    elsewhere = footprint_polygon((1.0, 3.0, 0.0), (0.2, 0.2))
    queries: list[list[shapely.Polygon]] = [[], [box], [elsewhere], [], [box, elsewhere], [box]]
    shared = [plan_path(grid, start, goal, obstacles, wall_clearance=field) for obstacles in queries]
    fresh = [plan_path(grid, start, goal, obstacles) for obstacles in queries]
    for one, other in zip(shared, fresh, strict=True):
        assert one is not None and other is not None
        np.testing.assert_allclose(one.points, other.points)
    assert shared[1] is not None and shared[0] is not None and shared[1].length > shared[0].length
    wider = plan_path(grid, start, goal, robot_radius=0.4, wall_clearance=field)
    assert wider is not None and field.at(paths.point_at(wider, np.linspace(0, wider.length, 200))).min() > 0.35


def corridor() -> OccupancyGrid:
    cells = np.zeros((40, 80), np.int8)
    cells[:, 38:41] = OCCUPIED
    cells[14:28, 38:41] = FREE  # a doorway 1.4 m wide, y from 1.4 to 2.8
    return OccupancyGrid(cells, 0.1)


def test_soft_cost_takes_the_middle_of_a_doorway() -> None:
    start, goal = (1.0, 0.8), (7.0, 0.8)
    soft = plan_path(corridor(), start, goal)
    taut = plan_path(corridor(), start, goal, cfg=SHORTEST)
    assert soft is not None and taut is not None and taut.length < soft.length

    def height_in_door(path: Path) -> float:
        return float(np.interp(3.95, path.points[:, 0], path.points[:, 1]))

    assert height_in_door(taut) == pytest.approx(1.65, abs=0.1)
    assert height_in_door(soft) > height_in_door(taut) + 0.1


def test_open_floor_gives_one_straight_line() -> None:
    path = plan_path(OccupancyGrid(np.zeros((60, 60), np.int8), 0.1), (1.0, 1.3), (4.6, 3.1))
    assert path is not None and len(path.points) == 2
    assert path.length == pytest.approx(np.hypot(3.6, 1.8))


def test_obstacles_unknown_cells_and_closed_doors_block() -> None:
    grid, start, goal = corridor(), (1.0, 2.0), (7.0, 2.0)
    box = footprint_polygon((3.95, 2.1, 0.3), (0.3, 0.3))
    assert plan_path(grid, start, goal, [box]) is None
    assert plan_path(grid, start, goal, [box], robot_radius=0.1) is not None
    cells = grid.cells.copy()
    cells[14:28, 39] = UNKNOWN
    assert plan_path(OccupancyGrid(cells, 0.1), start, goal) is None
    assert plan_path(grid, start, (50.0, 2.0)) is None
    assert plan_path(grid, start, (3.95, 0.5)) is None


def test_robot_too_near_a_wall_gets_out_but_not_through_a_gap(monkeypatch: pytest.MonkeyPatch) -> None:
    path = plan_path(corridor(), (3.65, 0.8), (1.0, 2.0))  # 0.15 m from the wall
    assert path is not None and path.length < 3.3
    box = footprint_polygon((3.95, 2.1, 0.0), (0.3, 0.45))  # leaves 0.25 m on either side
    beside = (3.45, 1.7)
    assert plan_path(corridor(), beside, (7.0, 2.0), [box]) is None
    assert plan_path(corridor(), beside, (1.0, 2.0), [box]) is not None
    monkeypatch.setattr(path_search, "_ESCAPE_RADIUS", 1.5)
    assert plan_path(corridor(), beside, (7.0, 2.0), [box]) is None


BEND = Path(np.array([[0.0, 0.0], [2.0, 0.0], [2.0, 3.0]]), 5.0)


def test_point_tangent_and_projection() -> None:
    assert np.allclose(
        paths.point_at(BEND, np.array([-1.0, 1.0, 3.5, 9.0])), [[0.0, 0.0], [1.0, 0.0], [2.0, 1.5], [2.0, 3.0]]
    )
    assert np.allclose(paths.tangent_at(BEND, np.array([0.0, 1.9, 2.1, 9.0])), np.eye(2)[[0, 0, 1, 1]])
    assert paths.project(BEND, (1.2, -0.5)) == pytest.approx(1.2)
    assert paths.project(BEND, (2.4, 1.0)) == pytest.approx(3.0)
    assert paths.project(BEND, (0.1, 0.1), after=2.5) == pytest.approx(2.5)
    assert paths.path_length(BEND.points) == 5.0


@settings(max_examples=40, deadline=None)
@given(st.floats(0, 5))
def test_projection_undoes_point_at(s: float) -> None:
    assert paths.project(BEND, paths.point_at(BEND, s)) == pytest.approx(s, abs=1e-9)


def test_a_path_is_blocked_where_the_disc_first_touches() -> None:
    box = footprint_polygon((2.0, 1.5, 0.0), (0.2, 0.3))
    blocked, s = paths.path_blocked_by(BEND, box, 0.25)
    assert blocked and s == pytest.approx(2.0 + 1.2 - 0.25, abs=1e-3)
    beside = footprint_polygon((1.0, 0.6, 0.0), (0.2, 0.3))
    assert paths.path_blocked_by(BEND, beside, 0.29) == (False, None)
    assert paths.path_blocked_by(BEND, beside, 0.31)[0]
    assert paths.path_blocked_by(BEND, beside, 0.31, after=2.0) == (False, None)


def test_footprints_are_checked_whole() -> None:
    grid = corridor()
    field = maps.distance_field(grid)
    half = (0.4, 0.2)
    places = [
        (1.0, 2.0, 0.0),  # open floor
        (3.55, 1.0, 0.0),  # its end is in the wall
        (3.55, 1.0, np.pi / 2),  # turned along the wall: free
        (3.95, 2.1, 0.0),  # in the doorway
        (3.95, 2.65, 0.0),  # a corner in the door post
        (0.3, 2.0, 0.0),  # off the map
    ]
    poses = np.array(places)
    assert footprints.footprints_free(field, poses, half).tolist() == [True, False, True, True, False, False]
    wide = footprints.footprints_free(field, poses, half, wall_clearance=0.25)
    assert wide.tolist() == [True, False, False, True, False, False]
    line = np.array([(0.0, 2.5), (8.0, 2.5)])
    near = footprints.footprints_free(field, poses, half, line, path_clearance=0.25)
    assert near.tolist() == [True, False, True, False, False, False]


@settings(max_examples=40, deadline=None)
@given(st.floats(0.2, 7.8), st.floats(0.2, 3.8), st.floats(-3, 3))
def test_footprint_check_agrees_with_exact_geometry(x: float, y: float, yaw: float) -> None:
    grid, half = corridor(), (0.45, 0.25)
    walls = [shapely.box(cx - hx, cy - hy, cx + hx, cy + hy) for cx, cy, hx, hy in maps.occupied_rectangles(grid)]
    body = footprint_polygon((x, y, yaw), half)
    outside = shapely.box(-9, -9, 99, 99).difference(shapely.box(*grid.bounds))
    gap = min(body.distance(shape) for shape in (*walls, outside))
    assume(not 0.0 < gap < 0.05)
    deep = body.intersection(shapely.union_all([*walls, outside])).area
    assume(gap > 0 or deep > 0.01)
    assert footprints.footprints_free(maps.distance_field(grid), (x, y, yaw), half)[0] == (gap > 0)


@settings(max_examples=20, deadline=None)
@given(st.floats(0.5, 7.5), st.floats(0.5, 3.5), st.floats(-3, 3))
def test_field_with_obstacle_is_the_distance_to_it(x: float, y: float, yaw: float) -> None:
    grid = OccupancyGrid(np.zeros((40, 80), np.int8), 0.1, (0.0, 0.0, 0.1))
    body = footprint_polygon((x, y, yaw), (0.3, 0.2))
    before = maps.distance_field(grid)
    after = footprints.add_obstacles(before, [body], reach=1.0)
    centres = grid.centres
    distance = shapely.distance(body, shapely.points(centres))
    near = distance < 1.0
    assert np.allclose(after.values[near], np.minimum(before.values, distance)[near])
    assert (after.values[~near] == before.values[~near]).all()


@settings(max_examples=40, deadline=None)
@example(0, 1e-8, 0.0)
@given(st.integers(0, 10**6), st.floats(0.0, 0.4), st.floats(-3, 3))
def test_distance_to_a_polygon_is_that_of_shapely(seed: int, margin: float, yaw: float) -> None:
    rng = np.random.default_rng(seed)
    convex = footprint_polygon((0.3, -0.2, yaw), rng.uniform(0.05, 1.0, 2))
    shapes = [convex, convex.buffer(margin), convex.reverse(), shapely.MultiPoint(rng.normal(size=(9, 2))).convex_hull]
    shapes.append(convex.union(footprint_polygon((0.3, -0.2, yaw + 0.7), (1.2, 0.1))))  # not convex
    points = rng.normal(0.0, 1.5, size=(60, 5, 2))
    for shape in shapes:
        exact = shapely.distance(shape, shapely.points(points))
        # Corners of rounded ones that are nanometres apart count as one.
        np.testing.assert_allclose(footprints.polygon_distance(shape, points), exact, atol=2e-8)


def test_fields_with_obstacles_are_remembered_and_never_mixed_up() -> None:
    field = maps.distance_field(corridor())
    box, other = (footprint_polygon((x, 2.0, 0.2), (0.3, 0.2)) for x in (1.5, 2.0))
    first = footprints.add_obstacles(field, [box])
    assert footprints.add_obstacles(field, [shapely.Polygon(box)]) is first
    assert not np.array_equal(footprints.add_obstacles(field, [other]).values, first.values)
    assert not np.array_equal(footprints.add_obstacles(field, [box], reach=0.5).values, first.values)
    with pytest.raises(ValueError, match="read-only"):
        first.values[0, 0] = 1.0
    writable = field._replace(values=np.array(field.values))
    assert footprints.add_obstacles(writable, [box]) is not footprints.add_obstacles(writable, [box])
    assert pickle.loads(pickle.dumps(field)).memo == {} and field.memo


REAL: list[FilePath | None] = [*sorted(REAL_MAPS.glob("*/*.yaml"))] or [None]


@pytest.mark.parametrize("file", REAL, ids=lambda f: "none" if f is None else f.parent.name)
def test_plans_across_real_maps(file: FilePath | None) -> None:
    if file is None:
        pytest.skip("real maps are not in shared/maps beside the repository")
    grid = maps.load_map(file)
    field = maps.distance_field(grid)
    labels, _ = ndimage.label(field.values > 0.3)
    largest = np.argwhere(labels == np.bincount(labels.ravel())[1:].argmax() + 1)
    start, goal = grid.cell_to_world(largest[[0, -1]])
    path = plan_path(grid, start, goal, wall_clearance=field)
    assert path is not None and path.length >= np.linalg.norm(goal - start)
    along = paths.point_at(path, np.arange(0.0, path.length, 0.05))
    assert field.at(along).min() >= 0.25


GOLDEN = json.loads((FilePath(__file__).parent / "golden_paths.json").read_text())


@pytest.mark.parametrize("name", sorted(GOLDEN))
def test_paths_on_real_maps_are_as_good_as_a_search_of_all_cells(name: str) -> None:
    """Lengths and costs that the search of every cell, with the same shortening, gave (30 random pairs a map)."""
    files = [*REAL_MAPS.glob(f"{name}/*.yaml")]
    if not files:
        pytest.skip("real maps are not in shared/maps beside the repository")
    grid = maps.load_map(files[0])
    field, pairs = maps.distance_field(grid), GOLDEN[name]
    lengths, costs = [], []
    for pair in pairs:
        path = plan_path(grid, pair["start"], pair["goal"], robot_radius=0.26, wall_clearance=field)
        assert path is not None
        assert field.at(paths.point_at(path, np.arange(0.0, path.length, 0.02))).min() >= 0.26 - 0.002
        cells = field.to_cells(path.points)
        costs.append(line_costs(cells[:-1], cells[1:], DiscSpace(field, 0.26, PathConfig()))[1].sum() / pair["cost"])
        lengths.append(path.length / pair["length"])
    assert np.mean(lengths) < 1.003 and max(lengths) < 1.03
    assert np.mean(costs) < 1.005 and max(costs) < 1.08
