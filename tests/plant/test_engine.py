"""The C engine: worlds are independent, states are values, threads change nothing."""

from __future__ import annotations

import copy
import pickle
from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

from shmoo_mjx.geometry.hands import HAND_HEIGHT, REACH
from shmoo_mjx.plant import engine_mujoco, observe
from shmoo_mjx.plant.engine_mujoco import MujocoEngine, World
from shmoo_mjx.plant.objects import draw_condition
from shmoo_mjx.plant.scene import PARTS, Scene, build_scene
from shmoo_mjx.plant.trials import command
from shmoo_mjx.types import Observation


def _scene(seed: int) -> Scene:
    return build_scene([(draw_condition("box", seed), (0.9, 0.0, 0.0))])


def _run(engine: MujocoEngine, samples: int = 4) -> tuple[World, Observation]:
    world = engine.init()
    wanted = command(len(engine.scenes), (0.04, 0.01), gamma=0.1, reach=REACH, hand_height=HAND_HEIGHT)
    for _ in range(samples):
        world, seen = engine.step(world, wanted)
    return world, seen


def test_batch_equals_single_worlds_and_threads_change_nothing() -> None:
    scenes = [_scene(i) for i in range(3)]
    engines = [MujocoEngine(scenes), MujocoEngine(scenes, threads=2)]
    (one, _), (two, _) = (_run(e) for e in engines)
    # The control is compiled for the batch's shape, in single precision: its last bits may differ.
    np.testing.assert_allclose(one.physics, two.physics, atol=1e-5)
    alone, _ = _run(MujocoEngine([scenes[1]]))
    np.testing.assert_allclose(alone.physics[0], one.physics[1], atol=1e-4)
    for engine in engines:
        engine.close()


def test_worlds_of_unlike_structure_are_refused() -> None:
    with pytest.raises(ValueError, match="same structure"):
        MujocoEngine([_scene(0), build_scene()])


def test_a_state_is_a_value() -> None:
    engine = MujocoEngine([_scene(0)])
    world = engine.init()
    kept = world.physics.copy()
    wanted = command(1, (0.05, 0.0))
    first, seen = engine.step(world, wanted)
    np.testing.assert_array_equal(world.physics, kept)
    again, seen_again = engine.step(world, wanted)
    np.testing.assert_array_equal(first.physics, again.physics)
    np.testing.assert_array_equal(seen.robot_pose, seen_again.robot_pose)
    assert seen.time[0] == pytest.approx(0.1)
    engine.close()


@pytest.mark.parametrize("how", ["a push", "NaN", "NaN at the start", "infinity"])
def test_a_world_that_mujoco_resets_counts_as_diverged_and_stays_so(how: str) -> None:
    engine = MujocoEngine([_scene(0), _scene(1)])
    start = engine.init()
    if how != "NaN at the start":
        start, _ = engine.step(start, command(2, (0.0, 0.0)))
    physics, push = start.physics.copy(), None
    if how == "a push":
        push = np.array([[1e8, 0, 0, 0, 0, 0], [0.0] * 6])
    else:
        physics[0, 5] = np.inf if how == "infinity" else np.nan
    world, seen = engine.step(start._replace(physics=physics), command(2, (0.0, 0.0)), push=push)
    for later in (1, 2, 3):
        assert engine.diverged(world).tolist() == engine.fallen(world).tolist() == [True, False]
        assert seen.time[0] == pytest.approx(start.physics[1, 0] + 0.1 * later)
        world, seen = engine.step(world, command(2, (0.0, 0.0)))
    engine.close()


@pytest.mark.parametrize("xp", [np, jnp])
def test_what_has_fallen_or_diverged_is_not_passed_by_nan(xp: Any) -> None:
    lean = xp.array([[0.1, -0.2], [0.1, 0.7], [xp.nan, 0.0], [0.0, -3.0]])
    assert observe.fallen(lean).tolist() == [False, True, True, True]
    qpos = xp.array([[5e5, 0.0], [xp.nan, 0.0], [0.0, xp.inf], [0.0, 0.0], [0.0, 0.0]])
    qvel = xp.array([[300.0], [0.0], [0.0], [-1e5], [xp.nan]])
    assert observe.diverged(qpos, qvel).tolist() == [False, True, True, True, True]


@pytest.mark.parametrize("copied", [copy.deepcopy, lambda whole: pickle.loads(pickle.dumps(whole))])
def test_a_copy_goes_on_like_the_original(copied: Callable[[Any], Any]) -> None:
    engine = MujocoEngine([_scene(i) for i in range(3)], threads=2)
    world, _ = _run(engine, 2)
    other, same = copied((engine, world))
    (one, _), (two, _) = (e.step(w, command(3, (0.05, 0.0))) for e, w in ((engine, world), (other, same)))
    np.testing.assert_array_equal(one.physics, two.physics)
    engine.close()
    other.close()


