"""Engine with simulated sensing: ``init() -> world`` and ``step(world, command) -> world, sensed observation``.

The world advances while the controller computes. A command reaches the motors after the computing time
(`Senses.computing`) plus the robot's command delay, counted from the observation that it answers. Until then the motors
follow the previous command.
"""

from __future__ import annotations

import operator
from collections import Counter
from collections.abc import Sequence
from types import TracebackType
from typing import Any, NamedTuple, SupportsIndex

import jax
import numpy as np

from shmoo_mjx.arrays import Array, Bool, Float, Int
from shmoo_mjx.geometry import se2
from shmoo_mjx.plant.engine_mujoco import MujocoEngine
from shmoo_mjx.plant.lowlevel import Gains, velocity_to_lean
from shmoo_mjx.plant.observe import scene_poses
from shmoo_mjx.plant.robot import NQ, NV
from shmoo_mjx.plant.scene import Scene
from shmoo_mjx.sensing import senses as sensing
from shmoo_mjx.sensing import tracker
from shmoo_mjx.sensing.camera import in_sight, near_walls, scenery_of
from shmoo_mjx.sensing.odometry import TICK
from shmoo_mjx.sensing.senses import Motion, Noise, Senses, SensorState
from shmoo_mjx.sensing.tracker import Tracks
from shmoo_mjx.types import DT, Command, Observation, Track

_NEVER = np.iinfo(np.int64).max
_WATCHDOG = 0.3
"""Time without a command after which the watchdog of the low-level control stops the robot [s]."""
_STATION = 0.5
"""Gain of the watchdog's station keeping [1/s]. With zero desired velocity alone, a robot whose CoM is off the axis
drifts at 7 cm/s."""


_watch = jax.jit(sensing.watch, static_argnames=("senses", "robot"))


class PerfectState(NamedTuple):
    """State of perfect sensing: the last visible pose of each object."""

    pose: Float[np.ndarray, "W N 3"]
    """Pose in {W} when the object was last in sight [m, rad]; NaN if it never was."""
    at: Float[np.ndarray, "W N"]
    """Tick of that time; -inf if the object was never in sight."""


class SensedWorld(NamedTuple):
    """Complete state of W worlds: true states, delayed commands and sensor state."""

    truth: Any
    """State of the underlying engine (ground truth)."""
    held: Command
    """Command that the motors follow now."""
    pending: tuple[tuple[Int[np.ndarray, "W"], Command], ...]
    """Commands that have not arrived yet, as (tick of arrival, command), in the order of sending."""
    sensor_state: SensorState | PerfectState
    """State of the simulated sensors."""
    contact: Float[np.ndarray, "W N 3"]
    """True mean wrench on each object over the last step, in {W} [N, N m]."""
    wall_parts: Bool[np.ndarray, "W P"]
    """Which of scene.PARTS touched a wall during the last step."""
    ticks: int
    """Time since the start, in ticks."""
    silent: int = 0
    """Ticks since the end of the last step that had a command."""
    station: Float[np.ndarray, "W 2"] | None = None
    """Position in {W} where the watchdog holds the robot [m]; None while commands arrive."""

    @property
    def wall_contact(self) -> Bool[np.ndarray, "W"]:
        """Whether any part of the robot touched a wall during the last step."""
        return np.asarray(self.wall_parts.any(axis=-1))

    @property
    def physics(self) -> Float[np.ndarray, "W n"]:
        """MuJoCo's full physics state, for rendering."""
        return np.asarray(self.truth.physics)


