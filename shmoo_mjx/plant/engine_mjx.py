"""MJX engine with the common interface ``init() -> state`` and ``step(state, command) -> state, observation``.

A batch of W worlds is one vmapped function. Model fields that differ between worlds (an object's size, mass or
friction; a randomised robot) are batched, all others are shared. ``step`` is pure and can be called inside jit, scan
and vmap. If JAX has several devices, each device steps an equal part of the worlds. Set
``XLA_FLAGS=--xla_force_host_platform_device_count=N`` before JAX starts to use a CPU as N devices.
"""

from __future__ import annotations

import contextlib
import copy
import functools
import importlib.util
import io
from collections.abc import Sequence
from typing import Any, Literal, NamedTuple

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from jax.sharding import AxisType, NamedSharding, PartitionSpec

from shmoo_mjx.arrays import Array, Bool, Float, single_precision
from shmoo_mjx.base.processes import check_forked
from shmoo_mjx.errors import ShmooError
from shmoo_mjx.geometry.hands import TUCKED_HEIGHT, TUCKED_REACH
from shmoo_mjx.plant import lowlevel
from shmoo_mjx.plant.observe import TrueStates, observation, planar_wrench
from shmoo_mjx.plant.robot import readout
from shmoo_mjx.plant.scene import PARTS, Scene
from shmoo_mjx.types import DT, Command, Observation, Track

with contextlib.redirect_stdout(io.StringIO()):  # MJX prints a message if its optional Warp back end is missing
    from mujoco import mjx


class MjxWorld(NamedTuple):
    """Complete state of W worlds; inside a vmap the axis W is absent."""

    physics: Float[jax.Array, "... n"]
    """Time, qpos, qvel, act (length 1 + nq + nv + na), in the layout of C MuJoCo's physics state."""
    control: lowlevel.LowLevelState
    """State of the low-level control."""
    wall_contact: Bool[jax.Array, "..."]
    """Whether any part of the robot touched a wall during the last step."""
    wall_parts: Bool[jax.Array, "... P"]
    """Which of scene.PARTS touched a wall during the last step."""
    warm_start: Float[jax.Array, "... nv"]
    """Initial guess of the constraint solver: joint accelerations [m/s^2, rad/s^2]."""


def check_backend(impl: str, walls: bool = False) -> None:
    """Check that MJX's back end ``impl`` can run here.

    Args:
        impl: "jax" or "warp".
        walls: whether the scenes have walls.

    Raises:
        ShmooError: ``impl`` is "warp" and the package warp-lang is missing, or the scenes have walls.
    """
    if impl != "warp":
        return
    if importlib.util.find_spec("warp") is None:
        raise ShmooError("impl='warp': the package warp-lang is missing; pip install warp-lang, or use impl='jax'.")
    if walls:
        raise ShmooError(
            "impl='warp': does not report which part touches a wall; use impl='jax' where there are walls."
        )


@single_precision
def stack_models(models: Sequence[mjx.Model]) -> tuple[mjx.Model, mjx.Model]:
    """Stack the models of W worlds into one model.

    Args:
        models: one model per world, all of the same structure.

    Returns:
        The model, in which arrays that differ between worlds have a leading axis W, and the ``in_axes`` tree for vmap.
    """
    leaves = [jax.tree.leaves(m) for m in models]
    tree = jax.tree.structure(models[0])
    stacked, axes = [], []
    for column in zip(*leaves, strict=True):
        same = _alike(column)
        stacked.append(column[0] if same else jnp.stack(column))
        axes.append(None if same else 0)
    return jax.tree.unflatten(tree, stacked), jax.tree.unflatten(tree, axes)


def _alike(column: Sequence[Array]) -> bool:
    return all(c is column[0] or np.array_equal(c, column[0]) for c in column[1:])


class _Solver(NamedTuple):
    """Limits of the constraint solver. They are static: a change recompiles."""

    iterations: int
    line_search: int
    tolerance: float


