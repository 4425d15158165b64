"""Generated scenarios: each is what its kind says, checked with the path planner alone."""

from __future__ import annotations

from functools import cache
from pathlib import Path as FilePath

import numpy as np
import pytest
import shapely
from toy import toy_scenario

from shmoo_mjx.errors import ShmooError
from shmoo_mjx.evaluation.navigation_places import find_maps
from shmoo_mjx.evaluation.scenarios import (
    KINDS,
    Generated,
    Kind,
    ScenarioConfig,
    Truth,
    _fits,
    _Placed,
    _Site,
    draw_scenario,
    entry_of,
)
from shmoo_mjx.navigation.floorplan import draw_floorplan
from shmoo_mjx.navigation.footprints import footprint_polygon, footprints_free, wall_distance
from shmoo_mjx.navigation.maps import FREE, OCCUPIED, OccupancyGrid, clearance_field, load_map
from shmoo_mjx.navigation.paths import Path, plan_path
from shmoo_mjx.navigation.scenario import ROBOT_RADIUS, check_scenario
from shmoo_mjx.plant.condition import Condition
from shmoo_mjx.plant.objects import draw_condition

CFG = ScenarioConfig(path=(3.0, 10.0))
REAL_MAPS = FilePath(__file__).resolve().parents[3] / "shared" / "maps"


def moves(condition: Condition, side: int) -> bool:
    """A quick stand-in for the plant's truth."""
    return condition.total_mass < 60.0 and condition.friction < 1.5 and sum(condition.locked) < 2


@cache
def drawn(kind: Kind, seed: int) -> tuple[OccupancyGrid, Generated]:
    rng = np.random.default_rng(seed)
    grid = draw_floorplan(rng).grid
    return grid, draw_scenario(grid, kind, rng, 1_000_000, Truth(moves), CFG)


def way(grid: OccupancyGrid, found: Generated, without: tuple[int, ...] = ()) -> Path | None:
    return plan_path(
        grid, found.scenario.start, found.scenario.goal, [p for i, p in enumerate(shapes(found)) if i not in without],
        ROBOT_RADIUS,
    )  # fmt: skip


def shapes(found: Generated) -> list[shapely.Polygon]:
    entries = found.scenario.objects
    return [footprint_polygon(o.pose, draw_condition(o.family, o.seed, o.properties).half_extents) for o in entries]


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("kind", KINDS)
def test_a_scenario_is_of_its_kind(kind: Kind, seed: int) -> None:
    grid, found = drawn(kind, seed)
    assert found.kind == kind
    around = way(grid, found)
    movable = tuple(i for i, m in enumerate(found.movable) if m)
    if kind == "push only":
        assert around is None and found.detour is None
        # Movable objects out of the way, there is one.
        assert movable and way(grid, found, movable) is not None
    else:
        assert around is not None and around.length == pytest.approx(found.detour, abs=0.05)
        assert around.length >= found.shortest + CFG.blocked - 0.05
    blocking = [m for m, b in zip(found.movable, found.blocking, strict=True) if b]
    assert any(blocking) == (kind != "detour only")


@pytest.mark.parametrize("kind", KINDS)
def test_objects_stand_free_and_the_scenario_is_sound(kind: Kind) -> None:
    grid, found = drawn(kind, 0)
    check_scenario(grid, found.scenario, ROBOT_RADIUS)
    assert 1 <= len(found.scenario.objects) <= CFG.objects
    walls = clearance_field(grid)
    for shape, entry in zip(shapes(found), found.scenario.objects, strict=True):
        half = draw_condition(entry.family, entry.seed, entry.properties).half_extents
        assert footprints_free(walls, np.array(entry.pose), half)[0]
        assert shape.distance(shapely.Point(found.scenario.start[:2])) > ROBOT_RADIUS
    parts = shapes(found)
    assert all(a.distance(b) > 0 for i, a in enumerate(parts) for b in parts[:i])


