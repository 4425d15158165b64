"""Robot, objects and walls in one model, addressed by name."""

from __future__ import annotations

import mujoco
import numpy as np

from shmoo_mjx.plant.engine_mujoco import MujocoEngine
from shmoo_mjx.plant.objects import draw_condition
from shmoo_mjx.plant.scene import build_scene
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


def test_arms_touch_nothing_but_objects_with_the_hands() -> None:
    model = build_scene(OBJECTS[:1]).model
    for name in ("left_upper_arm", "right_forearm"):
        geom = model.geom(f"robot/{name}")
        assert geom.contype[0] == 0 and geom.conaffinity[0] == 0
    hand, hull = model.geom("robot/left_hand"), model.geom("object0/hull")
    assert hand.contype[0] & hull.conaffinity[0]
