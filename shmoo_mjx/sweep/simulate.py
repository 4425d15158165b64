"""Simulates batches of worlds in MJX: vmapped, sharded over devices, and sized to fit their memory.

A batch is one compiled program that advances its worlds by one second. All differences between worlds are arguments.
Each device computes an equal part of the worlds, without communication between devices.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Sequence
from enum import IntEnum
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec

from shmoo_mjx.arrays import Array, single_precision
from shmoo_mjx.behavior.push_task import AT_REST
from shmoo_mjx.behavior.skills import one_push
from shmoo_mjx.behavior.skills.retreat import CLEAR
from shmoo_mjx.behavior.skills.settings import hands_to_face
from shmoo_mjx.control.observation import ObjectObservation
from shmoo_mjx.geometry import se2
from shmoo_mjx.geometry.hands import CONTACT_FORCE
from shmoo_mjx.learning.contact_prior import kind_of
from shmoo_mjx.learning.weights import Weights
from shmoo_mjx.plant.engine_mjx import MjxEngine, MjxWorld
from shmoo_mjx.plant.lowlevel import Gains
from shmoo_mjx.plant.observe import fallen
from shmoo_mjx.plant.randomize import perturbed
from shmoo_mjx.sensing import Senses, odometry, senses_named
from shmoo_mjx.sensing import senses as sensing
from shmoo_mjx.sensing.odometry import TICK
from shmoo_mjx.sensing.senses import Noise, SensorState
from shmoo_mjx.sweep import pushers
from shmoo_mjx.sweep.config import SweepConfig
from shmoo_mjx.sweep.parameters import MOST_DELAY
from shmoo_mjx.sweep.rows import Tally, rows_of
from shmoo_mjx.sweep.worlds import Drawn, WorldSetup, draw, scene_of, set_up
from shmoo_mjx.types import DT, Command, Observation

_TICKS = round(DT / TICK)
_MOST = round(MOST_DELAY / TICK)
_SECOND = round(1.0 / DT)
"""Samples per call of the compiled program (one second). The arms unfold in the first second."""
_AT_ONCE = 4
"""Number of worlds whose plans a CPU computes together. More would exceed its caches."""
_SHARE = 0.8
"""Largest fraction of the available memory that a batch may use."""


class Stream(IntEnum):
    """Purposes of a world's random numbers; each has its own random stream."""

    CONTROLLER = 0
    FIRST_LOOK = 1
    SENSES = 2
    DROP_OUTS = 3
    SWEPT_NOISE = 4


class State(NamedTuple):
    """State of W worlds between two samples."""

    world: MjxWorld
    """State of the physics and the low-level control."""
    sent: Command
    """The last H commands, newest first, fields ``[W, H, ...]``."""
    sensor_state: SensorState
    """State of the simulated sensors, fields ``[W, 1, ...]``."""
    observed: ObjectObservation
    """Last sensed observation."""
    memory: one_push.PolicyState
    """State of the pushing policy, with the phase."""
    samples: Array
    """Number of samples since the start, ``[W]`` int."""
    tally: Tally
    """Running statistics."""


