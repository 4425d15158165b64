"""The drawn floor plans and demo scenes: what must be blocked is, what must be free is, for every seed."""

from __future__ import annotations

import numpy as np
import pytest
import shapely
from scipy import ndimage

from shmoo_mjx.evaluation.manipulable import manipulable
from shmoo_mjx.planning.floorplan import demo_scenario, draw_building, draw_floorplan, paper_scenario
from shmoo_mjx.planning.footprints import footprint_polygon, footprints_free
from shmoo_mjx.planning.maps import distance_field, occupied_rectangles
from shmoo_mjx.planning.paths import path_blocked_by, plan_path
from shmoo_mjx.planning.scenario import ObjectEntry, check_places, check_scenario

RADIUS = 0.25


def half_extents(entry: ObjectEntry) -> np.ndarray:
    size = entry.properties["size"]
    assert isinstance(size, list)
    return np.array(size[:2]) / 2


def footprint(entry: ObjectEntry) -> shapely.Polygon:
    return footprint_polygon(entry.pose, half_extents(entry))


@pytest.mark.parametrize("seed", range(50))
def test_the_way_is_blocked_until_the_box_is_moved(seed: int) -> None:
    grid, scenario = demo_scenario(seed)
    check_scenario(grid, scenario, RADIUS)
    check_places(grid, scenario, [tuple(half_extents(entry)) for entry in scenario.objects])
    box, chair = map(footprint, scenario.objects)
    field = distance_field(grid)

    def route(*obstacles: shapely.Polygon) -> float | None:
        path = plan_path(grid, scenario.start, scenario.goal, obstacles, robot_radius=RADIUS, wall_clearance=field)
        return None if path is None else path.length

    straight = plan_path(grid, scenario.start, scenario.goal, robot_radius=RADIUS, wall_clearance=field)
    assert straight is not None
    assert path_blocked_by(straight, box, RADIUS)[0] and path_blocked_by(straight, chair, RADIUS)[0]
    assert route(box) is None and route(box, chair) is None
    around = route(chair)
    assert around is not None and around > straight.length + 2.0


@pytest.mark.parametrize("seed", range(0, 50, 7))
def test_objects_stand_free_and_the_box_can_be_parked_ahead(seed: int) -> None:
    grid, scenario = demo_scenario(seed)
    field = distance_field(grid)
    for entry in scenario.objects:
        assert footprints_free(field, entry.pose, half_extents(entry)).all()
    box = scenario.objects[0]
    path = plan_path(grid, scenario.start, scenario.goal, robot_radius=RADIUS, wall_clearance=field)
    assert path is not None
    angle, distance = np.meshgrid(np.radians(np.arange(-40, 41, 5)), [0.7, 0.85, 1.0])
    steps = np.stack([distance * np.cos(angle), distance * np.sin(angle)], axis=-1).reshape(-1, 2)
    poses = np.concatenate([box.pose[:2] + steps, np.full((len(steps), 1), box.pose[2])], axis=1)
    assert (
        footprints_free(field, poses, half_extents(box), path.points, path_clearance=RADIUS, wall_clearance=0.02).sum()
        >= 3
    )


def test_same_seed_same_scene_and_seeds_differ() -> None:
    grid, scenario = demo_scenario(4)
    again, same = demo_scenario(4)
    assert (grid.cells == again.cells).all() and scenario == same
    assert len({demo_scenario(seed)[1].start for seed in range(10)}) == 10


def test_about_half_the_scenes_are_mirrored() -> None:
    above = [scenario.goal[1] > grid.bounds[3] / 2 for grid, scenario in map(demo_scenario, range(40))]
    assert 10 <= sum(above) <= 30


def test_doorways_are_open_and_as_wide_as_said() -> None:
    plan = draw_floorplan(np.random.default_rng(1))
    for door in (plan.entry, plan.near, plan.far):
        column = plan.grid.free[:, int(door.x / plan.grid.resolution)]
        row = int(door.y / plan.grid.resolution)
        gap = np.flatnonzero(~column)
        low, high = gap[gap < row].max(), gap[gap > row].min()
        assert (high - low - 1) * plan.grid.resolution == pytest.approx(door.width)
    assert len(occupied_rectangles(plan.grid)) == 9


@pytest.mark.parametrize("seed", range(4))
def test_every_room_of_a_building_can_be_reached(seed: int) -> None:
    grid = draw_building(np.random.default_rng(seed))
    _, rooms = ndimage.label(grid.free)
    _, reached = ndimage.label(np.asarray(distance_field(grid).values) > 0.40)
    assert rooms == 1 and reached == 1
    assert (draw_building(np.random.default_rng(seed)).cells == grid.cells).all()


@pytest.mark.parametrize("seed", range(3))
def test_the_papers_scene_has_its_box_and_its_wheelchair_and_they_are_what_it_says(seed: int) -> None:
    grid, scenario = paper_scenario(seed)
    check_places(grid, scenario, [tuple(half_extents(entry)) for entry in scenario.objects])
    box, chair = (entry.condition() for entry in scenario.objects)
    assert (box.family, box.total_mass) == ("box", 2.8)
    assert (chair.family, chair.total_mass, chair.locked) == ("wheelchair", 11.9, (True,) * 4)
    assert manipulable(box, 0) and not manipulable(chair, 0) and not manipulable(chair, 2)
