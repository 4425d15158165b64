"""C MuJoCo behind the engines' signature: ``init() -> state`` and ``step(state, command) -> state, observation``.

A batch of W worlds of one structure (the same family and number of objects) advances together: the control is one
compiled function over all worlds, the physics is one call of ``mujoco.rollout``. With several threads, each takes a
part of the worlds through the whole sample time: to meet after every 2 ms would cost what the second thread brings.
"""

from __future__ import annotations

import functools
import itertools
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from mujoco.rollout import Rollout

from shmoo_mjx.arrays import Array, Bool, Float
from shmoo_mjx.hands import TUCKED_HEIGHT, TUCKED_REACH
from shmoo_mjx.plant import lowlevel, observe
from shmoo_mjx.plant.observe import observation, planar_wrench, scene_poses
from shmoo_mjx.plant.robot import NQ, NV, Robot, RobotState, readout
from shmoo_mjx.plant.scene import PARTS, Scene
from shmoo_mjx.processes import check_forked
from shmoo_mjx.types import DT, Command, Observation

_CONTROL_AND_FORCE = int(mujoco.mjtState.mjSTATE_CTRL) | int(mujoco.mjtState.mjSTATE_XFRC_APPLIED)


@functools.cache
def _compiled_control(
    robot: Robot, gains: lowlevel.Gains, timestep: float
) -> Callable[[Array, Array, Array], tuple[Array, Array]]:
    """The low-level control, (memory, sensed, command) -> (memory, torque), compiled once for all engines.

    Compiled even for one world: some 80 small array operations cost NumPy ten times as much. Each argument is one
    array, since to hand over every field by itself takes longer than the computation: ``memory [W, 10]``, qpos and qvel
    of the robot ``[W, NQ + NV]``, ``command [W, 6]``; torque ``[W, 9]``.
    """

    def control(memory: Array, sensed: Array, command: Array) -> tuple[Array, Array]:
        now = readout(sensed[:, :NQ], sensed[:, NQ:])
        wanted = Command(command[:, :3], *(command[:, i] for i in (3, 4, 5)))
        state, torque = lowlevel.control(robot, gains, _unpacked(memory), now, wanted, timestep)
        # MuJoCo resets a world that diverges, but warns at every step of motors that are not finite.
        after = jnp.concatenate(_columns(state), axis=-1), torque
        return jax.tree.map(lambda values: jnp.where(jnp.isfinite(values), values, 0.0), after)

    return jax.jit(control)


def _unpacked(memory: Array) -> lowlevel.LowLevelState:
    pairs, scalars = (memory[:, 2 * i : 2 * i + 2] for i in range(3)), (memory[:, i] for i in range(6, 10))
    return lowlevel.LowLevelState(*pairs, *scalars)


def _columns(fields: Sequence[Array]) -> list[Array]:
    """Fields ``[W, n]`` or ``[W]`` as columns of one array."""
    return [x if x.ndim == 2 else x[:, None] for x in fields]


def _packed(fields: Sequence[Array]) -> np.ndarray:
    return np.concatenate(_columns([np.asarray(x) for x in fields]), axis=-1).astype(np.float32)


class World(NamedTuple):
    """Complete state of W worlds."""

    physics: Float[np.ndarray, "W n"]
    """MuJoCo's full physics state."""
    control: lowlevel.LowLevelState
    wall_contact: Bool[np.ndarray, "W"]
    """Whether any part of the robot touched a wall in the last sample time."""
    wall_parts: Bool[np.ndarray, "W P"]
    """Which of scene.PARTS did."""


class _Part(NamedTuple):
    """The worlds of one thread, and its own scratch memory."""

    worlds: slice
    models: list[mujoco.MjModel]
    data: list[mujoco.MjData]
    rollout: Rollout


