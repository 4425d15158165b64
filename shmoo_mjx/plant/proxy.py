"""The proxy robot (spec 1.6): a perturbed plant behind imperfect senses, which stands for the hardware.

Another body (mass, CoM, drive friction, motor gains, motor lag), commands that arrive late, and an observation as a
robot with a camera and motor currents has it: object poses at 30 Hz with noise and drop-outs, velocities only by
filtering, the hands' force only by J tau. Same signature as the other engines. Training never sees any of it.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import mujoco
import numpy as np

from shmoo_mjx import se2
from shmoo_mjx.plant.engine_mujoco import MujocoEngine, World
from shmoo_mjx.plant.joint_torque import joint_torque_wrench
from shmoo_mjx.plant.lowlevel import Gains
from shmoo_mjx.plant.scene import Scene
from shmoo_mjx.types import DT, Command, Observation

__all__ = ["Body", "Imperfections", "ProxyEngine", "ProxyWorld", "body_of", "draw_body"]

_TICK = 0.01
"""Time between two readings of the proxy's sensors [s]."""


@dataclass(frozen=True)
class Imperfections:
    """Every difference from the training plant; 0 (or False) switches one off. Widths of draws are relative."""

    body_mass: float = 0.15
    body_com: float = 0.005
    """Shift of the torso's CoM along x and y [m]."""
    body_com_height: float = 0.04
    """Shift of the torso's CoM along z [m]."""
    drive_friction: float = 0.4
    drive_gain: float = 0.05
    arm_gain: float = 0.15
    """Torque of the arms' motors over what is asked of them."""
    motor_lag: float = 0.01
    """Time constant of every motor [s]."""
    delay: tuple[float, float] = (0.02, 0.04)
    """Range of the delay of commands and of the camera [s], rounded to 10 ms."""
    position_noise: float = 0.005
    """Standard deviation of a detected object's position [m]."""
    yaw_noise: float = float(np.deg2rad(0.5))
    """... of its yaw [rad]."""
    frame_rate: float = 30.0
    """Of the camera [Hz]; 0 gives true poses and twists at every sample."""
    drop_out: float = 0.05
    """Share of frames in which a tag is not found."""
    burst: float = 0.005
    """Chance per frame that a tag stays lost for ``burst_time``."""
    burst_time: float = 0.4
    """[s]"""
    lean_noise: float = float(np.deg2rad(0.1))
    """Standard deviation of lean [rad] and, five times larger, of its rate [rad/s]."""
    filter_velocity: bool = True
    """The robot's twist by a low-pass filter on differences of its pose (time constant 30 ms)."""
    force_from_torque: bool = True
    """Gamma by J tau, not from the contacts."""

    @classmethod
    def none(cls) -> Imperfections:
        """The training plant."""
        zeros: dict[str, Any] = {f.name: 0.0 for f in dataclasses.fields(cls)}
        return cls(**zeros | {"delay": (0.0, 0.0), "filter_velocity": False, "force_from_torque": False})


class Body(NamedTuple):
    """One drawn robot: factors and shifts on the nominal one."""

    mass: float
    com: tuple[float, float, float]
    """[m]"""
    drive_friction: float
    drive_gain: float
    arm_gain: tuple[float, ...]
    """``[6]``"""
    motor_lag: float
    """[s]"""
    delay: float
    """[s]"""


def draw_body(imperfections: Imperfections, seed: int) -> Body:
    """The robot with this seed."""
    rng = np.random.default_rng([7, seed])
    unit = rng.uniform(-1, 1, 13)
    at = imperfections
    delay = at.delay[0] + (at.delay[1] - at.delay[0]) * (unit[6] + 1) / 2
    return Body(
        mass=1 + at.body_mass * unit[0],
        com=(at.body_com * unit[1], at.body_com * unit[2], at.body_com_height * unit[3]),
        drive_friction=1 + at.drive_friction * unit[4],
        drive_gain=1 + at.drive_gain * unit[5],
        arm_gain=tuple((1 + at.arm_gain * unit[7:]).tolist()),
        motor_lag=at.motor_lag,
        delay=round(float(delay) / _TICK) * _TICK,
    )


