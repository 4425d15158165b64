"""Observations of both engines, from generalised coordinates and contact sensors."""

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
    """Poses in {W} of the robots and of the objects, from full physics states."""
    poses = _planar_poses(physics[..., 1:], np.concatenate([[0], scene.object_qpos]))
    return poses[..., 0, :], poses[..., 1:, :]


def _planar_poses(qpos: ArrayT, joints: Int[np.ndarray, "n"]) -> ArrayT:
    """Poses ``[..., n, 3]`` in {W} of the bodies whose free joints begin at ``joints`` in qpos."""
    xp = se2.array_module(qpos)
    x, y, qw, qx, qy, qz = (qpos[..., joints + i] for i in (0, 1, 3, 4, 5, 6))
    return se2.stack(x, y, xp.arctan2(2 * (qw * qz + qx * qy), 1 - 2 * (qy * qy + qz * qz)))


DIVERGED = "the simulation diverged: a number in its state is not finite or far beyond what can happen"
"""Reason of a run that ended so."""
_FASTEST = 1e4
"""Speed of any joint from which a world counts as diverged [m/s, rad/s]."""


def diverged(qpos: Float[Array, "... nq"], qvel: Float[Array, "... nv"]) -> Bool[Array, "..."]:
    """Which worlds are lost: NaN or infinite coordinates, or a joint that moves faster than 10^4 m/s or rad/s."""
    xp = se2.array_module(qpos, qvel)
    return ~(xp.isfinite(qpos).all(axis=-1) & (xp.abs(qvel) < _FASTEST).all(axis=-1))


def fallen(lean: Float[Array, "... 2"]) -> Bool[Array, "..."]:
    """Which robots lean more than 0.6 rad, or by no number at all."""
    xp = se2.array_module(lean)
    return ~(xp.abs(se2.wrap(lean)) <= 0.6).all(axis=-1)


def toppled(scene: Scene, qpos: Float[np.ndarray, "... nq"]) -> Bool[np.ndarray, "... N"]:
    """Which objects lean more than 0.5 rad: they have fallen over, or are about to."""
    qx, qy = (qpos[..., scene.object_qpos + i] for i in (4, 5))
    return 1 - 2 * (qx**2 + qy**2) < np.cos(0.5)


class TrueStates:
    """What is read alike from the worlds of both engines: true states, of W worlds or of one."""

    scenes: list[Scene]

    def _split(self, physics: Array) -> tuple[Array, Array]:
        """Generalised coordinates and velocities in full physics states."""
        nq, nv = self.scenes[0].model.nq, self.scenes[0].model.nv
        return physics[..., 1 : 1 + nq], physics[..., 1 + nq : 1 + nq + nv]

    @single_precision
    def robot(self, world: Any) -> RobotState:
        """The robots' true state."""
        return readout(*self._split(world.physics))

    @single_precision
    def fallen(self, world: Any) -> Bool[Array, "..."]:
        """Whether the body leans more than 0.6 rad; true of a world that has diverged."""
        return fallen(self.robot(world).lean)

    @single_precision
    def diverged(self, world: Any) -> Bool[Array, "..."]:
        """Whether the physics is lost (:func:`diverged`); the world stays so."""
        return diverged(*self._split(world.physics))


def observation(
    scene: Scene,
    time: Float[Array, "..."],
    qpos: Float[Array, "... nq"],
    qvel: Float[Array, "... nv"],
    *,
    wrench: Float[Array, "... N 3"],
) -> Observation:
    """Observation from generalised coordinates and the mean wrench."""
    xp = se2.array_module(qpos, qvel)
    robot = readout(qpos, qvel)
    hands = xp.einsum("...ij,...hj->...hi", robot.rotation, scene.robot.hand_in_body(robot.arms))
    level = xp.zeros_like(robot.height)
    lift = se2.stack(level, level, robot.height)
    pose = _planar_poses(qpos, scene.object_qpos)
    # A free joint's angular velocity is in the body's own frame; objects stay level but for the sag of their contacts.
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
    """Wrench Gamma of both hands on each object about its centre, in {W}: (fx, fy, tz).

    Each contact sensor gives the net force and torque at a point; the planar moment about the object's centre is
    lever x force plus the vertical torque.
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
    """Planar force ``[..., N, 2, 2]`` and vertical torque ``[..., N, 2]`` in {W} from framed sensors."""
    xp = se2.array_module(sensordata)
    force, torque, normal, tangent = (sensordata[..., adr[:, :, None] + [i, i + 1, i + 2]] for i in (0, 3, 9, 12))
    axes = xp.stack([normal, tangent, xp.cross(normal, tangent)], axis=-2)
    force = xp.einsum("...i,...ij->...j", force, axes)
    return force[..., :2], xp.einsum("...i,...i->...", torque, axes[..., 2])