class Batches:
    """Simulates worlds of one family with one controller, batch by batch.

    Args:
        config: configuration of the sweep.
        family: family of the objects.
        controller: name of the controller in the sweep.
        weights: weights of the learned model.
        memory: memory that all devices together may use [bytes], by default the free memory.
        devices: devices that share the worlds, by default all of JAX's devices.
    """

    @single_precision
    def __init__(
        self,
        config: SweepConfig,
        family: str,
        controller: str,
        weights: Weights,
        *,
        memory: int | None = None,
        devices: Sequence[jax.Device] | None = None,
    ) -> None:
        self.config = config
        self._senses = senses_named(config.senses)
        first = draw(config, family, 0)
        self.scene = scene_of(first)
        chosen = list(devices or jax.devices())
        self.engine = MjxEngine([self.scene], devices=chosen[:1])
        self._still = jax.tree.map(lambda x: np.asarray(x)[0], self.engine.init())
        self.mesh = Mesh(np.asarray(chosen), ("world",))
        self._each = NamedSharding(self.mesh, PartitionSpec("world"))
        self._policy = pushers.policy_of(config.controllers[controller], weights, kind_of(first.condition))
        nominal = jax.device_get(self.engine.model)
        self._nominal = jax.device_put(nominal, NamedSharding(self.mesh, PartitionSpec()))
        self._one = set_up(config, [first], nominal, self.scene)
        self.free = memory or free_memory(chosen)
        each = -(-min(config.shard, config.worlds) // len(chosen))
        self.batch = each * len(chosen)
        self._compile()
        while self.bytes > self.free * _SHARE and each > 1:
            each = max(min(int(each * self.free * _SHARE / self.bytes), each - 1), 1)
            self.batch = each * len(chosen)
            self._compile()

    def _compile(self) -> None:
        shapes = jax.tree.map(
            lambda x: jax.ShapeDtypeStruct((self.batch, *x.shape[1:]), x.dtype, sharding=self._each), self._one
        )
        each, shared = PartitionSpec("world"), PartitionSpec()
        parted = partial(jax.shard_map, mesh=self.mesh, out_specs=each, check_vma=False)
        begin = parted(jax.vmap(self._begin, in_axes=(None, 0)), in_specs=(shared, each))
        self._start = jax.jit(begin).lower(self._nominal, shapes).compile()
        state = jax.eval_shape(begin, self._nominal, shapes)
        state = jax.tree.map(lambda x: jax.ShapeDtypeStruct(x.shape, x.dtype, sharding=self._each), state)
        second = jax.jit(parted(self._second, in_specs=(shared, each, each)), donate_argnums=2)
        self._advance = second.lower(self._nominal, shapes, state).compile()
        used: Any = self._advance.memory_analysis()
        parts = ("temp", "argument", "output")
        size = sum(getattr(used, f"{part}_size_in_bytes", 0) for part in parts)
        self.bytes = int(size - getattr(used, "alias_size_in_bytes", 0)) * self.mesh.size

    @single_precision
    def time_one(self) -> float:
        """Estimated computing time of a batch [s], from its first simulated second with copies of the first world."""
        many = jax.tree.map(lambda x: jnp.repeat(x, self.batch, axis=0), self._one)
        many = jax.device_put(many, self._each)
        state = self._start(self._nominal, many)
        jax.block_until_ready(state)
        began = time.perf_counter()
        jax.block_until_ready(self._advance(self._nominal, many, state))
        return (time.perf_counter() - began) * self.config.seconds

    @single_precision
    def run(
        self, worlds: Sequence[Drawn], progress: Callable[[float], None] = lambda fraction: None
    ) -> list[dict[str, Any]]:
        """Simulate worlds and return their result rows in order, see :func:`rows_of`.

        An incomplete last batch is padded with copies of its last world.

        Args:
            worlds: worlds to simulate.
            progress: function called with the fraction done.
        """
        rows: list[dict[str, Any]] = []
        for first in range(0, len(worlds), self.batch):
            part = list(worlds[first : first + self.batch])
            filled = part + [part[-1]] * (self.batch - len(part))
            setup = jax.device_put(set_up(self.config, filled, self._nominal, self.scene), self._each)
            state = self._start(self._nominal, setup)
            for second in range(self.config.seconds):
                state = self._advance(self._nominal, setup, state)
                progress((first + len(part) * (second + 1) / self.config.seconds) / len(worlds))
                if np.all(np.asarray(state.memory.phase) >= one_push.DONE):
                    break
            rows += rows_of(self.config, part, jax.device_get((state.memory.phase, state.tally)))
        return rows

    def _begin(self, nominal: Any, setup: WorldSetup) -> State:
        physics = jnp.concatenate([jnp.zeros(1), setup.qpos, jnp.zeros(self.scene.model.nv)])
        world = jax.tree.map(jnp.asarray, self._still)._replace(physics=physics)
        truth = self.engine.observe(world)
        noise = jax.random.normal(key_of(setup, Stream.FIRST_LOOK), (1, 1, 3))
        # The robot knows the object's pose at the start (poses_known).
        sensor_state = sensing.first_state(
            self._senses, setup.sensing, setup.scenery, robot_pose=truth.robot_pose[None],
            object_pose=truth.object_pose[None], noise=noise, poses_known=True, remembers=MOST_DELAY + TICK,
        )  # fmt: skip
        sensor_state = jax.tree.map(lambda x: jnp.asarray(x, dtype=jnp.float32), sensor_state)
        still = Command(jnp.zeros(3), truth.robot_pose[2], world.control.reach, world.control.hand_height)
        sent = jax.tree.map(lambda x: jnp.broadcast_to(x, (_MOST // _TICKS + 1, *jnp.shape(x))), still)
        observed = _perceived(self._senses, setup, truth, sensor_state, wrench=jnp.zeros(3), samples=jnp.int32(0))
        memory = one_push.init(self._policy, observed, _task(setup), key_of(setup, Stream.CONTROLLER))
        zero = jnp.float32(0.0)
        tally = Tally(zero, zero, zero, zero, truth.object_pose[0])
        return State(world, sent, sensor_state, observed, memory, jnp.int32(0), tally)

    def _second(self, nominal: Any, setup: WorldSetup, state: State) -> State:
        """Advance all worlds of a device by one second."""

        def decide(inputs: tuple[Any, ...]) -> tuple[Command, one_push.PolicyState]:
            task, key, memory, observed, samples = inputs
            return one_push.step(self._policy, memory, observed, task, key=key, ready=samples >= _SECOND)

        def sample(state: State, _: None) -> tuple[State, None]:
            keys = jax.vmap(partial(key_of, stream=Stream.CONTROLLER))(setup)
            inputs = (jax.vmap(_task)(setup), keys, state.memory, state.observed, state.samples)
            if self.mesh.devices.flat[0].platform == "cpu":
                decided = jax.lax.map(decide, inputs, batch_size=_AT_ONCE)
            else:
                decided = jax.vmap(decide)(inputs)
            return jax.vmap(self._move, in_axes=(None, 0, 0, 0))(nominal, setup, state, decided), None

        return jax.lax.scan(sample, state, None, length=_SECOND)[0]

    def _move(
        self, nominal: Any, setup: WorldSetup, state: State, decided: tuple[Command, one_push.PolicyState]
    ) -> State:
        """Advance one world by one sample with the command ``decided``; a finished world does not change."""
        command, memory = decided
        sent = jax.tree.map(lambda new, old: jnp.concatenate([new[None], old[:-1]]), command, state.sent)
        model = nominal.tree_replace(setup.fields)
        model = model.tree_replace(perturbed(model, setup.factors, self.scene))
        gains = Gains(**setup.gains)
        substeps = round(TICK / self.engine.timestep)

        # The low-level control holds the estimated heading, so subtract the estimation error from the target.
        turned = 0.0 if self._senses.perfect else sensing.heading_error(state.sensor_state)[0]

        def tick(world: MjxWorld, number: Array) -> tuple[MjxWorld, Observation]:
            arrived = jax.tree.map(lambda x: x[commands_ago(setup.delay, number)], sent)
            arrived = arrived._replace(yaw=arrived.yaw - turned)
            return self.engine.step_one(model, world, arrived, jnp.zeros(6), substeps=substeps, gains=gains)

        world, track = jax.lax.scan(tick, state.world, jnp.arange(_TICKS))
        sensor_state = self._watched(setup, state, track)
        truth = jax.tree.map(lambda x: x[-1], track)
        wrench = track.wrench[:, 0].mean(axis=0)
        samples = state.samples + 1
        observed = _perceived(self._senses, setup, truth, sensor_state, wrench=wrench, samples=samples)
        memory = memory._replace(phase=_phase(memory.phase, truth, world, setup))
        after = State(
            world, sent, sensor_state, observed, memory, samples, _counted(state.tally, truth, wrench, samples)
        )
        return jax.tree.map(lambda a, b: jnp.where(state.memory.phase >= one_push.DONE, a, b), state, after)

    def _watched(self, setup: WorldSetup, state: State, track: Observation) -> SensorState:
        """Sensor state after the sample's ticks, of which ``track [T, ...]`` is the ground truth."""
        normal = jax.random.normal(key_of(setup, Stream.SENSES, state.samples), (_TICKS, 9))
        uniform = jax.random.uniform(key_of(setup, Stream.DROP_OUTS, state.samples), (_TICKS, 1, 1, 2))

        def look(sensor_state: SensorState, at: Any) -> tuple[SensorState, None]:
            robot, thing, drawn, chance, number = at
            noise = Noise(drawn[None, :6], drawn[None, None, 6:], chance)
            now = state.samples * _TICKS + number + 1
            after = sensing.tick(
                self._senses, setup.sensing, setup.scenery, sensor_state, robot_pose=robot[None],
                object_pose=thing[None], noise=noise, now=now,
            )  # fmt: skip
            return jax.tree.map(lambda new, old: new.astype(old.dtype), after, sensor_state), None

        ticks = (track.robot_pose, track.object_pose, normal, uniform, jnp.arange(_TICKS))
        return jax.lax.scan(look, state.sensor_state, ticks)[0]


def commands_ago(delay: Array, tick: Array) -> Array:
    """Age, in commands, of the command that the motors follow at a tick of a sample; 0 is the newest command.

    Args:
        delay: command delay [ticks].
        tick: number of the tick in the sample.
    """
    return jnp.maximum((delay - tick + _TICKS - 1) // _TICKS, 0)


def _task(setup: WorldSetup) -> one_push.WorldGoal:
    return one_push.WorldGoal(setup.face, setup.half_extents, setup.goal)


def key_of(setup: WorldSetup, stream: Stream, sample: Array | int = 0) -> Array:
    """Random key of one world for one purpose in one sample. All random numbers of a batch use these keys."""
    return jax.random.fold_in(jax.random.fold_in(setup.key, stream), sample)


def _perceived(
    senses: Senses, setup: WorldSetup, truth: Observation, sensor_state: SensorState, *, wrench: Array, samples: Array
) -> ObjectObservation:
    """Sensed observation of the true state, with the noise of the sweep's parameters.

    With perfect sensing, the estimate is the ground truth, delayed by the camera's delay.
    """
    error = setup.noise * jax.random.normal(key_of(setup, Stream.SWEPT_NOISE, samples), (11,))
    if senses.perfect:
        late = setup.sensing.frame_delay
        pose, before = (odometry.ago(sensor_state.objects, late + i)[0, 0] for i in (0, 1))
        moved = jnp.concatenate([pose[:2] - before[:2], se2.wrap(pose[2:] - before[2:])])
        robot, speed, frame = truth.robot_pose, truth.robot_twist, jnp.concatenate([pose, moved / TICK])
        detected, age = jnp.bool_(True), late * TICK
    else:
        estimates = sensing.estimates(senses, setup.sensing, sensor_state, samples * _TICKS, sample=DT)
        robot, speed = estimates.robot_pose[0], estimates.robot_twist[0]
        frame = jnp.concatenate([estimates.object_pose[0, 0], estimates.object_twist[0, 0]])
        detected, age = estimates.detected[0, 0], estimates.object_age[0, 0]
    frame = frame + error[4:10]
    push = jnp.zeros(3).at[0].set(error[10])
    return ObjectObservation(
        robot_pose=robot,
        robot_twist=speed,
        lean=truth.lean + error[:2],
        lean_rate=truth.lean_rate + error[2:4],
        object_pose=frame[:3],
        object_twist=frame[3:],
        wrench=wrench + se2.rotate(push, truth.robot_pose[2]),
        detected=detected,
        age=age,
    )


def _phase(phase: Array, truth: Observation, world: MjxWorld, setup: WorldSetup) -> Array:
    """Phase after a sample. A world ends if the robot has fallen, if it has let go and the object is at rest, or if the
    physics has diverged."""
    away = hands_to_face(truth.object_pose[0], truth.robot_pose, setup.face) > CLEAR
    resting = jnp.hypot(truth.object_twist[0, 0], truth.object_twist[0, 1]) < AT_REST
    phase = jnp.where((phase == one_push.LET_GO) & away & resting, one_push.DONE, phase)
    phase = jnp.where(fallen(truth.lean), one_push.FELL, phase)
    return jnp.where(jnp.all(jnp.isfinite(world.physics)), phase, one_push.UNSTABLE)


def _counted(tally: Tally, truth: Observation, wrench: Array, samples: Array) -> Tally:
    force = jnp.hypot(wrench[0], wrench[1])
    return Tally(
        time=samples * DT,
        contact=tally.contact + jnp.where(force > CONTACT_FORCE, DT, 0.0),
        lean=jnp.maximum(tally.lean, jnp.hypot(truth.lean[0], truth.lean[1])),
        force=jnp.maximum(tally.force, force),
        pose=truth.object_pose[0],
    )


def free_memory(devices: Sequence[jax.Device]) -> int:
    """Free memory on all ``devices`` together [bytes]; for CPUs, the available memory of the machine."""
    stats = [d.memory_stats() for d in devices]
    if all(s and "bytes_limit" in s for s in stats):
        return sum(s["bytes_limit"] - s["bytes_in_use"] for s in stats if s)
    try:
        lines = Path("/proc/meminfo").read_text().splitlines()
        return next(int(line.split()[1]) * 1024 for line in lines if line.startswith("MemAvailable"))
    except (OSError, StopIteration):
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") // 2