class MujocoEngine:
    """Steps W worlds of one structure. Holds compiled models and scratch memory, never state."""

    def __init__(self, scenes: Sequence[Scene], gains: lowlevel.Gains | None = None, threads: int = 1) -> None:
        check_forked()
        self.scenes = list(scenes)
        self.gains = gains or lowlevel.Gains()
        first = self.scenes[0]
        self.timestep = float(first.model.opt.timestep)
        models = [s.model for s in self.scenes]
        _check_structure(models)
        ends = np.linspace(0, len(models), min(threads, len(models)) + 1).astype(int)
        self._parts = [
            _Part(slice(a, b), models[a:b], [mujoco.MjData(models[0])], Rollout(nthread=0))
            for a, b in itertools.pairwise(ends)
        ]
        self._pool = ThreadPoolExecutor(len(self._parts)) if len(self._parts) > 1 else None
        self._nq, self._nv = first.model.nq, first.model.nv
        self._torso = first.model.body("robot/torso").id
        self._control = _compiled_control(first.robot, self.gains, self.timestep)

    def __reduce__(self) -> tuple[Any, ...]:
        """A copy compiles anew, as threads and scratch memory can't be copied; worlds are none of an engine's state."""
        return type(self), (self.scenes, self.gains, len(self._parts))

    def close(self) -> None:
        """Stop the threads."""
        if self._pool is not None:
            self._pool.shutdown()
        for part in self._parts:
            part.rollout.close()

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
        return World(np.array(rows), control, np.zeros(batch, dtype=bool), np.zeros((*batch, len(PARTS)), dtype=bool))

    def change(self, scenes: Sequence[Scene]) -> None:
        """Go on with other scenes of the same structure: what an object weighs or which brakes are on changes mid-run.

        The worlds' states stay as they are. Poses in the new scenes' starting configurations mean nothing here.
        """
        models = [s.model for s in scenes]
        _check_structure([*self._parts[0].models[:1], *models])
        self.scenes = list(scenes)
        self._parts = [
            part._replace(models=models[part.worlds], data=[mujoco.MjData(models[0])]) for part in self._parts
        ]

    def observe(self, world: World) -> Observation:
        """The worlds as they are, with no wrench."""
        none = np.zeros((len(self.scenes), len(self.scenes[0].conditions), 3))
        return observation(self.scenes[0], world.physics[:, 0], *self._split(world.physics), none)

    def step(
        self, world: World, command: Command, duration: float = DT, push: Float[np.ndarray, "W 6"] | None = None
    ) -> tuple[World, Observation]:
        """Hold ``command`` (fields batched ``[W, ...]``) for ``duration`` seconds.

        ``push`` is an outside disturbance: force [N] and torque [N m] in {W} at the CoM of the robot's torso.
        """
        world, wrench = self.advance(world, command, duration, push)
        return world, observation(self.scenes[0], world.physics[:, 0], *self._split(world.physics), wrench)

    def advance(
        self, world: World, command: Command, duration: float, push: Float[np.ndarray, "W 6"] | None = None
    ) -> tuple[World, Float[np.ndarray, "W N 3"]]:
        """As :meth:`step`, but the mean wrench alone is observed."""
        hold = functools.partial(self._hold, substeps=round(duration / self.timestep))
        pushes = [None if push is None else push[p.worlds] for p in self._parts]
        if self._pool is None:
            return hold(self._parts[0], world, command, pushes[0])
        state, wanted = (jax.tree.map(np.asarray, tree) for tree in (world, command))
        parted = [(_cut(state, p.worlds), _cut(wanted, p.worlds)) for p in self._parts]
        done = list(self._pool.map(hold, self._parts, *zip(*parted, strict=True), pushes))
        joined: tuple[World, np.ndarray] = jax.tree.map(lambda *parts: np.concatenate(parts), *done)
        return joined

    def _hold(
        self, part: _Part, world: World, command: Command, push: np.ndarray | None, substeps: int
    ) -> tuple[World, np.ndarray]:
        """The part's worlds after ``substeps``, and their mean wrench ``[w, N, 3]``."""
        scene, physics = self.scenes[0], world.physics
        memory, wanted = _packed(world.control), _packed(command)
        felt: list[tuple[np.ndarray, np.ndarray]] = []
        for _ in range(substeps):
            memory, torque = self._control(memory, self._robot_state(physics), wanted)
            state, sensors = self._advance(part, physics, np.asarray(torque, dtype=np.float64), push)
            if sensors.any():
                # Contact sensors belong to the configuration before the step.
                felt.append((self._split(physics)[0], sensors))
            physics = state
        wrench, touched = np.zeros((len(physics), len(scene.conditions), 3)), np.zeros_like(world.wall_parts)
        if felt:
            qpos, sensors = (np.stack(column) for column in zip(*felt, strict=True))
            wrench += planar_wrench(scene, qpos, sensors).sum(axis=0)
            touched |= (sensors[..., scene.wall_sensor] > 0).any(axis=(0, -1))
        control = _unpacked(np.asarray(memory))
        end = world.physics[:, 0] + substeps * self.timestep
        # MuJoCo resets a world that it can't simulate on to its first state and to time 0.
        lost = ~(np.isfinite(world.physics.sum(axis=-1)) & (physics[:, 0] > end - 0.5 * self.timestep))
        if lost.any():
            physics = np.where(lost[:, None], np.nan, physics)
            physics[lost, 0] = end[lost]
        return World(physics, control, touched.any(axis=-1), touched), wrench / substeps

    def torque(self, world: World, command: Command) -> Float[np.ndarray, "W 9"]:
        """Motor torques [N m] that the control asks for now; what a robot measures as motor currents."""
        _, torque = self._control(_packed(world.control), self._robot_state(world.physics), _packed(command))
        return np.asarray(torque, dtype=np.float64)

    def _robot_state(self, physics: np.ndarray) -> np.ndarray:
        """qpos and qvel of the robot ``[W, NQ + NV]``."""
        first_velocity = 1 + self._nq
        return np.concatenate([physics[:, 1 : 1 + NQ], physics[:, first_velocity : first_velocity + NV]], axis=-1)

    def poses(self, world: World) -> tuple[Float[np.ndarray, "W 3"], Float[np.ndarray, "W N 3"]]:
        """Of the robots and of the objects, in {W}."""
        return scene_poses(self.scenes[0], world.physics)

    def robot(self, world: World) -> RobotState:
        """The robots' true state, batched ``[W, ...]``."""
        return readout(*self._split(world.physics))

    def _advance(
        self, part: _Part, physics: np.ndarray, torque: np.ndarray, push: np.ndarray | None
    ) -> tuple[np.ndarray, np.ndarray]:
        """One physics step of a part: states ``[w, n]`` after it and the sensors it computed."""
        inputs, spec = torque, int(mujoco.mjtState.mjSTATE_CTRL)
        if push is not None:
            outside = np.zeros((len(torque), part.models[0].nbody, 6))
            outside[:, self._torso] = push
            inputs, spec = np.concatenate([torque, outside.reshape(len(torque), -1)], axis=-1), _CONTROL_AND_FORCE
        state = np.empty((len(physics), 1, physics.shape[-1]))
        sensors = np.empty((len(physics), 1, part.models[0].nsensordata))
        # Its checks of every model at every step would take as long as a tenth of the physics.
        part.rollout.rollout(
            part.models, part.data, np.ascontiguousarray(physics), np.ascontiguousarray(inputs[:, None]),
            control_spec=spec, skip_checks=True, nstep=1, state=state, sensordata=sensors,
        )  # fmt: skip
        return state[:, 0], sensors[:, 0]

    def _split(self, physics: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return physics[:, 1 : 1 + self._nq], physics[:, 1 + self._nq : 1 + self._nq + self._nv]

    def fallen(self, world: World) -> Bool[np.ndarray, "W"]:
        """Whether the body leans more than 0.6 rad; true of a world that has diverged."""
        return np.asarray(observe.fallen(self.robot(world).lean))

    def diverged(self, world: World) -> Bool[np.ndarray, "W"]:
        """Whether the physics is lost (`observe.diverged`); the world stays so."""
        return np.asarray(observe.diverged(*self._split(world.physics)))


def _check_structure(models: Sequence[mujoco.MjModel]) -> None:
    """MuJoCo would read past its arrays if the worlds of a batch were unlike each other."""
    shapes = {(m.nq, m.nv, m.nbody, m.na, m.nsensordata) for m in models}
    if len(shapes) > 1:
        raise ValueError("the worlds of one engine must have the same structure: family and number of objects")


def _cut(tree: Any, worlds: slice) -> Any:
    return jax.tree.map(lambda field: field[worlds], tree)
