"""C MuJoCo behind the engines' signature: ``init() -> state`` and ``step(state, command) -> state, observation``.

A batch of W worlds of one structure (the same family and number of objects) advances together: the control is one
compiled function over all worlds, the physics runs in MuJoCo's own threads (``mujoco.rollout``).
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import mujoco
import numpy as np
from mujoco.rollout import Rollout

from shmoo_mjx import se2
from shmoo_mjx.hands import TUCKED_HEIGHT, TUCKED_REACH
from shmoo_mjx.plant import lowlevel
from shmoo_mjx.plant.observe import observation, planar_wrench
from shmoo_mjx.plant.robot import Readout, readout
from shmoo_mjx.plant.scene import Scene
from shmoo_mjx.types import DT, Command, Observation

__all__ = ["MujocoEngine", "World"]

_CONTROL_AND_FORCE = int(mujoco.mjtState.mjSTATE_CTRL) | int(mujoco.mjtState.mjSTATE_XFRC_APPLIED)


@functools.cache
def _compiled_control(gains: lowlevel.Gains, timestep: float) -> Callable[..., Any]:
    """The low-level control, compiled once for all engines with these gains.

    Compiled even for one world: some 80 small array operations cost NumPy ten times as much.
    """
    return jax.jit(
        lambda state, qpos, qvel, command: lowlevel.control(gains, state, readout(qpos, qvel), command, timestep)
    )


class World(NamedTuple):
    """Complete state of W worlds."""

    physics: np.ndarray
    """``[W, n]`` MuJoCo's full physics state."""
    control: lowlevel.LowLevelState
    wall_contact: np.ndarray
    """``[W]`` whether the robot's body or a hand touched a wall in the last sample time (only kept for W = 1)."""


class MujocoEngine:
    """Steps W worlds of one structure. Holds compiled models and scratch memory, never state."""

    def __init__(self, scenes: Sequence[Scene], gains: lowlevel.Gains | None = None, threads: int = 1) -> None:
        self.scenes = list(scenes)
        self.gains = gains or lowlevel.Gains()
        self._models = [s.model for s in self.scenes]
        first = self.scenes[0]
        self.timestep = float(first.model.opt.timestep)
        self._data = [mujoco.MjData(self._models[0]) for _ in range(threads)]
        self._rollout = Rollout(nthread=threads if threads > 1 else 0)
        self._nq, self._nv = first.model.nq, first.model.nv
        self._torso = first.model.body("robot/torso").id
        self._watched = self._robot_wall_table(first)
        self._control = _compiled_control(self.gains, self.timestep)

    def close(self) -> None:
        """Stop the threads."""
        self._rollout.close()

    def init(self) -> World:
        """All worlds at their scenes' starting configuration, arms folded."""
        rows = []
        for scene in self.scenes:
            data = mujoco.MjData(scene.model)
            data.qpos[:] = scene.qpos0
            mujoco.mj_forward(scene.model, data)
            row = np.empty(mujoco.mj_stateSize(scene.model, mujoco.mjtState.mjSTATE_FULLPHYSICS))
            mujoco.mj_getState(scene.model, data, row, mujoco.mjtState.mjSTATE_FULLPHYSICS)
            rows.append(row)
        batch = (len(rows),)
        control = lowlevel.init(np, batch, TUCKED_REACH, TUCKED_HEIGHT)
        return World(np.array(rows), control, np.zeros(batch, dtype=bool))

    def observe(self, world: World) -> Observation:
        """The worlds as they are, with no wrench."""
        none = np.zeros((len(self.scenes), len(self.scenes[0].conditions), 3))
        return observation(self.scenes[0], world.physics[:, 0], *self._split(world.physics), none)

    def step(
        self, world: World, command: Command, duration: float = DT, push: np.ndarray | None = None
    ) -> tuple[World, Observation]:
        """Hold ``command`` (fields batched ``[W, ...]``) for ``duration`` seconds.

        ``push [W, 6]`` is an outside disturbance: force [N] and torque [N m] in {W} at the CoM of the robot's torso.
        """
        substeps = round(duration / self.timestep)
        physics, control = world.physics, world.control
        wrench = np.zeros((len(self.scenes), len(self.scenes[0].conditions), 3))
        touched = np.zeros(len(self.scenes), dtype=bool)
        for _ in range(substeps):
            qpos, qvel = self._split(physics)
            control, torque = self._control(control, qpos[:, :17], qvel[:, :15], command)
            state, sensors = self._advance(physics, np.asarray(torque, dtype=np.float64), push)
            if sensors.any():
                # Contact sensors belong to the configuration before the step.
                wrench += planar_wrench(self.scenes[0], qpos, sensors[:, 0])
            physics = state[:, 0]
            if len(self.scenes) == 1:
                touched |= self._touches_wall(self._data[0])
        world = World(physics, control, touched)
        return world, observation(self.scenes[0], physics[:, 0], *self._split(physics), wrench / substeps)

    def torque(self, world: World, command: Command) -> np.ndarray:
        """Motor torques ``[W, 9]`` [N m] that the control asks for now; what a robot measures as motor currents."""
        qpos, qvel = self._split(world.physics)
        return np.asarray(self._control(world.control, qpos[:, :17], qvel[:, :15], command)[1], dtype=np.float64)

    def robot(self, world: World) -> Readout:
        """The robots' true state, batched ``[W, ...]``."""
        qpos, qvel = self._split(world.physics)
        return readout(qpos[:, :17], qvel[:, :15])

    def _advance(
        self, physics: np.ndarray, torque: np.ndarray, push: np.ndarray | None
    ) -> tuple[np.ndarray, np.ndarray]:
        """One physics step: states ``[W, 1, n]`` after it and the sensors it computed."""
        if push is None:
            return self._rollout.rollout(self._models, self._data, physics, torque[:, None, :], skip_checks=False)
        outside = np.zeros((len(torque), self._models[0].nbody, 6))
        outside[:, self._torso] = push
        inputs = np.concatenate([torque, outside.reshape(len(torque), -1)], axis=-1)
        return self._rollout.rollout(
            self._models, self._data, physics, inputs[:, None, :], control_spec=_CONTROL_AND_FORCE, skip_checks=False
        )

    def _split(self, physics: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return physics[:, 1 : 1 + self._nq], physics[:, 1 + self._nq : 1 + self._nq + self._nv]

    @staticmethod
    def _robot_wall_table(scene: Scene) -> np.ndarray:
        kind = np.zeros(scene.model.ngeom, dtype=int)
        kind[list(scene.robot_geoms)] = 1
        kind[list(scene.wall_geoms)] = 2
        return kind

    def _touches_wall(self, data: Any) -> bool:
        if data.ncon == 0:
            return False
        kinds = self._watched[data.contact.geom]
        return bool(np.any(kinds.sum(axis=1) * (kinds.min(axis=1) > 0) == 3))

    def fallen(self, world: World) -> np.ndarray:
        """``[W]`` whether the body leans more than 0.6 rad."""
        return np.any(np.abs(se2.wrap(self.robot(world).lean)) > 0.6, axis=-1)
