"""C MuJoCo engine with the common interface ``init() -> state`` and ``step(state, command) -> state, observation``.

A batch of W worlds of one structure (the same family and number of objects) advances together. The control is one
compiled function over all worlds; the physics is one call of ``mj_step`` per world. With several threads, each thread
steps its part of the worlds through the whole sample time, because synchronising every 2 ms costs more than it gains.
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

from shmoo_mjx.arrays import Array, Bool, Float, single_precision
from shmoo_mjx.base.processes import check_forked
from shmoo_mjx.geometry.hands import TUCKED_HEIGHT, TUCKED_REACH
from shmoo_mjx.plant import lowlevel
from shmoo_mjx.plant.observe import TrueStates, observation, planar_wrench
from shmoo_mjx.plant.robot import NQ, NV, Robot, readout
from shmoo_mjx.plant.scene import PARTS, Scene
from shmoo_mjx.types import DT, Command, Observation, Track

_FULL = mujoco.mjtState.mjSTATE_FULLPHYSICS
_MEMORY, _SENSED = 10, NQ + NV
"""Number of scalars in the control's state and in the robot state that it reads."""
_FEW_WALLS = 32
"""Scenes with at most this number of walls simulate all of them."""
_CELL = 1.0
"""Width of the grid cells [m]. The simulated walls are selected again when the robot or an object changes its cell."""
_ROBOT_EXTENT = 1.0
"""Upper bound of the robot's radius including its arms [m]."""
_SLACK = 0.5
"""Distance that the robot or an object may move beyond its cell within a sample time [m]; it allows 5 m/s."""
_MOST_KEPT = 16
"""Number of models with different wall selections that a world caches."""


@functools.cache
def _compiled_control(robot: Robot, gains: lowlevel.Gains, timestep: float) -> Callable[[np.ndarray], Array]:
    """The low-level control, (state, sensed, command) -> (state, torque), compiled once for all engines.

    It is compiled even for one world: NumPy takes twenty times as long for its about 80 small array operations. All
    arguments are packed into one array ``[W, 10 + (NQ + NV) + 6]`` and all results into another one ``[W, 10 + 9]``,
    because passing each field separately takes longer than the computation.
    """

    def control(inputs: Array) -> Array:
        sensed, command = inputs[:, _MEMORY : _MEMORY + _SENSED], inputs[:, _MEMORY + _SENSED :]
        now = readout(sensed[:, :NQ], sensed[:, NQ:])
        wanted = Command(command[:, :3], *(command[:, i] for i in (3, 4, 5)))
        state, torque = lowlevel.control(robot, gains, _unpacked(inputs[:, :_MEMORY]), now, command=wanted, dt=timestep)
        after = jnp.concatenate([*_columns(state), torque], axis=-1)
        # MuJoCo resets a diverged world, but it prints a warning in every step if a motor command is not finite.
        return jnp.where(jnp.isfinite(after), after, 0.0)

    return jax.jit(control)


def _unpacked(memory: Array) -> lowlevel.LowLevelState:
    pairs, scalars = (memory[:, 2 * i : 2 * i + 2] for i in range(3)), (memory[:, i] for i in range(6, 10))
    return lowlevel.LowLevelState(*pairs, *scalars)


def _columns(tree: Any) -> list[Any]:
    """Fields ``[W, n]`` or ``[W]`` of a tree as a list of columns ``[W, n]``."""
    return [x if x.ndim == 2 else x[:, None] for x in jax.tree.leaves(tree)]


def _packed(*parts: Any) -> np.ndarray:
    """Concatenate the fields of all parts to one array ``[W, n]``."""
    return np.concatenate([np.asarray(column) for column in _columns(parts)], axis=-1).astype(np.float32)


class World(NamedTuple):
    """Complete state of W worlds."""

    physics: Float[np.ndarray, "W n"]
    """MuJoCo's full physics state."""
    control: lowlevel.LowLevelState
    """State of the low-level control."""
    wall_contact: Bool[np.ndarray, "W"]
    """Whether any part of the robot touched a wall during the last step."""
    wall_parts: Bool[np.ndarray, "W P"]
    """Which of scene.PARTS touched a wall during the last step."""


class _Stage(NamedTuple):
    """Model and scratch data of one world."""

    model: mujoco.MjModel
    data: mujoco.MjData


