"""Scripted pushes of objects in a scene, simulated as a batch in C MuJoCo.

The robot starts at rest at a stand-off pose. It extends its arms, makes contact, and leans into the face with a
constant steering angle until its way is free or the object stops moving. Then it backs away and folds its arms. It
perceives true poses.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from shmoo_mjx.arrays import Bool, Float
from shmoo_mjx.behavior.skills.retreat import WITHDRAW
from shmoo_mjx.evaluation.manipulable import SteadyPush, steady_lean
from shmoo_mjx.geometry import se2
from shmoo_mjx.geometry.faces import heading
from shmoo_mjx.geometry.hands import HAND_HEIGHT, HAND_RADIUS, REACH, TUCKED_HEIGHT, TUCKED_REACH
from shmoo_mjx.plant.engine_mujoco import MujocoEngine
from shmoo_mjx.plant.lowlevel import Gains, velocity_to_lean
from shmoo_mjx.plant.observe import toppled
from shmoo_mjx.plant.robot import NQ
from shmoo_mjx.plant.scene import Scene
from shmoo_mjx.types import DT, Command, Observation

WORLDS = 12
"""Number of pushes in a batch. It is constant, so that the control is compiled once."""


@dataclass(frozen=True)
class ScriptConfig:
    """Settings of a scripted push, in SI units."""

    push: SteadyPush = SteadyPush(lean=0.15, speed=0.3)
    seconds: float = 18.0
    """Maximum time from the start of the push to the start of the retreat [s]."""
    stall: tuple[float, float] = (0.03, 3.0)
    """Minimum displacement of the object [m] within a contact time [s]. A push ends if the object moves less."""
    look: tuple[float, float] = (0.8, 0.08)
    """Interval between checks whether the way is free [s], and minimum displacement of the object since the last check
    [m]."""
    back: tuple[float, float] = (1.6, 1.0)
    """Durations of backing away and of folding the arms at rest [s]."""


class ScriptedPush(NamedTuple):
    """One push to try."""

    object: int
    face: np.ndarray
    """Face ``[4]`` in {O}, a row of `faces_of` or `corners_of`."""
    lateral: float
    """Distance of the contact place from the centre of the face, positive to the robot's left [m]."""
    steering: float
    """Steering angle [rad]."""
    start: np.ndarray
    """Pose ``[3]`` of the robot in {W} at the start [m, m, rad]."""


class PushEnd(NamedTuple):
    """Outcome of a push."""

    freed: bool
    """Whether the robot's way became free during the push."""
    ok: bool
    """False if the robot fell or touched a wall, an object toppled, or the simulation diverged."""
    seconds: float
    """Time from the start of the push to the end of the retreat [s]."""
    moved: float
    """Distance between the positions of the object at the start and at the end [m]."""
    progress: float
    """Displacement of the object along the heading of the push [m]."""
    qpos: np.ndarray
    """Generalised positions ``[nq]`` of the world at the end."""
    robot: np.ndarray
    """Pose ``[3]`` of the robot in {W} at the end [m, m, rad]."""
    objects: np.ndarray
    """Poses ``[N, 3]`` of the objects in {W} at the end [m, m, rad]."""


@dataclass
class _Progress:
    """State of W pushes."""

    contact: Float[np.ndarray, "W"]
    """Time of the first contact [s]; infinite before it."""
    left: Float[np.ndarray, "W"]
    """Time at which the retreat started [s]; infinite before it."""
    freed: Bool[np.ndarray, "W"]
    ok: Bool[np.ndarray, "W"]
    looked: Float[np.ndarray, "W 2"]
    """Position of the object in {W} at the last check of the way [m]."""
    lean: Float[np.ndarray, "W 2"]
    """Last lean commands in {R} [rad]."""
    time: float
    """Current time [s]."""

    def over(self, cfg: ScriptConfig) -> Bool[np.ndarray, "W"]:
        """Whether each retreat has ended."""
        return np.asarray(self.time >= self.left + sum(cfg.back) - 1e-6)