class SensedEngine:
    """Steps W worlds with simulated sensing. Holds models, never state. Can be used as a context manager.

    Args:
        scenes: one per world, built with ``adjust=senses.adjust(seed)``.
        senses: sensing settings, such as REAL or PERFECT, or their name.
        seed: seed of the robot (body, delays, drift) and of all noise, one for all worlds or one per world. The result
            for a world does not depend on the other worlds of the batch. Worlds with the same seed have the same robot
            and different noise.
        gains: gains of the low-level control.
        threads: number of threads, see :class:`~shmoo_mjx.plant.engine_mujoco.MujocoEngine`.
        poses_known: whether the robot knows all object poses at the start, even those out of sight.
        backend: engine of the same scenes to use instead of C MuJoCo.
    """

    def __init__(
        self,
        scenes: Sequence[Scene],
        senses: str | Senses = sensing.REAL,
        seed: SupportsIndex | Sequence[SupportsIndex] = 0,
        *,
        gains: Gains | None = None,
        threads: int = 1,
        poses_known: bool = False,
        backend: Any = None,
    ) -> None:
        self.senses, self.poses_known = sensing.senses_named(senses), poses_known
        self.engine = backend or MujocoEngine(scenes, gains, threads)
        self.seeds = [operator.index(one) for one in np.broadcast_to(np.asarray(seed), len(scenes))]
        self._entropy = _entropies(self.seeds)
        self._drawn = sensing.draw(self.senses, self.seeds)
        self._use(scenes)

    def __enter__(self) -> SensedEngine:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Shut down the engine's threads."""
        if isinstance(self.engine, MujocoEngine):
            self.engine.close()

    def change(self, scenes: Sequence[Scene]) -> None:
        """Replace the scenes by others of the same structure; see the engine's ``change``."""
        self.engine.change(scenes)
        self._use(scenes)

    def _use(self, scenes: Sequence[Scene]) -> None:
        self.scenes = list(scenes)
        self._scenery = scenery_of(self.scenes)

    def init(self) -> SensedWorld:
        """State of all worlds at their scenes' initial configuration, after one camera frame of the standing robot."""
        return self.begin(self.engine.init())

    def begin(self, truth: Any, ticks: int = 0) -> SensedWorld:
        """Initial state, with fresh sensors, for worlds that are at rest.

        Args:
            truth: state of the underlying engine.
            ticks: tick at which the worlds start.
        """
        true = _numpy(self.engine.observe(truth))
        control = truth.control
        held = Command(np.zeros((len(true.robot_pose), 3)), true.robot_pose[:, 2], control.reach, control.hand_height)
        noise = np.stack([rng.normal(size=true.object_pose.shape[1:]) for rng in self._generators(5, ticks)])
        sensor_state: SensorState | PerfectState
        if self.senses.perfect:
            pose = np.where(self.poses_known, true.object_pose, np.nan)
            at = np.full(pose.shape[:2], float(ticks) if self.poses_known else -np.inf)
            sensor_state = self._look(PerfectState(pose, at), true, ticks)
        else:
            sensor_state = sensing.first_state(
                self.senses, self._drawn, self._scenery, robot_pose=true.robot_pose, object_pose=true.object_pose,
                noise=noise, poses_known=self.poses_known, now=ticks,
            )  # fmt: skip
        no_contact = np.zeros_like(np.asarray(truth.wall_parts))
        return SensedWorld(truth, _numpy(held), (), sensor_state, np.zeros_like(true.object_pose), no_contact, ticks)

    def restart(self, world: SensedWorld, truth: Any, which: Bool[np.ndarray, "W"]) -> SensedWorld:
        """Restart the worlds ``which`` at rest; the other worlds continue.

        Args:
            world: state of all worlds.
            truth: state of the underlying engine, in which the restarted worlds are at rest.
            which: mask of the worlds to restart.
        """
        fresh = self.begin(truth, world.ticks)
        chosen = [
            jax.tree.map(lambda new, old: _chosen(which, new, old), getattr(fresh, name), getattr(world, name))
            for name in ("held", "sensor_state", "contact", "wall_parts")
        ]
        held, sensor_state, contact, touched = chosen
        pending = tuple((np.where(which, _NEVER, at), command) for at, command in world.pending)
        return SensedWorld(truth, held, pending, sensor_state, contact, touched, world.ticks)

    def resume(self, world: SensedWorld, before: Scene) -> SensedWorld:
        """Continue, in this engine of one world, a run of an engine that had fewer objects.

        The objects of ``before`` are the first objects of this engine; their properties may differ. Additional objects
        start at rest where this engine's scene puts them, and the robot has not seen them yet.

        Args:
            world: last state of the other engine.
            before: scene of the other engine.

        Returns:
            The state to continue from.
        """
        (scene,), fresh, old = self.scenes, self.engine.init(), world.truth.physics
        (nq, nv), first_velocity = (before.model.nq, before.model.nv), 1 + scene.model.nq
        physics = np.array(fresh.physics)
        physics[:, : 1 + nq] = old[:, : 1 + nq]
        physics[:, first_velocity : first_velocity + nv] = old[:, 1 + nq : 1 + nq + nv]
        physics[:, first_velocity + scene.model.nv :] = old[:, 1 + nq + nv :]  # the robot's motors
        truth = world.truth._replace(physics=physics)
        started = self.begin(truth, world.ticks)
        old_state, new_state = world.sensor_state, started.sensor_state
        sensor_state: SensorState | PerfectState
        if isinstance(old_state, PerfectState):
            pose = _first(np.full_like(started.contact, np.nan), old_state.pose, 1)
            sensor_state = PerfectState(pose, _first(np.full(pose.shape[:2], -np.inf), old_state.at, 1))
        else:
            assert isinstance(new_state, SensorState)
            none = tracker.init(1, len(scene.conditions))
            tracks = {
                name: then if name == "at" else _first(getattr(none, name), then, 1)
                for name, then in old_state.tracks._asdict().items()
            }
            sensor_state = old_state._replace(
                objects=_first(new_state.objects, old_state.objects, 2),
                lost_until=_first(new_state.lost_until, old_state.lost_until, 1),
                tracks=Tracks(**tracks),
            )
        contact = _first(np.zeros_like(started.contact), world.contact, 1)
        return world._replace(truth=truth, sensor_state=sensor_state, contact=contact)

    def observe(self, world: SensedWorld) -> Observation:
        """Sensed observation of the current state, with zero wrench and without new noise."""
        true = _numpy(self.engine.observe(world.truth))
        return self._perceived(world, true, np.zeros_like(true.wrench))

    def true_observation(self, world: SensedWorld) -> Observation:
        """Ground truth observation for scoring, with the simulator's contact wrench."""
        return _numpy(self.engine.observe(world.truth))._replace(wrench=world.contact)

    def fallen(self, world: SensedWorld) -> Bool[np.ndarray, "W"]:
        """Whether the robot's body leans more than 0.6 rad. True for diverged worlds."""
        return np.asarray(self.engine.fallen(world.truth))

    def diverged(self, world: SensedWorld) -> Bool[np.ndarray, "W"]:
        """Whether the physics of a world has diverged (`observe.diverged`). Other worlds are not affected."""
        return np.asarray(self.engine.diverged(world.truth))

    def step(
        self,
        world: SensedWorld,
        command: Command | None,
        duration: float = DT,
        push: Float[np.ndarray, "W 6"] | None = None,
        *,
        computing: float | None = None,
    ) -> tuple[SensedWorld, Observation]:
        """Step all worlds.

        Args:
            world: state whose observation ``command`` answers.
            command: command with fields ``[W, ...]``, held until the next one arrives. None means that no command was
                sent: the previous one is held, and after 0.3 s without a command a watchdog stops the robot.
            duration: time to simulate [s], a multiple of 10 ms.
            push: external disturbance on the robot: force [N] and torque [N m] in {W} at the torso's CoM.
            computing: computing time of this command [s], by default that of the sensing settings.

        Returns:
            The new state and the sensed observation.
        """
        ticks = round(duration / TICK)
        if command is not None:
            world = self._sent(world, command, self.senses.computing if computing is None else computing)
            world = world._replace(silent=0, station=None)
        else:
            world = world._replace(silent=world.silent + ticks)
        generators = self._generators(11, world.ticks)
        world, tracks = self._driven(world, ticks, push)
        contact = np.sum([len(track.physics) / ticks * np.asarray(track.wrench, float) for track in tracks], axis=0)
        world = world._replace(contact=contact, wall_parts=np.any([track.wall_parts for track in tracks], axis=0))
        true = _numpy(self.engine.observe(world.truth))
        if isinstance(world.sensor_state, PerfectState):
            world = world._replace(sensor_state=self._look(world.sensor_state, true, world.ticks))
            return world, self._perceived(world, true, contact)
        worlds, objects = contact.shape[:2]
        normal = np.stack([rng.normal(size=(ticks, 6 + 3 * objects)) for rng in generators], axis=1)
        uniform = np.stack([rng.random((ticks, objects, 2)) for rng in generators], axis=1)
        lean_noise = self.senses.lean_noise * np.stack([rng.normal(size=(2, 2)) for rng in generators], axis=1)
        noise = Noise(normal[..., :6], normal[..., 6:].reshape(ticks, worlds, objects, 3), uniform)
        sensor_state, wrench = self._watched(world, tracks, noise)
        world = world._replace(sensor_state=sensor_state)
        return world, self._perceived(world, true, wrench, lean_noise)

    def _driven(
        self, world: SensedWorld, ticks: int, push: Float[np.ndarray, "W 6"] | None
    ) -> tuple[SensedWorld, list[Track]]:
        """Advance the true worlds by ``ticks``, with the commands that arrive meanwhile or the watchdog's commands."""
        # The low-level control holds the estimated heading. Its error is almost constant within a sample.
        state = world.sensor_state
        heading_error = sensing.heading_error(state) if isinstance(state, SensorState) else 0.0
        left_alone = TICK * world.silent > _WATCHDOG + 1e-6
        tracks: list[Track] = []
        for length in [1] * ticks if left_alone else self._stretches(world, ticks):
            world = _arrived(world)
            if left_alone:
                world = self._to_rest(world)
            held = world.held._replace(yaw=se2.wrap(world.held.yaw - heading_error))
            truth, track = self.engine.advance(world.truth, held, length * TICK, length, push=push)
            tracks.append(track)
            world = world._replace(truth=truth, ticks=world.ticks + length)
        return world, tracks

    def _watched(self, world: SensedWorld, tracks: Sequence[Track], noise: Noise) -> tuple[SensorState, np.ndarray]:
        """Sensor state after the ticks of a step, and the estimated wrench."""
        physics = np.concatenate([track.physics for track in tracks])
        torque = np.concatenate([track.torque for track in tracks])[..., 3:]
        robot, others = scene_poses(self.scenes[0], physics)
        scene = self.scenes[0]
        first_velocity = 1 + scene.model.nq
        coordinates = np.concatenate(
            [physics[..., 1 : 1 + NQ], physics[..., first_velocity : first_velocity + NV]], axis=-1
        )
        motion = Motion(robot, others, coordinates, torque, np.asarray(world.truth.control.reach, dtype=float))
        scenery = near_walls(self._scenery, self.senses.camera, robot[0])
        # Double precision is needed to resolve micrometres at poses tens of metres from the origin.
        with jax.enable_x64(True):
            watched = _watch(
                self.senses, scene.robot, self._drawn, scenery, sensor_state=world.sensor_state, motion=motion,
                noise=noise, before=world.ticks - len(physics),
            )  # fmt: skip
        return _numpy(watched)

    def _generators(self, purpose: int, ticks: int) -> list[np.random.Generator]:
        """One independent random generator per world for this tick."""
        return [np.random.default_rng([purpose, entropy, ticks]) for entropy in self._entropy]

    def _sent(self, world: SensedWorld, command: Command, computing: float) -> SensedWorld:
        """Queue the command; earlier commands that would arrive at the same time or later are dropped."""
        late = round(computing / TICK) + self._drawn.command_delay
        arrives = np.asarray(world.ticks + late, dtype=np.int64)
        earlier = tuple((np.where(at >= arrives, _NEVER, at), other) for at, other in world.pending)
        return world._replace(pending=(*earlier, (arrives, _numpy(command))))

    def _to_rest(self, world: SensedWorld) -> SensedWorld:
        """The watchdog's command: brake, then hold the position. Heading and hands keep their held targets."""
        robot, held = self.engine.robot(world.truth), world.held
        pose, twist = np.asarray(robot.pose), np.asarray(robot.twist)[:, :2]
        braking = np.hypot(*twist.T)[:, None] > 0.1
        station = pose[:, :2] if world.station is None else np.where(braking, pose[:, :2], world.station)
        heading = -pose[:, 2]
        back = _STATION * se2.rotate(station - pose[:, :2], heading)
        lean = velocity_to_lean(Gains(), se2.rotate(twist, heading), np.asarray(robot.lean_rate), back)
        return world._replace(held=held._replace(u=np.concatenate([lean, held.u[:, 2:]], axis=-1)), station=station)

    def _stretches(self, world: SensedWorld, ticks: int) -> list[int]:
        """Split the step into stretches of ticks at the arrivals of commands; without arrivals it is one stretch."""
        arrivals = {int(t) - world.ticks for at, _ in world.pending for t in np.unique(at) if t != _NEVER}
        ends = [0, *sorted(t for t in arrivals if 0 < t < ticks), ticks]
        return np.diff(ends).tolist()

    def _look(self, sensor_state: PerfectState, true: Observation, now: int) -> PerfectState:
        """Perfect sensing: store the exact poses of visible objects."""
        shown = in_sight(self.senses.camera, self._scenery, true.robot_pose, true.object_pose)
        return PerfectState(
            np.where(shown[..., None], true.object_pose, sensor_state.pose),
            np.where(shown, float(now), sensor_state.at),
        )

    def _perceived(
        self, world: SensedWorld, true: Observation, wrench: np.ndarray, lean_noise: np.ndarray | None = None
    ) -> Observation:
        """Sensed observation; ``lean_noise [2, W, 2]`` is the inertial unit's noise of lean and, times 5, lean rate."""
        if isinstance(world.sensor_state, PerfectState):
            age = TICK * (world.ticks - world.sensor_state.at)
            now = age <= 0.5 * TICK
            twist = np.where(now[..., None], true.object_twist, 0.0)
            return true._replace(
                object_pose=world.sensor_state.pose, object_twist=twist, wrench=wrench, object_age=age, detected=now
            )
        estimates = sensing.estimates(self.senses, self._drawn, world.sensor_state, world.ticks, sample=DT)
        if lean_noise is not None:
            true = true._replace(lean=true.lean + lean_noise[0], lean_rate=true.lean_rate + 5 * lean_noise[1])
        return true._replace(wrench=wrench, **estimates._asdict())


