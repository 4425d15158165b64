"""Observations from generalised coordinates and contact sensors, for both engines."""

from __future__ import annotations

from typing import Any

import numpy as np

from shmoo_mjx.arrays import Array, ArrayT, Bool, Float, Int, single_precision
from shmoo_mjx.geometry import se2
from shmoo_mjx.plant.robot import RobotState, readout
from shmoo_mjx.plant.scene import Scene
from shmoo_mjx.types import Observation


def scene_poses(
    scene: Scene, physics: Float[np.ndarray, "... n"]
) -> tuple[Float[np.ndarray, "... 3"], Float[np.ndarray, "... N 3"]]:
    """Poses (x, y, yaw) of the robot and of the objects in {W} [m, rad], from full physics states."""
    poses = _planar_poses(physics[..., 1:], np.concatenate([[0], scene.object_qpos]))
    return poses[..., 0, :], poses[..., 1:, :]


def _planar_poses(qpos: ArrayT, joints: Int[np.ndarray, "n"]) -> ArrayT:
    """Poses ``[..., n, 3]`` in {W} of the bodies whose free joints start at the indices ``joints`` of qpos."""
    xp = se2.array_module(qpos)
    x, y, qw, qx, qy, qz = (qpos[..., joints + i] for i in (0, 1, 3, 4, 5, 6))
    return se2.stack(x, y, xp.arctan2(2 * (qw * qz + qx * qy), 1 - 2 * (qy * qy + qz * qz)))


DIVERGED = "the simulation diverged: a number in its state is not finite or far beyond what can happen"
"""Reason that a run reports if its physics diverged."""
_FASTEST = 1e4
"""Joint speed at or above which a world counts as diverged [m/s, rad/s]."""


def diverged(qpos: Float[Array, "... nq"], qvel: Float[Array, "... nv"]) -> Bool[Array, "..."]:
    """Which worlds have diverged: NaN or infinite coordinates, or a joint speed of 10^4 m/s or rad/s or more."""
    xp = se2.array_module(qpos, qvel)
    return ~(xp.isfinite(qpos).all(axis=-1) & (xp.abs(qvel) < _FASTEST).all(axis=-1))


def fallen(lean: Float[Array, "... 2"]) -> Bool[Array, "..."]:
    """Which robots have fallen: the lean exceeds 0.6 rad or is NaN."""
    xp = se2.array_module(lean)
    return ~(xp.abs(se2.wrap(lean)) <= 0.6).all(axis=-1)


def toppled(scene: Scene, qpos: Float[np.ndarray, "... nq"]) -> Bool[np.ndarray, "... N"]:
    """Which objects have toppled or are about to: they tilt by more than 0.5 rad."""
    qx, qy = (qpos[..., scene.object_qpos + i] for i in (4, 5))
    return 1 - 2 * (qx**2 + qy**2) < np.cos(0.5)


class TrueStates:
    """Mixin of both engines that reads true states (ground truth), for W worlds or one."""

    scenes: list[Scene]
    """One scene per world."""

    def _split(self, physics: Array) -> tuple[Array, Array]:
        """Generalised coordinates and velocities of full physics states."""
        nq, nv = self.scenes[0].model.nq, self.scenes[0].model.nv
        return physics[..., 1 : 1 + nq], physics[..., 1 + nq : 1 + nq + nv]

    @single_precision
    def robot(self, world: Any) -> RobotState:
        """True state of the robots."""
        return readout(*self._split(world.physics))

    @single_precision
    def fallen(self, world: Any) -> Bool[Array, "..."]:
        """Whether the robot's body leans more than 0.6 rad. True for diverged worlds."""
        return fallen(self.robot(world).lean)

    @single_precision
    def diverged(self, world: Any) -> Bool[Array, "..."]:
        """Whether the physics has diverged (:func:`diverged`). A diverged world stays diverged."""
        return diverged(*self._split(world.physics))


def observation(
    scene: Scene,
    time: Float[Array, "..."],
    qpos: Float[Array, "... nq"],
    qvel: Float[Array, "... nv"],
    *,
    wrench: Float[Array, "... N 3"],
) -> Observation:
    """Noise-free observation from generalised coordinates and the mean wrench.

    Args:
        scene: scene of the worlds.
        time: simulated time [s].
        qpos: generalised coordinates.
        qvel: generalised velocities.
        wrench: mean planar wrench of the hands on each object in {W} [N, N m].
    """
    xp = se2.array_module(qpos, qvel)
    robot = readout(qpos, qvel)
    hands = xp.einsum("...ij,...hj->...hi", robot.rotation, scene.robot.hand_in_body(robot.arms))
    level = xp.zeros_like(robot.height)
    lift = se2.stack(level, level, robot.height)
    pose = _planar_poses(qpos, scene.object_qpos)
    # A free joint's angular velocity is in the body frame. Its z component is the yaw rate, since objects stay level up
    # to contact compliance.
    twist = qvel[..., scene.object_qvel[:, None] + np.array([0, 1, 5])]
    return Observation(
        time=time,
        robot_pose=robot.pose,
        robot_twist=robot.twist,
        lean=robot.lean,
        lean_rate=robot.lean_rate,
        hands=hands + lift[..., None, :],
        object_pose=pose,
        object_twist=twist,
        wrench=wrench,
        robot_age=xp.zeros_like(robot.height),
        object_age=xp.zeros_like(pose[..., 0]),
        detected=xp.ones_like(pose[..., 0], dtype=bool),
    )


def planar_wrench(
    scene: Scene, qpos: Float[Array, "... nq"], sensordata: Float[Array, "... sensors"]
) -> Float[Array, "... N 3"]:
    """Wrench Gamma of both hands on each object about its centre, in {W}.

    Each contact sensor gives the net force and torque at a point. The planar moment about the object's centre is
    lever x force plus the vertical torque.

    Args:
        scene: scene of the worlds.
        qpos: generalised coordinates at which the sensors were evaluated.
        sensordata: MuJoCo's sensor data.

    Returns:
        (fx, fy, tz) [N, N m].
    """
    xp = se2.array_module(qpos, sensordata)
    adr = scene.contact_sensor  # [N, 2]
    if scene.framed:
        force, torque = _from_contact_frame(sensordata, adr)
    else:
        force = sensordata[..., adr[:, :, None] + [0, 1]]
        torque = sensordata[..., adr + 5]
    point = sensordata[..., adr[:, :, None] + [6, 7]]
    centre = qpos[..., scene.object_qpos[:, None] + [0, 1]][..., None, :]
    moment = se2.cross(point - centre, force) + torque
    return xp.sum(xp.concatenate([force, moment[..., None]], axis=-1), axis=-2)


def _from_contact_frame(sensordata: Array, adr: np.ndarray) -> tuple[Array, Array]:
    """Planar force ``[..., N, 2, 2]`` and vertical torque ``[..., N, 2]`` in {W}, from sensors in the contact frame."""
    xp = se2.array_module(sensordata)
    force, torque, normal, tangent = (sensordata[..., adr[:, :, None] + [i, i + 1, i + 2]] for i in (0, 3, 9, 12))
    axes = xp.stack([normal, tangent, xp.cross(normal, tangent)], axis=-2)
    force = xp.einsum("...i,...ij->...j", force, axes)
    return force[..., :2], xp.einsum("...i,...i->...", torque, axes[..., 2])
