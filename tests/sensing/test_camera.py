"""What the camera sees: field of view, range, and what stands in the way."""

from __future__ import annotations

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest

from shmoo_mjx.errors import ShmooError
from shmoo_mjx.plant.objects import draw_condition
from shmoo_mjx.plant.scene import build_scene
from shmoo_mjx.sensing.camera import Camera, Scenery, deviation, in_sight, near_walls, scenery_of
from shmoo_mjx.sensing.rays import cast, hidden
from shmoo_mjx.sensing.senses import PERFECT

EYE = (0.03, 0.0, 1.055)


def scenery(count: int = 1, walls: list[tuple[float, float, float, float, float]] | None = None) -> Scenery:
    """Boxes of 0.4 x 0.4 x 0.6 m and walls (x, y, yaw, half length, half width)."""
    given = np.array(walls or np.zeros((0, 5))).reshape(1, -1, 5)
    half, tops = np.full((1, count, 2), 0.2), np.full((1, count), 0.6)
    return Scenery(np.array([EYE]), half, tops, given[..., :3], given[..., 3:])


def sees(objects: list[tuple[float, float]], camera: Camera | None = None, yaw: float = 0.0, **given: object) -> list:
    poses = np.array([[(x, y, 0.0) for x, y in objects]])
    stage = scenery(len(objects), **given)  # type: ignore[arg-type]
    return in_sight(camera or Camera(), stage, np.array([[0.0, 0.0, yaw]]), poses)[0].tolist()


def test_scenery_has_the_models_own_numbers() -> None:
    box = draw_condition("box", 1)
    scene = build_scene([(box, (2.0, 0.0, 0.0))], walls=[(1.0, 2.0, 0.5, 0.1)], wall_yaw=0.3)
    bare = build_scene([(box, (2.0, 0.0, 0.0))])
    found = scenery_of([scene, bare])
    np.testing.assert_allclose(found.eye[0], EYE)
    np.testing.assert_allclose(found.wall_pose[0, 0], (1.0, 2.0, 0.3))
    np.testing.assert_allclose(found.wall_half[0, 0], (0.5, 0.1))
    assert found.wall_pose[1, 0, 0] > 1e5 and found.tops[0, 0] == box.size[2]


def test_field_of_view() -> None:
    assert sees([(2.0, 0.0)]) == [True]
    assert sees([(-2.0, 0.0)]) == [False]
    assert sees([(-2.0, 0.0)], yaw=np.pi) == [True]
    edge = np.deg2rad(34.5)
    corner = np.arctan(0.18 / 2.0)
    for share, expected in ((0.7, True), (1.5, False)):
        angle = edge + share * corner
        assert sees([(2 * np.cos(angle), 2 * np.sin(angle))]) == [expected]


def test_range() -> None:
    assert sees([(4.1, 0.0)]) == [True]  # its near tags are within 4 m
    assert sees([(4.3, 0.0)]) == [False]
    assert sees([(0.05, 0.0)]) == [False]
    # While the robot pushes, the tags beyond the near edge stay in range and in view.
    assert sees([(0.46 + 0.2, 0.0)]) == [True]


def test_a_wall_hides_although_it_is_low_and_another_object_if_it_is_high() -> None:
    behind = [(3.0, 0.0)]
    assert sees(behind, walls=[(1.5, 0.0, 0.0, 0.05, 1.0)]) == [False]
    assert sees(behind, walls=[(1.5, 1.0, 0.0, 0.05, 0.7)]) == [True]  # beside the line to one tag
    high = scenery(2)
    poses = np.array([[(3.0, 0.0, 0.0), (1.2, 0.0, 0.0)]])
    robot = np.zeros((1, 3))
    for top, expected in ((0.6, True), (0.9, False)):  # the camera looks over low ones, 1.05 m above the floor
        stage = high._replace(tops=np.array([[0.6, top]]), half_extents=np.array([[(0.2, 0.2), (0.2, 0.6)]]))
        assert in_sight(Camera(), stage, robot, poses)[0].tolist() == [expected, True]
    assert in_sight(PERFECT.camera, stage, robot, poses).all()


def test_an_object_does_not_hide_its_own_tags() -> None:
    tall = scenery(1)._replace(tops=np.array([[1.0]]))
    assert in_sight(Camera(), tall, np.zeros((1, 3)), np.array([[(1.0, 0.0, 0.0)]])).all()