def test_no_push_is_a_push_of_nothing() -> None:
    engine = MujocoEngine([_scene(0)])
    world, wanted = engine.init(), command(1)
    still, _ = engine.step(world, wanted)
    zero, _ = engine.step(world, wanted, push=np.zeros((1, 6)))
    _, seen = engine.step(world, wanted, push=np.array([[0.0, 30.0, 0.0, 0.0, 0.0, 0.0]]))
    np.testing.assert_allclose(zero.physics, still.physics, atol=1e-12)
    assert seen.robot_twist[0, 1] > 0.01 and abs(still[0][0, 2]) < 1e-6
    # The push ends with its step.
    after, _ = engine.step(still, wanted)
    after_zero, _ = engine.step(zero, wanted)
    np.testing.assert_allclose(after.physics, after_zero.physics, atol=1e-9)
    engine.close()


def test_a_robot_that_leans_far_has_fallen() -> None:
    engine = MujocoEngine([_scene(0)])
    world = engine.init()
    assert not engine.fallen(world)[0]
    physics = world.physics.copy()
    physics[0, 4:8] = [np.cos(0.4), 0.0, np.sin(0.4), 0.0]
    assert engine.fallen(world._replace(physics=physics))[0]
    engine.close()


def _hall(count: int) -> Scene:
    """A wall close ahead of the robot and one beyond the box, among ``count`` others farther off."""
    rng = np.random.default_rng(0)
    places = rng.uniform(4.0, 30.0, (count, 2)) * rng.choice([-1, 1], (count, 2))
    walls = [(1.9, 0.0, 0.05, 1.0), (-0.45, 0.3, 0.05, 0.05), *((x, y, 0.2, 0.1) for x, y in places)]
    return build_scene([(draw_condition("box", 2, {"mass": 3.0}), (0.9, 0.0, 0.0))], walls=walls, wall_yaw=0.1)


def test_walls_out_of_reach_change_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    scene, runs = _hall(100), []
    for few in (0, 1000):
        monkeypatch.setattr(engine_mujoco, "_FEW_WALLS", few)
        engine = MujocoEngine([scene])
        world, parts = engine.init(), np.zeros(len(PARTS), dtype=bool)
        for i in range(40):
            lean = (0.1, 0.0) if i < 25 else (-0.12, 0.05)
            world, _ = engine.step(world, command(1, lean, reach=REACH, hand_height=HAND_HEIGHT))
            parts |= world.wall_parts[0]
        sizes = [stage.model.ngeom for stage in engine._stages[0].values()]
        runs.append((world.physics, parts, sizes))
        engine.close()
    (near, touched, sizes), (whole, touched_too, [size]) = runs
    np.testing.assert_allclose(near, whole, atol=1e-9)
    np.testing.assert_array_equal(touched, touched_too)
    assert touched.any(), "the robot has to meet a wall, or nothing is tested"
    assert len(sizes) > 1 and max(sizes) < size - 100


def test_what_rests_sleeps_until_it_is_touched() -> None:
    engine = MujocoEngine([build_scene([(draw_condition("cart", 3), (1.2, 0.0, 0.0))])])
    world, still = engine.init(), command(1)
    speed = 1 + engine.scenes[0].model.nq + engine.scenes[0].object_qvel[0]
    for _ in range(20):
        world, _ = engine.step(world, still)
    assert not world.physics[0, speed : speed + 6].any(), "it sleeps"
    place, rest = world.physics[0, 1 + engine.scenes[0].object_qpos[0] :][:7].copy(), world
    for _ in range(10):
        rest, _ = engine.step(rest, still)
    np.testing.assert_allclose(rest.physics[0, 1 + engine.scenes[0].object_qpos[0] :][:7], place, atol=1e-6)
    pushed = world
    for _ in range(30):
        pushed, seen = engine.step(pushed, command(1, (0.08, 0.0), reach=REACH, hand_height=HAND_HEIGHT))
    assert seen.object_pose[0, 0, 0] > place[0] + 0.05
    engine.close()


def test_readings_are_the_states_on_the_way() -> None:
    engine = MujocoEngine([_scene(0), _scene(1)])
    world, _ = _run(engine, 3)
    wanted = command(2, (0.05, 0.0), reach=REACH, hand_height=HAND_HEIGHT)
    after, track = engine.advance(world, wanted, 0.1, 5)
    whole, _ = engine.step(world, wanted)
    np.testing.assert_array_equal(track.physics[-1], after.physics)
    np.testing.assert_array_equal(after.physics, whole.physics)
    passed = track.physics[:, :, 0] - world.physics[:, 0]
    np.testing.assert_allclose(passed, np.repeat(0.02 * np.arange(1, 6)[:, None], 2, axis=1), atol=1e-9)
    np.testing.assert_allclose(track.torque[-1], engine.torque(after, wanted), atol=1e-4)
    engine.close()