class MjxEngine(TrueStates):
    """Steps W worlds of one structure with MJX. Holds models, never state.

    Args:
        scenes: one per world, each built with ``engine="mjx"``. Scenes may share a model.
        gains: gains of the low-level control.
        iterations: iterations of the constraint solver. More are more accurate and slower (see docs/plant.md). Static:
            a change recompiles.
        line_search: iterations of the solver's line search; static.
        tolerance: tolerance at which the solver stops. MuJoCo's default of 1e-8 is out of reach in single precision:
            every world would use all iterations.
        devices: devices that share the worlds. By default all devices, or only the first if W is not a multiple of
            their number.
        impl: MJX's back end: "jax" or "warp". Warp is for NVIDIA GPUs; it also runs on a CPU, slowly.
    """

    model: mjx.Model
    """Model of all worlds; fields that differ between worlds have a leading axis W."""

    @single_precision
    def __init__(
        self,
        scenes: Sequence[Scene],
        gains: lowlevel.Gains | None = None,
        *,
        iterations: int = 8,
        line_search: int = 10,
        tolerance: float = 1e-5,
        devices: Sequence[jax.Device] | None = None,
        impl: Literal["jax", "warp"] = "jax",
    ) -> None:
        check_forked()
        self.scenes = list(scenes)
        check_backend(impl, bool(self.scenes[0].wall_geoms))
        self._impl = impl
        self.gains = gains or lowlevel.Gains()
        first = self.scenes[0]
        if not all(s.framed for s in self.scenes):
            raise ValueError("MjxEngine needs scenes built with engine='mjx'")
        self.timestep = float(first.model.opt.timestep)
        self._solver = _Solver(iterations, line_search, tolerance)
        self._other_model = False
        self._dry = np.zeros(first.model.nv, dtype=bool)
        put = self._put_once(self.scenes)
        chosen = list(devices or jax.devices())
        chosen = chosen if len(self.scenes) % len(chosen) == 0 else chosen[:1]
        self._mesh = jax.make_mesh((len(chosen),), ("world",), axis_types=(AxisType.Auto,), devices=chosen)
        self._single = put[id(first.model)]
        self._template = self._make_data(first.model)
        self._torso = first.model.body("robot/torso").id
        self._is_wall = np.zeros(first.model.ngeom, dtype=bool)
        self._is_wall[list(first.wall_geoms)] = True
        self._asked = jax.jit(
            lambda world, command: lowlevel.control(
                first.robot, self.gains, world.control, self.robot(world), command=command, dt=self.timestep
            )[1]
        )

        def observed(physics: Array) -> Observation:
            none = jnp.zeros((*physics.shape[:-1], len(first.conditions), 3))
            return observation(first, physics[..., 0], *self._split(physics), wrench=none)

        self._observed = jax.jit(observed)
        if len(put) == 1:
            self._use(self._single, jax.tree.map(lambda _: None, self._single))
        else:
            self._use(*stack_models([put[id(s.model)] for s in self.scenes]))

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle as constructor arguments: a copy recompiles and uses all available devices."""
        if self._other_model:
            raise TypeError("an engine made by with_model can't be copied; copy the first one, and call with_model")
        make = functools.partial(type(self), impl=self._impl, **self._solver._asdict())
        return make, (self.scenes, self.gains)

    def _put_once(self, scenes: Sequence[Scene]) -> dict[int, mjx.Model]:
        """The scenes' models on the device, keyed by ``id`` of the C MuJoCo model."""
        models = {id(scene.model): scene.model for scene in scenes}
        # The set of joints with dry friction is part of the compiled structure, so all worlds need the same set.
        self._dry = self._dry | np.any([model.dof_frictionloss > 0 for model in models.values()], axis=0)
        return {key: _put(model, self._impl, self._dry, self._solver) for key, model in models.items()}

    @single_precision
    def change(self, scenes: Sequence[Scene]) -> None:
        """Replace the scenes by others of the same structure; the worlds' states stay valid.

        Recompiles only if a field differs between the new worlds that was equal in all old worlds, or if a joint has
        dry friction for the first time.
        """
        before, put = self._dry, self._put_once(scenes)
        models, self.scenes = [put[id(s.model)] for s in scenes], list(scenes)
        if not np.array_equal(before, self._dry):
            self._single = models[0]
            self._template = self._make_data(scenes[0].model)
            self._use(*stack_models(models))
            return
        columns = list(zip(*map(jax.tree.leaves, models), strict=True))
        old, tree = jax.tree.flatten(self.model)
        batched = [np.ndim(all_) > np.ndim(column[0]) for all_, column in zip(old, columns, strict=True)]
        if any(not own and not _alike(column) for own, column in zip(batched, columns, strict=True)):
            self._use(*stack_models(models))
            return
        new = [jnp.stack(c) if own else c[0] for own, c in zip(batched, columns, strict=True)]
        placed = [jax.device_put(leaf, was.sharding) for leaf, was in zip(new, old, strict=True)]
        self.model = jax.tree.unflatten(tree, placed)

    def _make_data(self, model: mujoco.MjModel) -> mjx.Data:
        """Template data for a step; for Warp, with buffers for the contacts and constraints of a device's worlds."""
        if self._impl == "jax":
            return mjx.make_data(self._single)
        # Warp has one contact buffer for all worlds and drops contacts when it is full. Reserve as many per world as
        # MJX's JAX back end does.
        most = mjx.make_data(_put(model, "jax", self._dry, self._solver))._impl
        worlds = len(self.scenes) // self._mesh.size
        return mjx.make_data(model, impl="warp", naconmax=worlds * len(most.contact.dist), njmax=len(most.efc_type))

    @single_precision
    def with_model(self, model: mjx.Model, in_axes: mjx.Model) -> MjxEngine:
        """This engine with another model of the same structure, such as one from plant/randomize.py.

        Args:
            model: model of all worlds; fields that differ between worlds have a leading axis W.
            in_axes: tree for vmap that says which fields have the axis W.
        """
        other = object.__new__(type(self))
        other.__dict__ = self.__dict__ | {"_other_model": True}
        other._use(model, in_axes)
        return other

    def _use(self, model: mjx.Model, in_axes: mjx.Model) -> None:
        each, shared = PartitionSpec("world"), PartitionSpec()
        parts = jax.tree.map(lambda one, all_: each if np.ndim(all_) > np.ndim(one) else shared, self._single, model)
        place = functools.partial(NamedSharding, self._mesh)
        self.model, self.in_axes = jax.device_put(model, jax.tree.map(place, parts)), in_axes
        self._placement = place(each)

        def step_all(
            model: mjx.Model, world: MjxWorld, command: Command, push: Array, *, substeps: int
        ) -> tuple[MjxWorld, Observation]:
            one = jax.vmap(functools.partial(self.step_one, substeps=substeps), in_axes=(in_axes, 0, 0, 0))
            # Each device runs the solver for its own worlds; no communication between devices.
            return jax.shard_map(
                one, mesh=self._mesh, in_specs=(parts, each, each, each), out_specs=each, check_vma=False
            )(model, world, command, push)

        self._batched = jax.jit(step_all, static_argnames="substeps", out_shardings=self._placement)

    @single_precision
    def init(self) -> MjxWorld:
        """State of all worlds at their scenes' initial configuration, with folded arms."""
        worlds, nv, na = len(self.scenes), self.scenes[0].model.nv, self.scenes[0].model.na
        qpos = np.stack([s.qpos0 for s in self.scenes])
        physics = np.concatenate([np.zeros((worlds, 1)), qpos, np.zeros((worlds, nv + na))], axis=-1)
        world = MjxWorld(
            physics=jnp.asarray(physics, dtype=jnp.float32),
            control=lowlevel.init(jnp, (worlds,), TUCKED_REACH, TUCKED_HEIGHT),
            wall_contact=jnp.zeros(worlds, dtype=bool),
            wall_parts=jnp.zeros((worlds, len(PARTS)), dtype=bool),
            warm_start=jnp.zeros((worlds, nv)),
        )
        # Later states are committed to the devices. The first state must be too, otherwise the second step recompiles.
        return jax.device_put(world, self._placement)

    @single_precision
    def scratch_bytes(self) -> int:
        """Temporary memory of one compiled step of all worlds [bytes], without inputs and outputs, over all devices."""
        world = self.init()
        command = Command(*(jnp.zeros((len(self.scenes), *shape)) for shape in ((3,), (), (), ())))
        push = jnp.zeros((len(self.scenes), 6))
        command, push = jax.device_put((command, push), self._placement)
        lowered = self._batched.lower(self.model, world, command, push, substeps=round(DT / self.timestep))
        analysis = lowered.compile().memory_analysis()
        return 0 if analysis is None else int(analysis.temp_size_in_bytes) * self._mesh.size

    @single_precision
    def observe(self, world: MjxWorld) -> Observation:
        """Observation of the current states, with zero wrench."""
        return self._observed(world.physics)

    @single_precision
    def step(
        self, world: MjxWorld, command: Command, duration: float = DT, push: Float[Array, "W 6"] | None = None
    ) -> tuple[MjxWorld, Observation]:
        """Step all worlds with a constant command.

        Args:
            world: state of the W worlds.
            command: constant command, fields batched ``[W, ...]``.
            duration: time to simulate [s].
            push: external disturbance on the robot: force [N] and torque [N m] in {W} at the torso's CoM.

        Returns:
            The new state, and its observation with the mean wrench over ``duration``.
        """
        push = np.zeros((*world.physics.shape[:-1], 6)) if push is None else push
        command, push = jax.device_put(jax.tree.map(jnp.asarray, (command, push)), self._placement)
        return self._batched(self.model, world, command, push, substeps=round(duration / self.timestep))

    @single_precision
    def step_one(
        self,
        model: mjx.Model,
        world: MjxWorld,
        command: Command,
        push: Float[Array, "6"],
        *,
        substeps: int,
        gains: lowlevel.Gains | None = None,
    ) -> tuple[MjxWorld, Observation]:
        """Step one world without a batch axis. :meth:`step` vmaps this function; callers can vmap it themselves.

        Args:
            model: model of this world.
            world: state of this world.
            command: constant command, without batch axis.
            push: force [N] and torque [N m] in {W} at the torso's CoM.
            substeps: number of physics steps; static.
            gains: gains of this world's low-level control, by default the engine's. Their fields may be traced.

        Returns:
            The new state, and its observation with the mean wrench over the physics steps.
        """
        data = self._template.replace(xfrc_applied=self._template.xfrc_applied.at[self._torso].set(push))

        def substep(carry: MjxWorld, _: None) -> tuple[MjxWorld, Array]:
            qpos, qvel = self._split(carry.physics)
            control, torque = lowlevel.control(
                self.scenes[0].robot,
                gains or self.gains,
                carry.control,
                readout(qpos, qvel),
                command=command,
                dt=self.timestep,
            )
            motors = carry.physics[1 + len(qpos) + len(qvel) :]
            now = data.replace(
                time=carry.physics[0], qpos=qpos, qvel=qvel, act=motors, ctrl=torque, qacc_warmstart=carry.warm_start
            )
            after = mjx.step(model, now)
            # MuJoCo evaluates contact sensors at the configuration before the step.
            wrench = planar_wrench(self.scenes[0], qpos, after.sensordata)
            physics = jnp.concatenate([jnp.atleast_1d(after.time), after.qpos, after.qvel, after.act])
            parts = carry.wall_parts | self._touched(after)
            return MjxWorld(physics, control, jnp.any(parts), parts, after.qacc_warmstart), wrench

        start = world._replace(wall_parts=jnp.zeros_like(world.wall_parts))
        world, wrenches = jax.lax.scan(substep, start, None, length=substeps)
        wrench = wrenches.mean(axis=0)
        return world, observation(self.scenes[0], world.physics[0], *self._split(world.physics), wrench=wrench)

    def advance(
        self,
        world: MjxWorld,
        command: Command,
        duration: float,
        readings: int,
        *,
        push: Float[Array, "W 6"] | None = None,
    ) -> tuple[MjxWorld, Track]:
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
        rows = []
        for _ in range(readings):
            world, observed = self.step(world, command, duration / readings, push)
            rows.append((world.physics, self.torque(world, command), observed.wrench, world.wall_parts))
        physics, torque, wrench, touched = (np.stack(column) for column in zip(*rows, strict=True))
        return world, Track(physics.astype(float), torque.astype(float), wrench.mean(axis=0), touched.any(axis=0))

    @single_precision
    def torque(self, world: MjxWorld, command: Command) -> Float[Array, "... 9"]:
        """Motor torques that the control commands in this state [N m]. A real robot measures them as motor currents."""
        return self._asked(world, command)

    def _touched(self, data: mjx.Data) -> Array:
        """Which of PARTS touch a wall, ``[P]``."""
        if not self.scenes[0].wall_geoms:
            return jnp.zeros(len(PARTS), dtype=bool)
        contact = data._impl.contact
        walls = jnp.asarray(self._is_wall)[contact.geom].any(axis=-1) & (contact.dist < 0)
        part = jnp.asarray(self.scenes[0].part_of_geom)[contact.geom].max(axis=-1)
        return jnp.any((part == np.arange(len(PARTS))[:, None]) & walls, axis=-1)


def _put(model: mujoco.MjModel, impl: str, dry: np.ndarray, solver: _Solver) -> mjx.Model:
    """The model on the device; joints in ``dry`` ``[nv]`` get at least a tiny dry friction."""
    model = copy.deepcopy(model)
    model.dof_frictionloss[dry] = np.maximum(model.dof_frictionloss[dry], 1e-9)
    model.opt.iterations, model.opt.ls_iterations, model.opt.tolerance = solver
    return mjx.put_model(model, impl=impl)