def body_of(body: Body) -> Callable[[mujoco.MjSpec], None]:
    """What :func:`~shmoo_mjx.plant.scene.build_scene` takes as ``adjust`` to build this robot."""

    def adjust(spec: mujoco.MjSpec) -> None:
        torso, ball = spec.body("robot/torso"), spec.joint("robot/ball")
        torso.mass *= body.mass
        torso.inertia = body.mass * np.asarray(torso.inertia)
        torso.ipos = np.asarray(torso.ipos) + body.com
        ball.frictionloss = body.drive_friction * np.asarray(ball.frictionloss)
        ball.damping = body.drive_friction * np.asarray(ball.damping)
        for i, motor in enumerate(a for a in spec.actuators if a.name.startswith("robot/")):
            motor.gear = (body.drive_gain if i < 3 else body.arm_gain[i - 3]) * np.asarray(motor.gear)
            if body.motor_lag > 0:
                motor.dyntype = mujoco.mjtDyn.mjDYN_FILTEREXACT
                motor.dynprm[0] = body.motor_lag

    return adjust


class ProxyWorld(NamedTuple):
    """Complete state: the true worlds and what the robot's senses remember."""

    truth: World
    command: Command
    """The last command that was sent."""
    past: np.ndarray
    """``[L, W, N, 3]`` true object poses of the last ticks: what the camera still has to report."""
    pose: np.ndarray
    """``[W, N, 3]`` estimated object poses."""
    twist: np.ndarray
    """``[W, N, 3]`` estimated object twists."""
    lost: np.ndarray
    """``[W, N]`` how long each tag stays lost [s]."""
    since: np.ndarray
    """``[W, N]`` time since the estimate was last advanced [s]."""
    robot_twist: np.ndarray
    """``[W, 3]`` filtered."""
    robot_pose: np.ndarray
    """``[W, 3]`` of the last tick."""
    ticks: int

    @property
    def physics(self) -> np.ndarray:
        """``[W, n]`` MuJoCo's full physics state, for pictures."""
        return self.truth.physics

    @property
    def wall_contact(self) -> np.ndarray:
        """``[W]`` whether the robot touched a wall in the last sample time."""
        return self.truth.wall_contact


