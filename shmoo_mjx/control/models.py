"""Models for MPPI, each by one line: the learned core, the hand-written rigid body, and the simulator itself.

All of them take controls ``[S, T, 3]`` and give a SystemState ``[S, T, ...]``, so one cost serves all. The first two
start from a SystemState and can be compiled. The simulator starts from a `World` of one world, runs on the host and is
slow: an oracle, to see what MPPI could do if it knew everything.
"""

from __future__ import annotations

from typing import Any

import jax
import numpy as np

from shmoo_mjx import se2
from shmoo_mjx.control.mppi import RolloutFn
from shmoo_mjx.dynamics import core, rigid_body
from shmoo_mjx.dynamics.core import CoreConfig, Params
from shmoo_mjx.hands import HAND_HEIGHT, REACH
from shmoo_mjx.plant.engine_mujoco import MujocoEngine, World
from shmoo_mjx.plant.scene import Scene
from shmoo_mjx.types import Command, Observation, SystemState

__all__ = ["learned", "rigid", "simulator"]

Array = Any


def learned(params: Params, config: CoreConfig | None = None) -> RolloutFn:
    """R and psi a, with the coefficients that ``params`` holds."""
    return lambda state, controls: core.rollout(params, state, controls, config)[0]


def rigid(body: rigid_body.Body) -> RolloutFn:
    """The rigid body with friction."""
    return lambda state, controls: rigid_body.rollout(body, state, controls)[0]


def simulator(scene: Scene, face: Array, yaw: float = 0.0, threads: int = 1) -> RolloutFn:
    """C MuJoCo with the robot's own low-level control, S worlds at a time, pushing the scene's first object.

    Args:
        scene: the world, with the object's true properties.
        face: ``[4]`` the pushed face in {O}.
        yaw: heading that the robot holds [rad].
        threads: of the physics.

    Returns:
        A model whose start is a `World` of one world, e.g. ``engine.init()`` after some steps. Not for jit.
    """
    engines: dict[int, MujocoEngine] = {}

    def rollout_fn(world: World, controls: Array) -> SystemState:
        controls = np.asarray(controls)
        samples, steps = controls.shape[:2]
        if samples not in engines:
            engines[samples] = MujocoEngine([scene] * samples, threads=threads)
        engine = engines[samples]
        many = jax.tree.map(lambda x: np.repeat(np.asarray(x), samples, axis=0), world)
        held = (np.full(samples, yaw), np.full(samples, REACH), np.full(samples, HAND_HEIGHT))
        last, states = engine.observe(many), []
        for t in range(steps):
            many, seen = engine.step(many, Command(controls[:, t], *held))
            states.append(_state(scene, last, seen, controls[:, t], face))
            last = seen
        return jax.tree.map(lambda *x: np.stack(x, axis=1), *states)

    return rollout_fn


def _state(scene: Scene, last: Observation, seen: Observation, u: Array, face: Array) -> SystemState:
    """The state ``[S, ...]`` after a sample, with its memory."""
    batch = seen.robot_pose.shape[:1]
    return SystemState(
        robot_pose=seen.robot_pose,
        robot_twist=seen.robot_twist,
        lean=seen.lean,
        lean_rate=seen.lean_rate,
        object_pose=seen.object_pose[:, 0],
        object_twist=seen.object_twist[:, 0],
        last_object_twist=se2.rotate(last.object_twist[:, 0], -last.object_pose[:, 0, 2]),
        last_wrench=se2.rotate(seen.wrench[:, 0], -last.object_pose[:, 0, 2]),
        last_force=se2.rotate(seen.wrench[:, 0, :2], -last.robot_pose[:, 2]),
        last_u=u,
        face=np.broadcast_to(np.asarray(face, dtype=np.float32), (*batch, 4)),
        size=np.full(batch, np.hypot(*scene.conditions[0].half_extents), dtype=np.float32),
    )
