"""MJX against C MuJoCo: the same commands give the same motion and the same contact force."""

from __future__ import annotations

import functools
import importlib.util
import sys

import jax
import numpy as np
import pytest

from shmoo_mjx.errors import ShmooError
from shmoo_mjx.geometry.hands import HAND_HEIGHT, REACH
from shmoo_mjx.plant.engine_mjx import MjxEngine, MjxWorld, check_backend
from shmoo_mjx.plant.engine_mujoco import MujocoEngine
from shmoo_mjx.plant.objects import draw_condition
from shmoo_mjx.plant.randomize import Ranges, randomize
from shmoo_mjx.plant.scene import Scene, build_scene
from shmoo_mjx.plant.trials import command

# Measured over 1 s with contact: 4e-5 m, 5e-4 m/s, 0.03 N; C computes in double precision, MJX in single.
POSE, TWIST, FORCE = 2e-4, 2e-3, 0.2


def _scene(family: str | None, seed: int, engine: str, gap: float = 0.02) -> Scene:
    if family is None:
        return build_scene(engine=engine)  # type: ignore[arg-type]
    condition = draw_condition(family, seed)
    place = (REACH + 0.04 + gap + condition.half_extents[0], 0.05, 0.0)
    return build_scene([(condition, place)], engine=engine)  # type: ignore[arg-type]


def _parity(family: str | None, seeds: tuple[int, ...], samples: int, arms_out: int = 8) -> float:
    """Largest contact force seen; asserts agreement at every sample."""
    references = [_scene(family, s, "mujoco") for s in seeds]
    for reference in references:
        # With the scene's 20 line-search iterations C stops short of the solution where the ball's dry friction sticks:
        # 3 mm and 0.8 N off after 1 s, by its own solution with 50, which MJX agrees with.
        reference.model.opt.ls_iterations = 50
        reference.model.opt.enableflags = 0  # MJX knows no sleep
    plain = MujocoEngine(references)
    traced = MjxEngine([_scene(family, s, "mjx") for s in seeds])
    world = plain.init()
    still = command(len(seeds), reach=REACH, hand_height=HAND_HEIGHT)
    for _ in range(arms_out):
        world, _ = plain.step(world, still)
    other: MjxWorld = traced.init()
    other = jax.device_put(
        other._replace(physics=world.physics[:, : other.physics.shape[1]].astype(np.float32), control=world.control),
        other.physics.sharding,
    )
    strongest = 0.0
    for i in range(samples):
        wanted = command(
            len(seeds),
            (0.08, 0.02 * (-1) ** i),
            gamma=0.2 if i > 1 else 0.0,
            yaw=0.0,
            reach=REACH,
            hand_height=HAND_HEIGHT,
        )
        world, here = plain.step(world, wanted)
        other, there = traced.step(other, wanted)
        for name, tolerance in (
            ("robot_pose", POSE), ("hands", POSE), ("lean", POSE), ("object_pose", POSE),
            ("robot_twist", TWIST), ("lean_rate", TWIST), ("object_twist", TWIST), ("wrench", FORCE),
        ):  # fmt: skip
            np.testing.assert_allclose(getattr(there, name), getattr(here, name), atol=tolerance, err_msg=name)
        if here.wrench.size:
            strongest = max(strongest, float(np.abs(here.wrench[..., 0]).max()))
    np.testing.assert_allclose(other.physics[:, 0], world.physics[:, 0], rtol=1e-5)
    assert traced._batched._cache_size() == 1
    plain.close()
    return strongest


@pytest.mark.slow
def test_two_different_boxes_in_one_batch_agree_with_c() -> None:
    assert _parity("box", (0, 1), 4) > 5


@pytest.mark.slow
@pytest.mark.parametrize("family", [None, "box", "cart", "wheelchair"])
def test_one_second_agrees_with_c(family: str | None) -> None:
    strongest = _parity(family, (1,), 10)
    assert family is None or strongest > 10


