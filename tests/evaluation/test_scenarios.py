"""Generated scenarios: the way round is as long as asked for, checked with the path planner alone."""

from __future__ import annotations

from functools import cache
from pathlib import Path as FilePath

import numpy as np
import pytest
import shapely
from toy import toy_scenario

from shmoo_mjx.errors import ShmooError
from shmoo_mjx.evaluation.certify import Attempt, Certificate
from shmoo_mjx.evaluation.navigation_places import find_maps
from shmoo_mjx.evaluation.scenarios import (
    EXTRAS,
    Extra,
    Generated,
    ScenarioConfig,
    _fits,
    _Placed,
    _Site,
    draw_scenario,
    entry_of,
)
from shmoo_mjx.planning.floorplan import draw_building
from shmoo_mjx.planning.footprints import footprint_polygon, footprints_free, wall_distance
from shmoo_mjx.planning.maps import FREE, OCCUPIED, OccupancyGrid, distance_field, load_map
from shmoo_mjx.planning.paths import Path, plan_path
from shmoo_mjx.planning.scenario import ROBOT_RADIUS, Scenario, check_scenario
from shmoo_mjx.plant.objects import draw_condition

CFG = ScenarioConfig()
REAL_MAPS = FilePath(__file__).resolve().parents[3] / "shared" / "maps"
SOME: tuple[Extra, ...] = ((1.0, 4.0), (8.0, 30.0), None)


def told(grid: OccupancyGrid, scenario: Scenario) -> Certificate:
    """A quick stand-in: the first object can be pushed out of the way if the scenario's seed is even."""
    way = {"object": 0, "face": 0, "lateral": 0.0, "steering": 0.0, "start": (0.0, 0.0, 0.0), "seconds": 30.0}
    result = "stuck" if scenario.seed % 2 else "free"
    attempt = Attempt.model_validate(way | {"result": result, "progress": 0.0 if scenario.seed % 2 else 0.9})
    return Certificate(attempts=(attempt,), round_s=None, reference_s=None, best=())


@cache
def drawn(extra: Extra, seed: int) -> tuple[OccupancyGrid, Generated]:
    rng = np.random.default_rng(seed)
    grid = draw_building(np.random.default_rng(1))
    return grid, draw_scenario(grid, extra, rng, 1_000_000, cfg=CFG, certifier=told)


def way(grid: OccupancyGrid, found: Generated, without: tuple[int, ...] = ()) -> Path | None:
    return plan_path(
        grid, found.scenario.start, found.scenario.goal, [p for i, p in enumerate(shapes(found)) if i not in without],
        robot_radius=ROBOT_RADIUS,
    )  # fmt: skip


def shapes(found: Generated) -> list[shapely.Polygon]:
    entries = found.scenario.objects
    return [footprint_polygon(o.pose, draw_condition(o.family, o.seed, o.properties).half_extents) for o in entries]


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("extra", SOME)
def test_the_way_round_is_as_long_as_asked_for(extra: Extra, seed: int) -> None:
    grid, found = drawn(extra, seed)
    around, pushes = way(grid, found), found.scenario.seed % 2 == 0
    assert found.movable[0] == pushes and found.blocking[0]
    if extra is None:
        assert around is None and found.extra is None
        assert found.kind == ("push only" if pushes else "unsolvable")
    else:
        assert around is not None and around.length == pytest.approx(found.detour, abs=0.05)
        assert found.extra is not None and extra[0] - 0.05 <= found.extra < extra[1] + 0.35
        assert found.kind == ("either" if pushes else "detour only")


def test_extra_lengths_are_even_in_their_logarithm_and_a_fifth_has_no_way_round() -> None:
    ranges = sorted(extra for extra in EXTRAS if extra is not None)
    assert ranges[0][0] == 1.0 and ranges[-1][1] == 60.0 and EXTRAS.count(None) / len(EXTRAS) == 0.2
    assert np.allclose([high / low for low, high in ranges], 60 ** (1 / len(ranges)), rtol=0.01)


@pytest.mark.parametrize("extra", SOME)
def test_objects_stand_free_and_the_scenario_is_sound(extra: Extra) -> None:
    grid, found = drawn(extra, 0)
    check_scenario(grid, found.scenario, ROBOT_RADIUS)
    assert 1 <= len(found.scenario.objects) <= CFG.objects
    walls = distance_field(grid)
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
    walls, rng, box = distance_field(grid), np.random.default_rng(0), draw_condition("box", 0)
    ends = np.array([0.5, 0.5]), np.array([7.0, 7.0])
    path = plan_path(grid, *ends, wall_clearance=walls)
    assert path is not None
    site = _Site(grid, walls, rng, iter(()), CFG, *ends, path)
    poses = rng.uniform((3, 3, -np.pi), (5, 5, np.pi), (1000, 3))
    placed = [_Placed(box, pose, True, True) for pose in poses]
    clear = np.array([wall_distance(grid, p.polygon, 0.0) > 0 for p in placed])
    looked_up = footprints_free(walls, poses, box.half_extents, wall_clearance=CFG.margin)
    assert (looked_up & ~clear).any()
    fits = np.array([_fits(site, p) for p in placed])
    assert fits.any() and not (fits & ~clear).any()


def test_same_seed_same_scenario() -> None:
    grid, first = drawn(SOME[0], 0)
    again = draw_scenario(grid, SOME[0], np.random.default_rng(0), 1_000_000, cfg=CFG, certifier=told)
    assert again == first and again != drawn(SOME[0], 1)[1]


def test_a_map_without_a_narrow_place_is_refused() -> None:
    hall = OccupancyGrid(np.full((200, 200), FREE, np.int8), 0.05)
    with pytest.raises(ShmooError, match="give another map"):
        draw_scenario(hall, None, np.random.default_rng(0), 1_000_000, cfg=ScenarioConfig(attempts=5), certifier=told)


def test_an_entry_spells_out_every_property() -> None:
    condition = draw_condition("cart", 5, {"locked": [True, False, False, True]})
    entry = entry_of(condition, (1.0, 2.0, 0.3))
    assert draw_condition(entry.family, entry.seed, entry.properties) == condition


@pytest.mark.parametrize("doors", [1, 2])
def test_the_toy_scenario_blocks_one_of_its_doorways(doors: int) -> None:
    grid, scenario = toy_scenario(doors, movable=True)
    entry = scenario.objects[0]
    box = footprint_polygon(entry.pose, draw_condition(entry.family, entry.seed, entry.properties).half_extents)
    free = plan_path(grid, scenario.start, scenario.goal, [], robot_radius=ROBOT_RADIUS)
    around = plan_path(grid, scenario.start, scenario.goal, [box], robot_radius=ROBOT_RADIUS)
    assert free is not None and (around is None) == (doors == 1)
    assert around is None or around.length > free.length + 0.3


def test_scenarios_have_one_to_four_objects() -> None:
    counts = {len(drawn(extra, seed)[1].scenario.objects) for extra in SOME for seed in range(3)}
    assert len(counts) >= 2 and max(counts) <= CFG.objects


@pytest.mark.slow
def test_every_real_map_has_room_for_a_detour() -> None:
    if not REAL_MAPS.is_dir():
        pytest.skip("real maps are not in shared/maps beside the repository")
    maps = find_maps(REAL_MAPS)
    assert len(maps) == 5
    for file in maps.values():
        grid = load_map(file)
        found = draw_scenario(grid, (1.0, 60.0), np.random.default_rng(1), 1_000_000, cfg=CFG, certifier=told)
        check_scenario(grid, found.scenario, ROBOT_RADIUS)