class MujocoEngine(TrueStates):
    """Steps W worlds of one structure with C MuJoCo. Holds compiled models and scratch memory, never state.

    Args:
        scenes: one per world.
        gains: gains of the low-level control.
        threads: number of threads that share the worlds.
    """

    def __init__(self, scenes: Sequence[Scene], gains: lowlevel.Gains | None = None, threads: int = 1) -> None:
        check_forked()
        self.gains = gains or lowlevel.Gains()
        first = scenes[0]
        self.timestep = float(first.model.opt.timestep)
        self._torso = first.model.body("robot/torso").id
        self._control = _compiled_control(first.robot, self.gains, self.timestep)
        ends = np.linspace(0, len(scenes), min(threads, len(scenes)) + 1).astype(int)
        self._parts = [slice(a, b) for a, b in itertools.pairwise(ends)]
        self._pool = ThreadPoolExecutor(len(self._parts)) if len(self._parts) > 1 else None
        self._use(scenes)

    def _use(self, scenes: Sequence[Scene]) -> None:
        _check_structure([s.model for s in scenes])
        self.scenes = list(scenes)
        self._stages: list[dict[Any, _Stage]] = [{} for _ in scenes]

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle as constructor arguments, because threads and scratch memory can't be copied."""
        return type(self), (self.scenes, self.gains, len(self._parts))

    def close(self) -> None:
        """Shut down the thread pool."""
        if self._pool is not None:
            self._pool.shutdown()

    def init(self) -> World:
        """State of all worlds at their scenes' initial configuration, with folded arms."""
        rows = []
        for scene in self.scenes:
            data = mujoco.MjData(scene.model)
            data.qpos[:] = scene.qpos0
            mujoco.mj_forward(scene.model, data)
            rows.append(_state(scene.model, data))
        batch = (len(rows),)
        control = lowlevel.init(np, batch, TUCKED_REACH, TUCKED_HEIGHT)
        return World(np.array(rows), control, np.zeros(batch, dtype=bool), np.zeros((*batch, len(PARTS)), dtype=bool))

    def change(self, scenes: Sequence[Scene]) -> None:
        """Replace the scenes by others of the same structure, for instance to change a mass or a brake during a run.

        The worlds' states stay valid. The new scenes' initial configurations are not used.
        """
        _check_structure([self.scenes[0].model, *(s.model for s in scenes)])
        self._use(scenes)

    def observe(self, world: World) -> Observation:
        """Observation of the current states, with zero wrench."""
        none = np.zeros((len(self.scenes), len(self.scenes[0].conditions), 3))
        return observation(self.scenes[0], world.physics[:, 0], *self._split(world.physics), wrench=none)

    def step(
        self, world: World, command: Command, duration: float = DT, push: Float[np.ndarray, "W 6"] | None = None
    ) -> tuple[World, Observation]:
        """Step all worlds with a constant command.

        Args:
            world: state of the W worlds.
            command: constant command, fields batched ``[W, ...]``.
            duration: time to simulate [s].
            push: external disturbance on the robot: force [N] and torque [N m] in {W} at the torso's CoM.

        Returns:
            The new state, and its observation with the mean wrench over ``duration``.
        """
        world, track = self.advance(world, command, duration, 1, push=push)
        wrench = np.asarray(track.wrench)
        return world, observation(self.scenes[0], world.physics[:, 0], *self._split(world.physics), wrench=wrench)

    def advance(
        self,
        world: World,
        command: Command,
        duration: float,
        readings: int,
        *,
        push: Float[np.ndarray, "W 6"] | None = None,
    ) -> tuple[World, Track]:
        """Like :meth:`step`, but returns the states at the ends of ``readings`` equal parts of ``duration``.

        Args:
            world: state of the W worlds.
            command: constant command, fields batched ``[W, ...]``.
            duration: time to simulate [s].
            readings: number of parts T.
            push: external disturbance on the robot: force [N] and torque [N m] in {W} at the torso's CoM.

        Returns:
            The new state, and the motion at the ends of the parts.
        """
        substeps = round(duration / self.timestep / readings)
        hold = functools.partial(self._hold, readings=readings, substeps=substeps)
        parts = [(p, _cut(world, p), _cut(command, p), None if push is None else push[p]) for p in self._parts]
        if self._pool is None:
            return hold(*parts[0])
        worlds, tracks = zip(*self._pool.map(hold, *zip(*parts, strict=True)), strict=True)
        joined: World = jax.tree.map(lambda *each: np.concatenate(each), *worlds)
        physics, torque = (np.concatenate([getattr(t, name) for t in tracks], axis=1) for name in ("physics", "torque"))
        return joined, Track(physics, torque, np.concatenate([t.wrench for t in tracks]), joined.wall_parts)

    @single_precision
    def _hold(
        self, part: slice, world: World, command: Command, push: np.ndarray | None, *, readings: int, substeps: int
    ) -> tuple[World, Track]:
        """Step the worlds of one part for ``readings`` times ``substeps`` physics steps."""
        scenes, stages = self.scenes[part], [*map(self._stage, range(part.start, part.stop), world.physics)]
        for i, (model, data) in enumerate(stages):
            _begin(model, data, world.physics[i])
            if push is not None:
                data.xfrc_applied[self._torso] = push[i]
        inputs = _packed(world.control, [np.zeros((len(stages), _SENSED))], command)
        felt: list[tuple[int, np.ndarray, np.ndarray]] = []
        physics, torques = np.empty((readings, *world.physics.shape)), np.empty((readings, len(stages), 9))
        done = self._asked(inputs, stages)
        for reading in range(readings):
            for _ in range(substeps):
                inputs[:, :_MEMORY] = done[:, :_MEMORY]
                for i, (model, data) in enumerate(stages):
                    data.ctrl[:] = done[i, _MEMORY:]
                    before = data.qpos.copy()
                    # With a warm start the solver sometimes stops at once, with a velocity error of a few cm/s.
                    data.qacc_warmstart[:] = 0.0
                    mujoco.mj_step(model, data)
                    if data.sensordata.any():
                        # MuJoCo evaluates contact sensors at the configuration before the step.
                        felt.append((i, before, data.sensordata.copy()))
                done = self._asked(inputs, stages)
            for i, (model, data) in enumerate(stages):
                physics[reading, i] = _state(model, data)
            torques[reading] = done[:, _MEMORY:]
        wrench, touched = np.zeros((len(stages), len(scenes[0].conditions), 3)), np.zeros_like(world.wall_parts)
        if felt:
            worlds, qpos, sensors = (np.stack(column) for column in zip(*felt, strict=True))
            np.add.at(wrench, worlds, planar_wrench(scenes[0], qpos, sensors) / (readings * substeps))
            np.logical_or.at(touched, worlds, (sensors[..., scenes[0].wall_sensor] > 0).any(axis=-1))
        ends = world.physics[:, 0] + substeps * self.timestep * np.arange(1, readings + 1)[:, None]
        # MuJoCo resets a diverged world to its initial state and to time 0.
        lost = ~(np.isfinite(world.physics.sum(axis=-1)) & (physics[..., 0] > ends - 0.5 * self.timestep))
        physics[lost], physics[lost, 0] = np.nan, ends[lost]
        after = World(physics[-1], _unpacked(inputs[:, :_MEMORY]), touched.any(axis=-1), touched)
        return after, Track(physics, torques, wrench, touched)

    def _asked(self, inputs: np.ndarray, stages: Sequence[_Stage]) -> np.ndarray:
        """The control's new state and torque ``[w, 10 + 9]`` for the worlds' current states."""
        for i, (_, data) in enumerate(stages):
            inputs[i, _MEMORY : _MEMORY + NQ] = data.qpos[:NQ]
            inputs[i, _MEMORY + NQ : _MEMORY + _SENSED] = data.qvel[:NV]
        return np.asarray(self._control(inputs))

    def _stage(self, index: int, state: Float[np.ndarray, "n"]) -> _Stage:
        """Model and scratch memory of world ``index`` in this state; of many walls, it has only those nearby."""
        scene, kept = self.scenes[index], self._stages[index]
        places = state[1 + np.concatenate([[0], scene.object_qpos])[:, None] + [0, 1]]
        many = len(scene.walls) > _FEW_WALLS and scene.spec is not None
        cells = np.round(places / _CELL) if many else np.zeros(0)
        key = cells.tobytes()
        if key not in kept:
            if len(kept) >= _MOST_KEPT:
                kept.pop(next(iter(kept)))
            extents = np.array([_ROBOT_EXTENT, *(np.hypot(*c.half_extents) for c in scene.conditions)])
            reach = extents + _SLACK + _CELL / np.sqrt(2)
            model = scene.model_near(cells * _CELL, reach) if many else scene.model
            kept[key] = _Stage(model, mujoco.MjData(model))
        return kept[key]

    @single_precision
    def torque(self, world: World, command: Command) -> Float[np.ndarray, "W 9"]:
        """Motor torques that the control commands in this state [N m]. A real robot measures them as motor currents."""
        qpos, qvel = self._split(world.physics)
        inputs = _packed(world.control, [qpos[:, :NQ], qvel[:, :NV]], command)
        return np.asarray(self._control(inputs), dtype=np.float64)[:, _MEMORY:]