def test_a_brake_in_a_later_world_counts_though_the_first_world_has_none() -> None:
    free, braked = (
        draw_condition("wheelchair", 3, {"locked": locked}) for locked in ([False] * 4, [True] * 2 + [False] * 2)
    )
    place = (REACH + 0.06 + free.half_extents[0], 0.0, 0.0)
    scenes = [build_scene([(c, place)], engine="mjx") for c in (free, braked)]
    joints = scenes[1].model.dof_frictionloss > 0
    assert joints.sum() > (scenes[0].model.dof_frictionloss > 0).sum()
    together, later = MjxEngine(scenes), MjxEngine(scenes[:1])
    later.change(scenes[1:])
    for engine, world in ((together, 1), (later, 0)):
        model = engine.model
        assert np.array_equal(model._impl.dof_hasfrictionloss, joints)
        loss = np.broadcast_to(model.dof_frictionloss, (len(engine.scenes), model.nv))
        np.testing.assert_allclose(loss[world], scenes[1].model.dof_frictionloss, atol=1e-6)


def test_randomize_varies_what_it_says_and_nothing_else() -> None:
    scene = _scene("cart", 0, "mjx")
    engine = MjxEngine([scene])
    keys = jax.random.split(jax.random.key(0), 5)
    model, in_axes = randomize(engine.model, keys, scene, Ranges(hand_friction=0.0))
    batched = {
        name for name in ("body_mass", "body_ipos", "geom_friction", "dof_frictionloss", "actuator_gear", "geom_size")
        if getattr(in_axes, name) == 0
    }  # fmt: skip
    assert batched == {"body_mass", "body_ipos", "geom_friction", "dof_frictionloss", "actuator_gear"}
    torso = scene.model.body("robot/torso").id
    masses = np.asarray(model.body_mass)
    assert len(set(masses[:, torso].tolist())) == 5
    np.testing.assert_allclose(masses[:, torso], 32.0, rtol=0.15)
    hull = scene.model.body("object0/object").id
    np.testing.assert_allclose(masses[:, hull], scene.model.body_mass[hull], rtol=0.2)
    np.testing.assert_allclose(masses[:, scene.model.body("robot/ball").id], 2.5)
    hand = scene.model.geom("robot/left_hand").id
    np.testing.assert_allclose(np.asarray(model.geom_friction)[:, hand], [[0.7, 0.005, 0.0001]] * 5, rtol=1e-6)
    again, _ = randomize(engine.model, keys, scene, Ranges(hand_friction=0.0))
    np.testing.assert_array_equal(again.body_mass, masses)


@pytest.mark.slow
def test_randomised_robots_survive_pushes() -> None:
    worlds = 64
    scene = _scene(None, 0, "mjx")
    engine = MjxEngine([scene] * worlds)
    keys = jax.random.split(jax.random.key(1), worlds)
    engine = engine.with_model(*functools.partial(randomize, scene=scene)(engine.model, keys))
    angle = np.linspace(0, 2 * np.pi, worlds, endpoint=False)
    push = np.zeros((worlds, 6))
    push[:, 0], push[:, 1] = 20 * np.cos(angle), 20 * np.sin(angle)
    world = engine.init()
    for i in range(30):
        world, seen = engine.step(world, command(worlds), push=push if 10 <= i < 15 else None)
    assert not np.asarray(engine.fallen(world)).any()
    assert np.asarray(seen.robot_pose).std(axis=0)[0] > 0.01


@pytest.mark.parametrize("family", ["box", "cart", "wheelchair"])
def test_warp_agrees_with_c(family: str, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("warp", reason="warp-lang is not installed")
    monkeypatch.setattr(sys.modules[__name__], "MjxEngine", functools.partial(MjxEngine, impl="warp"))
    assert _parity(family, (0, 1), 4) > 5


def test_warp_is_refused_in_one_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(ShmooError, match=r"^impl='warp': the package warp-lang is missing; [^.]*\.$"):
        check_backend("warp")
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: object())
    check_backend("warp")
    with pytest.raises(ShmooError, match="walls"):
        check_backend("warp", walls=True)
    check_backend("jax", walls=True)