class ProxyEngine:
    """Steps W proxy robots of one body.

    Args:
        scenes: built with ``adjust=body_of(draw_body(imperfections, seed))``.
        imperfections: what is imperfect.
        seed: of the body and of the noise.
        gains: of the low-level control, which knows nominal values only.
        threads: as for :class:`~shmoo_mjx.plant.engine_mujoco.MujocoEngine`.
    """

    def __init__(
        self,
        scenes: Sequence[Scene],
        imperfections: Imperfections | None = None,
        seed: int = 0,
        gains: Gains | None = None,
        threads: int = 1,
    ) -> None:
        self.engine = MujocoEngine(scenes, gains, threads)
        self.scenes = self.engine.scenes
        self.imperfections = imperfections or Imperfections()
        self.seed = seed
        self.delay_ticks = round(draw_body(self.imperfections, seed).delay / _TICK)

    def close(self) -> None:
        """Stop the threads."""
        self.engine.close()

    def init(self) -> ProxyWorld:
        """All worlds at their scenes' starting configuration; the first poses are true."""
        truth = self.engine.init()
        seen = self.engine.observe(truth)
        worlds = len(self.scenes)
        still = Command(np.zeros((worlds, 3)), seen.robot_pose[:, 2], truth.control.reach, truth.control.hand_height)
        return ProxyWorld(
            truth=truth,
            command=still,
            past=np.repeat(seen.object_pose[None], self.delay_ticks + 1, axis=0),
            pose=seen.object_pose,
            twist=np.zeros_like(seen.object_pose),
            lost=np.zeros(seen.object_pose.shape[:2]),
            since=np.zeros(seen.object_pose.shape[:2]),
            robot_twist=np.zeros((worlds, 3)),
            robot_pose=seen.robot_pose,
            ticks=0,
        )

    def observe(self, world: ProxyWorld) -> Observation:
        """What the robot believes, with no wrench."""
        seen = self.engine.observe(world.truth)
        return seen._replace(object_pose=world.pose, object_twist=world.twist, robot_twist=world.robot_twist)

    def step(
        self, world: ProxyWorld, command: Command, duration: float = DT, push: np.ndarray | None = None
    ) -> tuple[ProxyWorld, Observation]:
        """Hold ``command`` for ``duration`` seconds; it reaches the motors after the delay."""
        ticks = round(duration / _TICK)
        rng = np.random.default_rng([11, self.seed, world.ticks])
        wrench, contact = np.zeros_like(world.pose), np.zeros_like(world.pose)
        touched = np.zeros(len(self.scenes), dtype=bool)
        for i in range(ticks):
            arrived = command if i >= self.delay_ticks else world.command
            truth, seen = self.engine.step(world.truth, arrived, _TICK, push)
            world = self._look(world._replace(truth=truth), seen, rng)
            wrench += self._felt(world, arrived)
            contact += seen.wrench
            touched |= truth.wall_contact
        world = world._replace(command=command, truth=world.truth._replace(wall_contact=touched))
        return world, self._report(
            world, seen, (wrench if self.imperfections.force_from_torque else contact) / ticks, rng
        )

    def change(self, scenes: Sequence[Scene]) -> None:
        """Go on with other objects of the same structure, as :meth:`MujocoEngine.change` does."""
        self.engine.change(scenes)
        self.scenes = self.engine.scenes

    def true_observation(self, world: ProxyWorld) -> Observation:
        """What the simulator knows, for scoring."""
        return self.engine.observe(world.truth)

    def fallen(self, world: ProxyWorld) -> np.ndarray:
        """``[W]`` whether the body leans more than 0.6 rad."""
        return self.engine.fallen(world.truth)

    def _report(
        self, world: ProxyWorld, seen: Observation, wrench: np.ndarray, rng: np.random.Generator
    ) -> Observation:
        noise = self.imperfections.lean_noise * rng.normal(size=(2, *seen.lean.shape))
        seen = seen._replace(lean=seen.lean + noise[0], lean_rate=seen.lean_rate + 5 * noise[1], wrench=wrench)
        if self.imperfections.filter_velocity:
            seen = seen._replace(robot_twist=world.robot_twist)
        if self.imperfections.frame_rate:
            seen = seen._replace(object_pose=world.pose, object_twist=world.twist)
        return seen

    def _look(self, world: ProxyWorld, seen: Observation, rng: np.random.Generator) -> ProxyWorld:
        """One tick of odometry and, where a frame is due, of the camera."""
        moved = seen.robot_pose - world.robot_pose
        moved[..., 2] = se2.wrap(moved[..., 2])
        keep = np.exp(-_TICK / 0.03)
        world = world._replace(
            robot_twist=keep * world.robot_twist + (1 - keep) * moved / _TICK,
            robot_pose=seen.robot_pose,
            past=np.concatenate([world.past[1:], seen.object_pose[None]]),
            ticks=world.ticks + 1,
            since=world.since + _TICK,
            lost=np.maximum(world.lost - _TICK, 0.0),
        )
        rate = self.imperfections.frame_rate
        if not rate or int(world.ticks * _TICK * rate + 1e-9) == int((world.ticks - 1) * _TICK * rate + 1e-9):
            return world
        return self._frame(world, rng)

    def _frame(self, world: ProxyWorld, rng: np.random.Generator) -> ProxyWorld:
        """One camera frame: detections with noise and drop-outs into an alpha-beta filter per object."""
        at = self.imperfections
        sigma = np.array([at.position_noise, at.position_noise, at.yaw_noise])
        detected = world.past[0] + sigma * rng.normal(size=world.pose.shape)
        lost = np.where(rng.random(world.lost.shape) < at.burst, at.burst_time, world.lost)
        found = (lost <= 0) & (rng.random(lost.shape) >= at.drop_out)
        dt = world.since[..., None]
        ahead = world.pose + world.twist * dt
        error = detected - ahead
        error[..., 2] = se2.wrap(error[..., 2])
        # A lost object is taken to come to rest.
        fading = world.twist * np.exp(-dt / 0.3)
        seen = found[..., None]
        pose = np.where(seen, ahead + 0.5 * error, ahead)
        pose[..., 2] = se2.wrap(pose[..., 2])
        twist = np.where(seen, world.twist + 0.15 / dt * error, fading)
        return world._replace(pose=pose, twist=twist, lost=lost, since=np.zeros_like(world.since))

    def _felt(self, world: ProxyWorld, command: Command) -> np.ndarray:
        """Gamma by J tau ``[W, N, 3]``, given to the object nearest to the hands; weak readings count as no contact."""
        wrench = np.zeros_like(world.pose)
        if not wrench.size or not self.imperfections.force_from_torque:
            return wrench
        robot, torque = self.engine.robot(world.truth), self.engine.torque(world.truth, command)[:, 3:]
        ahead = robot.pose[:, :2] + se2.rotate(
            np.stack([world.truth.control.reach, 0 * robot.height], -1), robot.pose[:, 2]
        )
        nearest = np.argmin(np.linalg.norm(world.pose[..., :2] - ahead[:, None], axis=-1), axis=1)
        rows = np.arange(len(nearest))
        felt = joint_torque_wrench(robot, torque, world.pose[rows, nearest])
        wrench[rows, nearest] = np.where(np.hypot(felt[:, 0], felt[:, 1])[:, None] > 2.0, felt, 0.0)
        return wrench