def _begin(model: mujoco.MjModel, data: mujoco.MjData, state: np.ndarray) -> None:
    """Reset the scratch data and set it to the given state.

    MuJoCo sets the velocity of a sleeping tree to exactly zero. Trees with zero velocity may sleep again at once.
    """
    mujoco.mj_resetData(model, data)
    mujoco.mj_setState(model, data, state, _FULL)
    for tree in range(model.ntree):
        first = model.tree_dofadr[tree]
        if not data.qvel[first : first + model.tree_dofnum[tree]].any():
            data.tree_asleep[tree] = -1


def _state(model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
    """MuJoCo's full physics state."""
    out = np.empty(mujoco.mj_stateSize(model, _FULL))
    mujoco.mj_getState(model, data, out, _FULL)
    return out


def _check_structure(models: Sequence[mujoco.MjModel]) -> None:
    """Raise ValueError unless all models have the same sizes, since MuJoCo would read past its arrays otherwise."""
    shapes = {(m.nq, m.nv, m.nbody, m.na, m.nsensordata) for m in models}
    if len(shapes) > 1:
        raise ValueError("the worlds of one engine must have the same structure: family and number of objects")


def _cut(tree: Any, worlds: slice) -> Any:
    return jax.tree.map(lambda field: field[worlds], tree)