def _entropies(seeds: Sequence[int]) -> list[int]:
    """Entropy of each world's noise, from the seed and the number of earlier worlds with the same seed."""
    before, entropies = Counter[int](), list[int]()
    for seed in seeds:
        entropies.append(int(np.random.SeedSequence([seed, before[seed]]).generate_state(1)[0]))
        before[seed] += 1
    return entropies


def _arrived(world: SensedWorld) -> SensedWorld:
    """Move commands that have arrived at the motors from ``pending`` to ``held``."""
    held, waiting = world.held, []
    for at, command in world.pending:
        here = at <= world.ticks
        if here.any():
            held = jax.tree.map(lambda new, old, here=here: _chosen(here, new, old), command, held)
            at = np.where(here, _NEVER, at)
        if (at != _NEVER).any():
            waiting.append((at, command))
    return world._replace(held=held, pending=tuple(waiting))


def _first(new: Array, old: Array, axis: int) -> np.ndarray:
    """Copy of ``new`` whose first entries along ``axis`` are replaced by ``old``."""
    out = np.array(new, dtype=float)
    out[(slice(None),) * axis + (slice(old.shape[axis]),)] = old
    return out


def _chosen(which: np.ndarray, new: np.ndarray, old: np.ndarray) -> np.ndarray:
    return np.where(which.reshape(-1, *(1,) * (np.ndim(new) - 1)), new, old)


def _numpy(tree: Any) -> Any:
    """The same tree with NumPy arrays of doubles; boolean arrays stay boolean."""

    def convert(leaf: Any) -> np.ndarray:
        array = np.asarray(leaf)
        return array if array.dtype == bool else array.astype(float)

    return jax.tree.map(convert, tree)