def test_no_corner_of_a_wall_reaches_into_an_object() -> None:
    """It may lie between the points at which the clearance is looked up, above all in coarse maps."""
    cells = np.zeros((30, 30), np.int8)
    cells[15, 15] = OCCUPIED
    grid = OccupancyGrid(cells, 0.25)
    walls, rng, box = clearance_field(grid), np.random.default_rng(0), draw_condition("box", 0)
    ends = np.array([0.5, 0.5]), np.array([7.0, 7.0])
    path = plan_path(grid, *ends, field=walls)
    assert path is not None
    site = _Site(grid, walls, rng, iter(()), Truth(moves), CFG, *ends, path)
    poses = rng.uniform((3, 3, -np.pi), (5, 5, np.pi), (1000, 3))
    placed = [_Placed(box, pose, True, True) for pose in poses]
    clear = np.array([wall_distance(grid, p.polygon, 0.0) > 0 for p in placed])
    looked_up = footprints_free(walls, poses, box.half_extents, wall_clearance=CFG.margin)
    assert (looked_up & ~clear).any()
    fits = np.array([_fits(site, p) for p in placed])
    assert fits.any() and not (fits & ~clear).any()


def test_same_seed_same_scenario() -> None:
    rng = np.random.default_rng(0)
    grid = draw_floorplan(rng).grid
    again = draw_scenario(grid, "either", rng, 1_000_000, Truth(moves), CFG)
    assert again == drawn("either", 0)[1] and again != drawn("either", 1)[1]


def test_what_the_plant_says_decides() -> None:
    rng = np.random.default_rng(0)
    grid = draw_floorplan(rng).grid
    with pytest.raises(ShmooError, match="no 'push only' scenario was found"):
        draw_scenario(
            grid, "push only", rng, 1_000_000, Truth(lambda c, s: False), ScenarioConfig(path=(3.0, 10.0), attempts=6)
        )


def test_a_map_without_a_narrow_place_is_refused() -> None:
    hall = OccupancyGrid(np.full((200, 200), FREE, np.int8), 0.05)
    with pytest.raises(ShmooError, match="give another map"):
        draw_scenario(hall, "either", np.random.default_rng(0), 1_000_000, Truth(moves), ScenarioConfig(attempts=5))


def test_an_entry_spells_out_every_property() -> None:
    condition = draw_condition("cart", 5, {"locked": [True, False, False, True]})
    entry = entry_of(condition, (1.0, 2.0, 0.3))
    assert draw_condition(entry.family, entry.seed, entry.properties) == condition


@pytest.mark.parametrize("doors", [1, 2])
def test_the_toy_scenario_blocks_one_of_its_doorways(doors: int) -> None:
    grid, scenario = toy_scenario(doors, movable=True)
    entry = scenario.objects[0]
    box = footprint_polygon(entry.pose, draw_condition(entry.family, entry.seed, entry.properties).half_extents)
    free = plan_path(grid, scenario.start, scenario.goal, [], ROBOT_RADIUS)
    around = plan_path(grid, scenario.start, scenario.goal, [box], ROBOT_RADIUS)
    assert free is not None and (around is None) == (doors == 1)
    assert around is None or around.length > free.length + 0.3


def test_what_is_near_the_border_is_kept_and_marked() -> None:
    rng = np.random.default_rng(0)
    grid = draw_floorplan(rng).grid
    found = draw_scenario(grid, "push only", rng, 1_000_000, Truth(moves, lambda c, s: c.total_mass > 0.0), CFG)
    assert found.border == (True,) * len(found.scenario.objects)
    assert not any(drawn("push only", 0)[1].border)


def test_scenarios_have_one_to_four_objects() -> None:
    counts = {len(drawn(kind, seed)[1].scenario.objects) for kind in KINDS for seed in range(2)}
    assert len(counts) >= 2 and max(counts) <= CFG.objects


@pytest.mark.slow
def test_every_real_map_has_room_for_a_detour() -> None:
    if not REAL_MAPS.is_dir():
        pytest.skip("real maps are not in shared/maps beside the repository")
    maps = find_maps(REAL_MAPS)
    assert len(maps) == 5
    for file in maps.values():
        grid = load_map(file)
        found = draw_scenario(grid, "detour only", np.random.default_rng(1), 1_000_000, Truth(moves))
        check_scenario(grid, found.scenario, ROBOT_RADIUS)