def run_pushes(
    scene: Scene,
    qpos: Float[np.ndarray, "nq"],
    pushes: Sequence[ScriptedPush],
    free: Callable[[int, np.ndarray, np.ndarray], bool],
    *,
    cfg: ScriptConfig = ScriptConfig(),
) -> list[PushEnd]:
    """Simulate up to `WORLDS` pushes as a batch.

    Args:
        scene: robot, objects and nearby walls.
        qpos: generalised positions of the world before the pushes. The robot is moved to the start of each push.
        pushes: pushes to try.
        free: (object, position of the robot ``[2]``, poses of the objects ``[N, 3]``) -> whether the robot's way past
            the object is free.
        cfg: settings.

    Returns:
        The outcome of each push.
    """
    many = [*pushes, *[pushes[-1]] * (WORLDS - len(pushes))]
    engine = MujocoEngine([replace(scene, qpos0=_at(scene, qpos, p.start), spec=None) for p in many])
    world = engine.init()
    obs = engine.observe(world)
    rows, which = np.arange(WORLDS), np.array([p.object for p in many])
    first = np.array(obs.object_pose[rows, which])
    now = _Progress(
        contact=np.full(WORLDS, np.inf),
        left=np.full(WORLDS, np.inf),
        freed=np.zeros(WORLDS, bool),
        ok=np.ones(WORLDS, bool),
        looked=first[:, :2].copy(),
        lean=np.zeros((WORLDS, 2)),
        time=float(np.asarray(obs.time)[0]),
    )
    now.left[len(pushes) :] = -np.inf
    trail: list[np.ndarray] = []
    while not (now.over(cfg) | ~now.ok).all():
        command = _command(now, many, obs, cfg)
        world, obs = engine.step(world, command)
        places = np.asarray(obs.object_pose[rows, which, :2])
        trail.append(places)
        nq = scene.model.nq
        broken = engine.fallen(world) | engine.diverged(world) | world.wall_contact
        now.ok &= ~(broken | toppled(scene, world.physics[:, 1 : 1 + nq]).any(axis=-1))
        time = now.time = float(np.asarray(obs.time)[0])
        felt = np.hypot(*obs.wrench[rows, which, :2].T) > cfg.push.touch
        begins = np.isinf(now.contact) & (felt | (np.linalg.norm(places - first[:, :2], axis=1) > 0.03))
        now.contact[begins] = time
        _leave(now, obs, trail, many, free=free, cfg=cfg)
    engine.close()
    ends = obs.object_pose[rows, which]
    along = np.array([heading(a, p.face) for a, p in zip(first, many, strict=True)])
    shift = ends[:, :2] - first[:, :2]
    progress = shift[:, 0] * np.cos(along) + shift[:, 1] * np.sin(along)
    return [
        PushEnd(
            freed=bool(now.freed[k]),
            ok=bool(now.ok[k]),
            seconds=float(min(now.left[k], now.time) + sum(cfg.back)),
            moved=float(np.linalg.norm(shift[k])),
            progress=float(progress[k]),
            qpos=world.physics[k, 1 : 1 + scene.model.nq].copy(),
            robot=np.array(obs.robot_pose[k]),
            objects=np.array(obs.object_pose[k]),
        )
        for k in range(len(pushes))
    ]


def _at(scene: Scene, qpos: np.ndarray, robot: np.ndarray) -> np.ndarray:
    """``qpos`` with the robot at the pose ``robot``, with folded arms."""
    placed = scene.placed(robot, np.zeros((len(scene.conditions), 3)))
    return np.concatenate([placed[:NQ], qpos[NQ:]])


def _command(now: _Progress, pushes: Sequence[ScriptedPush], obs: Observation, cfg: ScriptConfig) -> Command:
    rows, which = np.arange(WORLDS), [p.object for p in pushes]
    poses = obs.object_pose[rows, which]
    faces, lateral = np.stack([p.face for p in pushes]), np.array([p.lateral for p in pushes])
    now.lean = steady_lean(
        cfg.push, obs, poses, faces, last=now.lean, touching=np.isfinite(now.contact), lateral=lateral
    )
    pushing, since = np.isinf(now.left), now.time - now.left
    backing = ~pushing & (since < cfg.back[0])
    wish = np.where(backing[:, None], np.array([-0.2, 0.0]), 0.0)
    velocity = se2.rotate(obs.robot_twist[:, :2], -obs.robot_pose[:, 2])
    lean = np.where(pushing[:, None], now.lean, velocity_to_lean(Gains(), velocity, obs.lean_rate, wish))
    steering = np.where(pushing, [p.steering for p in pushes], 0.0)
    yaw = np.where(pushing, heading(poses, faces), obs.robot_pose[:, 2])
    reach = np.where(pushing, REACH, np.where(backing, REACH - WITHDRAW, TUCKED_REACH))
    height = np.where(pushing | backing, HAND_HEIGHT, TUCKED_HEIGHT)
    return Command(np.concatenate([lean, steering[:, None]], axis=1), yaw, reach, height)


def _leave(
    now: _Progress,
    obs: Observation,
    trail: list[np.ndarray],
    pushes: Sequence[ScriptedPush],
    *,
    free: Callable[[int, np.ndarray, np.ndarray], bool],
    cfg: ScriptConfig,
) -> None:
    """Start the retreat of pushes whose way is free, whose object has stopped or is lost, or that are out of time."""
    time, window, which = now.time, round(cfg.stall[1] / DT), [p.object for p in pushes]
    pushing = np.isinf(now.left) & now.ok
    places = trail[-1]
    if len(trail) % round(cfg.look[0] / DT) == 0:
        for k in np.flatnonzero(pushing & (np.linalg.norm(places - now.looked, axis=1) > cfg.look[1])):
            now.looked[k] = places[k]
            now.freed[k] = free(which[k], np.asarray(obs.robot_pose[k, :2]), np.asarray(obs.object_pose[k]))
    touched = time - now.contact
    still = np.zeros(WORLDS, bool)
    if len(trail) > window:
        still = (np.linalg.norm(places - trail[-window - 1], axis=1) < cfg.stall[0]) & (touched > cfg.stall[1])
    faces = np.stack([p.face for p in pushes])
    poses = obs.object_pose[np.arange(WORLDS), which]
    local = se2.relative(se2.compose(poses, faces[:, :3]), obs.robot_pose)
    lost = (-local[:, 0] - REACH - HAND_RADIUS > 0.6) | (np.abs(local[:, 1]) > faces[:, 3] + 0.3)
    ends = pushing & (now.freed | still | lost | (time > cfg.seconds) | (np.isinf(now.contact) & (time > 8.0)))
    now.left[ends] = time