def test_the_same_in_jax() -> None:
    rng = np.random.default_rng(0)
    worlds = 64
    half = rng.uniform(0.1, 0.4, (worlds, 3, 2))
    walls = rng.uniform(-3, 3, (worlds, 5, 3)), rng.uniform(0.05, 0.5, (worlds, 5, 2))
    stage = Scenery(np.tile(EYE, (worlds, 1)), half, rng.uniform(0.4, 0.9, (worlds, 3)), *walls)
    robot, objects = rng.uniform(-3, 3, (worlds, 3)), rng.uniform(-3, 3, (worlds, 3, 3))
    plain = in_sight(Camera(), stage, robot, objects)
    traced = in_sight(Camera(), stage, jnp.asarray(robot), jnp.asarray(objects))
    assert 0.05 < plain.mean() < 0.5
    assert np.mean(plain == np.asarray(traced)) > 0.99


def test_rays() -> None:
    poses, half = np.array([[(2.0, 0.0, np.pi / 4)]]), np.array([[(0.5, 0.5)]])
    rays = np.array([[(1.0, 0.0), (0.0, 1.0)]])
    np.testing.assert_allclose(cast(np.zeros((1, 2)), rays, poses, half, reach=9.0)[0], (2 - np.sqrt(0.5), 9.0))
    eye, point = np.array([[0.0, 0.0, 1.0]]), np.array([[(4.0, 0.0, 0.5)]])
    for top, expected in ((0.6, False), (0.7, True), (np.inf, True)):  # the line leaves the box at 0.66 m
        assert hidden(eye, point, poses, half, tops=np.array([[top]])).item() == expected


def test_noise_grows_with_distance_and_has_a_floor() -> None:
    found = deviation(Camera(), np.array([0.1, 0.75, 1.5, 3.0]))
    np.testing.assert_allclose(found[:, 0], (0.0015, 0.0025, 0.005, 0.010))
    np.testing.assert_allclose(np.rad2deg(found[:, 2]), (0.15, 0.25, 0.5, 1.0))


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("near", -0.1), ("far", 0.2), ("far", float("nan")), ("field_of_view", 7.0), ("field_of_view", 0.0),
        ("rate", 0.0), ("rate", -30.0), ("drop_out", 1.5), ("burst", -0.1), ("burst_time", -1.0),
        ("position_noise", -0.01), ("delay", (0.04, 0.02)),
    ],
)  # fmt: skip
def test_impossible_numbers_are_refused_in_one_sentence(field: str, value: object) -> None:
    with pytest.raises(ShmooError) as error:
        dataclasses.replace(Camera(), **{field: value})
    text = str(error.value)
    assert field in text and text.count(".\n") == 0 and text.endswith(".")


@pytest.mark.parametrize("worlds", [1, 2])
def test_walls_far_off_hide_nothing(worlds: int) -> None:
    rng, hidden_by_some = np.random.default_rng(worlds), False
    for _ in range(40):
        centre, walls = rng.uniform(-20, 20, (worlds, 2)), rng.integers(0, 300)
        pose = np.concatenate(
            [rng.uniform(-30, 30, (worlds, walls, 2)), rng.uniform(-3, 3, (worlds, walls, 1))], axis=-1
        )
        half = rng.uniform(0.02, 1.5, (worlds, walls, 2)) * rng.choice([0.05, 1.0], (worlds, walls, 2))
        full = Scenery(np.array([EYE] * worlds), np.full((worlds, 5, 2), 0.2), np.full((worlds, 5), 0.6), pose, half)
        robot = np.concatenate([centre, rng.uniform(-3, 3, (worlds, 1))], axis=-1)
        objects = np.concatenate(
            [centre[:, None] + rng.uniform(-4, 4, (worlds, 5, 2)), np.zeros((worlds, 5, 1))], axis=-1
        )
        few = near_walls(full, Camera(), robot)
        assert few.wall_pose.shape[1] in (0, 16, 64, 256)
        # As seen from where the robot is within a sample time.
        moved = robot + np.array([0.1, -0.1, 0.5])
        shown = in_sight(Camera(), full, moved, objects)
        np.testing.assert_array_equal(in_sight(Camera(), few, moved, objects), shown)
        bare = full._replace(wall_pose=pose[:, :0], wall_half=half[:, :0])
        hidden_by_some |= bool((in_sight(Camera(), bare, moved, objects) != shown).any())
    assert hidden_by_some
