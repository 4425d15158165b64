"""Robot, objects and walls in one model, addressed by name."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from shmoo_mjx.errors import ShmooError
from shmoo_mjx.geometry.hands import HAND_HEIGHT, REACH, TUCKED_HEIGHT, TUCKED_REACH
from shmoo_mjx.plant.engine_mujoco import MujocoEngine
from shmoo_mjx.plant.objects import draw_condition
from shmoo_mjx.plant.observe import toppled
from shmoo_mjx.plant.scene import PARTS, build_scene
from shmoo_mjx.plant.trials import command

OBJECTS = [
    (draw_condition("box", 1), (2.0, 0.0, 0.4)),
    (draw_condition("wheelchair", 0), (-2.0, 1.0, -1.0)),
    (draw_condition("cart", 2), (0.0, 2.5, 3.0)),
]
WALLS = [(0.0, -2.0, 3.0, 0.05), (3.5, 0.0, 0.05, 2.0)]


def test_everything_starts_where_it_was_put() -> None:
    scene = build_scene(OBJECTS, (0.5, -0.3, 2.0), WALLS)
    engine = MujocoEngine([scene])
    seen = engine.observe(engine.init())
    np.testing.assert_allclose(seen.robot_pose[0], (0.5, -0.3, 2.0), atol=1e-12)
    np.testing.assert_allclose(seen.object_pose[0], [pose for _, pose in OBJECTS], atol=1e-12)
    engine.close()


@pytest.mark.parametrize("pose", [(np.nan, 0.0, 0.0), (0.0, np.inf, 0.0), (1.0, 2.0)])
def test_a_pose_that_is_not_three_numbers_is_refused(pose: tuple[float, ...]) -> None:
    with pytest.raises(ShmooError, match="robot_pose"):
        build_scene(robot_pose=pose)
    with pytest.raises(ShmooError, match=r"objects\[1\]"):
        build_scene([OBJECTS[0], (OBJECTS[1][0], pose)])


def test_what_has_fallen_over_is_told_from_what_stands_or_has_turned() -> None:
    scene = build_scene(OBJECTS)
    qpos = np.tile(scene.qpos0, (2, 1))
    half = 0.5 * np.array([0.4, 1.0, 3.0])
    for angle, adr, axis in zip(half, scene.object_qpos, (0, 1, 2), strict=True):
        qpos[1, adr + 3 : adr + 7] = [np.cos(angle), *(np.sin(angle) * np.eye(3)[axis])]
    np.testing.assert_array_equal(toppled(scene, qpos), [[False, False, False], [False, True, False]])


def test_objects_keep_their_conditions() -> None:
    scene = build_scene(OBJECTS)
    for i, (condition, _) in enumerate(OBJECTS):
        hull = scene.model.geom(f"object{i}/hull")
        np.testing.assert_allclose(2 * hull.size[:2], condition.size[:2])
        root = scene.model.body(f"object{i}/object")
        wheels = (
            0.0
            if condition.family == "box"
            else sum(
                scene.model.body_mass[b]
                for b in range(scene.model.nbody)
                if scene.model.body(b).name.startswith(f"object{i}/wheel")
            )
        )
        np.testing.assert_allclose(root.subtreemass[0] - wheels, condition.total_mass, rtol=1e-6)
    locked = [scene.model.joint(f"object2/wheel{w}_roll").frictionloss[0] > 100 for w in range(4)]
    assert tuple(locked) == OBJECTS[2][0].locked


def test_walls_turn_with_the_map() -> None:
    scene = build_scene((), wall_yaw=0.3, walls=WALLS)
    data = mujoco.MjData(scene.model)
    mujoco.mj_kinematics(scene.model, data)
    axis = data.geom("wall0").xmat.reshape(3, 3)[:, 0]
    np.testing.assert_allclose(axis, [np.cos(0.3), np.sin(0.3), 0.0], atol=1e-12)
    assert len(scene.wall_geoms) == 2


def test_walls_are_higher_than_the_robot_though_drawn_low() -> None:
    model = build_scene(walls=WALLS).model
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    torso, wall = model.geom("robot/torso_hull"), model.geom("wall0")
    top = data.geom("robot/torso_hull").xpos[2] + torso.size[0] + torso.size[1]
    assert data.geom("wall0").xpos[2] + wall.size[2] > top
    drawn = model.geom("wall0_drawn")
    assert 2 * drawn.size[2] == 0.6 and not drawn.conaffinity[0]
    assert wall.group[0] > 2 >= drawn.group[0]


def test_a_wall_stops_the_robot_and_is_noticed() -> None:
    scene = build_scene(walls=[(1.0, 0.0, 0.05, 1.0)])
    engine = MujocoEngine([scene])
    world = engine.init()
    touched = False
    for _ in range(40):
        world, seen = engine.step(world, command(1, (0.03, 0.0)))
        touched |= bool(world.wall_contact[0])
    engine.close()
    assert touched
    # The hands are ahead of the body; nothing passes the wall's near side.
    assert seen.hands[0, :, 0].max() + seen.robot_pose[0, 0] < 0.96


def test_arms_hands_torso_and_ball_collide_with_walls_and_objects_and_not_with_each_other() -> None:
    model = build_scene(OBJECTS[:1], walls=WALLS).model

    def collide(one: str, other: str) -> bool:
        a, b = model.geom(one), model.geom(other)
        return bool(a.contype[0] & b.conaffinity[0] or b.contype[0] & a.conaffinity[0])

    arms = [f"{side}_{part}" for side in ("left", "right") for part in ("upper_arm", "forearm", "hand")]
    shapes = [f"robot/{name}" for name in ("torso_hull", "ball", *arms)]
    assert all(collide(shape, other) for shape in shapes for other in ("wall0", "wall1", "object0/hull"))
    assert not any(collide(one, other) for one in shapes for other in shapes)
    assert not any(collide(f"robot/{arm}", "floor") for arm in arms)


def _touched(walls: list[tuple[float, float, float, float]], reach: float = TUCKED_REACH) -> set[str]:
    """Parts that touch while the robot stands at the origin for 1 s."""
    engine = MujocoEngine([build_scene(walls=walls)])
    height = TUCKED_HEIGHT if reach == TUCKED_REACH else HAND_HEIGHT
    world, _ = engine.step(engine.init(), command(1, reach=reach, hand_height=height), 1.0)
    engine.close()
    assert world.wall_contact[0] == world.wall_parts[0].any()
    return {part for part, touched in zip(PARTS, world.wall_parts[0], strict=True) if touched}


def test_a_wall_is_told_which_part_of_the_robot_touched_it() -> None:
    assert _touched([(-0.25, 0.0, 0.08, 1.0)]) == {"torso"}
    # Folded, the elbows stick out sideways and the hands ahead.
    assert _touched([(0.0, 0.33, 0.3, 0.1)]) == {"left_arm"}
    assert _touched([(0.32, 0.0, 0.1, 1.0)]) >= {"left_hand", "right_hand"}
    assert _touched([(0.49, 0.0, 0.05, 1.0)], REACH) == {"left_hand", "right_hand"}
    assert _touched([(0.49, -1.0, 0.05, 0.95)], REACH) == {"right_hand"}
    assert _touched([(0.6, 0.0, 0.05, 1.0)]) == set()


def test_every_world_of_a_batch_is_told_its_own_contacts() -> None:
    walls = [[(x, 0.0, 0.05, 1.0)] for x in (0.49, 2.0, -0.22)]
    for threads in (1, 2):
        engine = MujocoEngine([build_scene(walls=w) for w in walls], threads=threads)
        world, _ = engine.step(engine.init(), command(3, reach=REACH, hand_height=HAND_HEIGHT), 1.0)
        engine.close()
        assert world.wall_contact.tolist() == [True, False, True]
        assert [PARTS[i] for i in np.nonzero(world.wall_parts[2])[0]] == ["torso"]


def test_what_an_arm_pushes_with_its_side_is_felt() -> None:
    # No hand touches, and the force is still counted: a folded elbow leans on a box that is too heavy to move.
    condition = draw_condition("box", 1, {"mass": 200.0})
    engine = MujocoEngine([build_scene([(condition, (-0.07, -0.3 - condition.half_extents[1], 0.0))])])
    world, forces = engine.init(), []
    for _ in range(25):
        world, seen = engine.step(world, command(1, (0.0, -0.03)))
        forces.append(seen.wrench[0, 0, 1])
    engine.close()
    assert min(forces) < -3.0
    assert seen.robot_pose[0, 1] > -0.1
