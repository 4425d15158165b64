"""Nominal parameters and kinematics of a ball-balancing robot with two arms, read from its MJCF by name.

The low-level control uses only these nominal values, never those of a randomised or perturbed model.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from shmoo_mjx.arrays import Array, ArrayT, Float
from shmoo_mjx.base.assets import asset
from shmoo_mjx.errors import ShmooError
from shmoo_mjx.geometry import se2

_SIDES = ("left", "right")
_ARM_JOINTS = ("shoulder_yaw", "shoulder_pitch", "elbow")
ACTUATORS = ("drive_x", "drive_y", "drive_z", *(f"{side}_{joint}" for side in _SIDES for joint in _ARM_JOINTS))
"""Motors of a robot, in the order of `lowlevel.control`'s torques."""
_BALL, _ARMS = (slice(7, 11), slice(6, 9)), (slice(11, 17), slice(9, 15))
"""Slices of the ball's and the arms' joints in (qpos, qvel); `Robot.from_mjcf` checks them."""
NQ, NV = 17, 15
"""Number of the robot's entries in qpos and qvel. They are the first entries in every world."""


@dataclass(frozen=True)
class Robot:
    """Nominal robot parameters, SI units. "Body" is the torso without the arms."""

    mjcf: Path
    """MJCF file from which the parameters are read."""
    ball_radius: float
    """Radius of the ball [m]."""
    ball_mass: float
    """Mass of the ball [kg]."""
    body_mass: float
    """Mass of the body [kg]."""
    body_com_height: float
    """Height of the body's CoM above the ball's centre [m]."""
    body_inertia: tuple[float, float, float]
    """Principal moments of inertia about the body's CoM [kg m^2]."""
    torso: tuple[float, float]
    """Lower and upper end of the axis of the torso's bounding capsule, above the ball's centre [m]."""
    radius: float
    """Radius of the torso's bounding capsule [m]."""
    shoulder: tuple[float, float, float]
    """Left shoulder in the body frame (origin at the ball's centre) [m]. The right shoulder mirrors y."""
    upper_arm: float
    """Length of the upper arm [m]."""
    forearm: float
    """Length of the forearm [m]."""
    arm_radius: float
    """Radius of the arm's capsules [m]."""
    hand_radius: float
    """Radius of the hand's sphere [m]."""
    upper_arm_mass: float
    """Mass of one upper arm [kg]."""
    forearm_mass: float
    """Mass of one forearm [kg]."""
    hand_mass: float
    """Mass of one hand [kg]."""
    drive_limit: float
    """Largest roll and pitch torque between body and ball [N m]."""
    drive_coulomb: float
    """Coulomb friction torque between body and ball [N m]."""
    drive_viscous: float
    """Viscous friction between body and ball [N m s/rad]."""

    @classmethod
    def from_mjcf(cls, path: Path) -> Robot:
        """Read the robot from an MJCF file.

        Args:
            path: file with the names of bodies, joints, geoms and motors of models_xml/shmoobot.xml.

        Raises:
            ShmooError: the file is not valid MJCF, a name is missing, the joints or motors are in another order, or
                the right arm is not the mirror image of the left one.
        """
        # A local import: users of the kinematics alone need not load the simulator.
        import mujoco

        try:
            model = mujoco.MjModel.from_xml_path(str(path))
        except ValueError as error:
            raise ShmooError(f"{path}: is no MJCF that MuJoCo can compile: {error}") from error
        try:
            return cls._of(model, path)
        except KeyError as error:
            raise ShmooError(f"{path}: {error.args[0]}; name its parts as models_xml/shmoobot.xml does.") from error

    @classmethod
    def _of(cls, model: Any, path: Path) -> Robot:
        _check_order(model, path)
        left, right = (_arm(model, side) for side in _SIDES)
        if not np.allclose(left, right * np.array([1, -1, *[1] * (len(left) - 2)])):
            raise ShmooError(f"{path}: the right arm must mirror the left one (place, lengths, masses and radii).")
        body, hull, drive = model.body("torso"), model.geom("torso_hull"), model.joint("ball")
        shoulder, (upper_arm, forearm, *masses), radii = left[:3], left[3:8], left[8:]
        # MuJoCo stores a capsule's centre and half length. Rounding recovers the end points of the file.
        bottom, top = (round(float(hull.pos[2] + sign * hull.size[1]), 9) for sign in (-1, 1))
        return cls(
            mjcf=path,
            ball_radius=float(model.geom("ball").size[0]),
            ball_mass=float(model.body("ball").mass[0]),
            body_mass=float(body.mass[0]),
            body_com_height=float(body.ipos[2]),
            body_inertia=tuple(body.inertia.tolist()),
            torso=(bottom, top),
            radius=float(hull.size[0]),
            shoulder=tuple(shoulder.tolist()),
            upper_arm=float(upper_arm),
            forearm=float(forearm),
            arm_radius=float(radii[0]),
            hand_radius=float(radii[1]),
            upper_arm_mass=float(masses[0]),
            forearm_mass=float(masses[1]),
            hand_mass=float(masses[2]),
            drive_limit=float(model.actuator("drive_x").ctrlrange[1]),
            drive_coulomb=float(drive.frictionloss[0]),
            drive_viscous=float(drive.damping[0]),
        )

    @property
    def flatness(self) -> tuple[float, float, float]:
        """Coefficients (a, b, c) of the linearised dynamics of one plane, a x'' + b phi'' = c phi.

        The arms count as point masses at the body's CoM, which approximates folded arms. The flat output is
        S = x + (b/a) phi, and phi = (a/c) S''.
        """
        m, height, r = self.upper_mass, self.body_com_height, self.ball_radius
        total = m + self.ball_mass * (1 + 2 / 5)  # a solid ball's I / r^2
        moment = m * height
        return total * r + moment, self.body_inertia[0] + moment * (height + r), moment * 9.81

    @property
    def upper_mass(self) -> float:
        """Mass of body, arms and hands [kg]."""
        return self.body_mass + 2 * (self.upper_arm_mass + self.forearm_mass + self.hand_mass)

    @property
    def shoulders(self) -> Float[np.ndarray, "2 3"]:
        """Left and right shoulder in the body frame [m]."""
        x, y, z = self.shoulder
        return np.array([(x, y, z), (x, -y, z)])

    def hand_in_body(self, arms: Float[Array, "... 2 3"]) -> Float[Array, "... 2 3"]:
        """Forward kinematics: hand centres in the body frame [m] from joint angles [rad]."""
        xp = se2.array_module(arms)
        yaw, pitch, fore = arms[..., 0], arms[..., 1], arms[..., 1] + arms[..., 2]
        out = self.upper_arm * xp.cos(pitch) + self.forearm * xp.cos(fore)
        down = self.upper_arm * xp.sin(pitch) + self.forearm * xp.sin(fore)
        return self.shoulders + se2.stack(out * xp.cos(yaw), out * xp.sin(yaw), -down)

    def arm_angles(self, hands: Float[np.ndarray, "2 3"]) -> Float[np.ndarray, "2 3"]:
        """Inverse kinematics: elbow-up joint angles [rad] for hand centres in the body frame [m]."""
        x, y, z = (hands - self.shoulders).T
        out, l1, l2 = np.hypot(x, y), self.upper_arm, self.forearm
        elbow = -np.arccos(np.clip((out * out + z * z - l1 * l1 - l2 * l2) / (2 * l1 * l2), -1.0, 1.0))
        pitch = np.arctan2(-z, out) - np.arctan2(l2 * np.sin(elbow), l1 + l2 * np.cos(elbow))
        return np.stack([np.arctan2(y, x), pitch, elbow], axis=-1)

    def arm_jacobian(self, arms: Float[Array, "... 2 3"]) -> Float[Array, "... 2 3 3"]:
        """Jacobian of the hand centres in the body frame with axes (arm, x y z, joint) [m/rad]."""
        xp = se2.array_module(arms)
        yaw, pitch, fore = arms[..., 0], arms[..., 1], arms[..., 1] + arms[..., 2]
        l1, l2 = self.upper_arm, self.forearm
        c, s = xp.cos(yaw), xp.sin(yaw)
        out = l1 * xp.cos(pitch) + l2 * xp.cos(fore)
        down, fore_down = l1 * xp.sin(pitch) + l2 * xp.sin(fore), l2 * xp.sin(fore)
        fore_out = l2 * xp.cos(fore)
        zero = xp.zeros_like(out)
        columns = [
            se2.stack(-out * s, out * c, zero),
            se2.stack(-down * c, -down * s, -out),
            se2.stack(-fore_down * c, -fore_down * s, -fore_out),
        ]
        return se2.stack(*columns)

    def com_offset(self, arms: Float[Array, "... 2 3"]) -> Float[Array, "... 2"]:
        """Horizontal CoM of body and arms in the body frame [m]. The CoM feed-forward uses it."""
        xp = se2.array_module(arms)
        yaw, pitch, fore = arms[..., 0], arms[..., 1], arms[..., 1] + arms[..., 2]
        l1, l2 = self.upper_arm, self.forearm
        elbow, hand = l1 * xp.cos(pitch), l1 * xp.cos(pitch) + l2 * xp.cos(fore)
        masses = self.upper_arm_mass, self.forearm_mass, self.hand_mass
        out = masses[0] * elbow / 2 + masses[1] * (elbow + hand) / 2 + masses[2] * hand
        moment = sum(masses) * self.shoulders[:, :2] + xp.stack([out * xp.cos(yaw), out * xp.sin(yaw)], axis=-1)
        return xp.sum(moment, axis=-2) / self.upper_mass


def _arm(model: Any, side: str) -> np.ndarray:
    """Parameters of one arm, ``[10]``.

    Shoulder (x, y, z), lengths of upper arm and forearm, masses of upper arm, forearm and hand, radii of arm and hand.
    """
    parts = [model.body(f"{side}_{part}") for part in ("upper_arm", "forearm", "hand")]
    lengths = [parts[1].pos[0], parts[2].pos[0]]
    radii = [model.geom(f"{side}_{part}").size[0] for part in ("upper_arm", "hand")]
    return np.array([*parts[0].pos, *lengths, *(part.mass[0] for part in parts), *radii])


def _check_order(model: Any, path: Path) -> None:
    joints = [model.joint(name) for name in ("root", "ball", *ACTUATORS[3:])]
    first = [(j.qposadr[0], j.dofadr[0]) for j in joints]
    arms = [(_ARMS[0].start + i, _ARMS[1].start + i) for i in range(6)]
    if first != [(0, 0), (_BALL[0].start, _BALL[1].start), *arms] or (model.nq, model.nv) != (NQ, NV):
        raise ShmooError(f"{path}: the joints must be root, ball, and the arms' six, in the order of shmoobot.xml.")
    if tuple(model.actuator(i).name for i in range(model.nu)) != ACTUATORS:
        raise ShmooError(f"{path}: the motors must be {', '.join(ACTUATORS)}, in this order.")


@functools.cache
def shmoobot() -> Robot:
    """The robot of models_xml/shmoobot.xml."""
    return Robot.from_mjcf(asset("models_xml/shmoobot.xml"))


class RobotState(NamedTuple):
    """Robot state in the frames that the low-level control uses."""

    pose: Float[Array, "... 3"]
    """Pose (x, y, yaw) of {R} in {W} [m, rad]."""
    twist: Float[Array, "... 3"]
    """Twist (vx, vy, yaw rate) of {R} in {W} [m/s, rad/s]."""
    rotation: Float[Array, "... 3 3"]
    """Body axes in the levelled robot frame {R} (columns)."""
    lean: Float[Array, "... 2"]
    """Lean of the body axis towards +x, +y of {R} [rad]."""
    lean_rate: Float[Array, "... 2"]
    """Lean rate [rad/s]."""
    drive_rate: Float[Array, "... 3"]
    """Angular velocity of the ball relative to the body, in the body frame [rad/s]."""
    height: Float[Array, "..."]
    """Height of the ball's centre above the floor [m]."""
    arms: Float[Array, "... 2 3"]
    """Joint angles (left, right) x (yaw, pitch, elbow) [rad]."""
    arm_rates: Float[Array, "... 2 3"]
    """Joint rates (left, right) x (yaw, pitch, elbow) [rad/s]."""


def quat_rotate(quat: Float[ArrayT, "... 4"], vector: Float[ArrayT, "... 3"]) -> Float[ArrayT, "... 3"]:
    """Rotate ``vector`` by the unit quaternion ``quat`` (w, x, y, z)."""
    w, q = quat[..., :1], quat[..., 1:]
    t = 2.0 * se2.stack(*_cross(q, vector))
    return vector + w * t + se2.stack(*_cross(q, t))


def _cross(a: ArrayT, b: ArrayT) -> list[Any]:
    # This runs at 500 Hz, and numpy.cross takes ten times as long for a single vector.
    return [
        a[..., 1] * b[..., 2] - a[..., 2] * b[..., 1],
        a[..., 2] * b[..., 0] - a[..., 0] * b[..., 2],
        a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0],
    ]


def _matrix(quat: ArrayT) -> ArrayT:
    w, x, y, z = quat[..., 0], quat[..., 1], quat[..., 2], quat[..., 3]
    rows = [
        1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
        2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
        2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y),
    ]  # fmt: skip
    return se2.stack(*rows).reshape(*quat.shape[:-1], 3, 3)


def arm_joints(qpos: Float[ArrayT, "... nq"]) -> Float[ArrayT, "... 2 3"]:
    """Joint angles of the arms (left, right) x (yaw, pitch, elbow) [rad] in a qpos with at least NQ entries."""
    return se2.array_module(qpos).reshape(qpos[..., _ARMS[0]], (*qpos.shape[:-1], 2, 3))


def with_arms(qpos: Float[np.ndarray, "nq"], arms: Float[np.ndarray, "2 3"]) -> Float[np.ndarray, "nq"]:
    """Copy of a qpos with at least NQ entries, with the arms' joint angles replaced by ``arms`` [rad]."""
    qpos = qpos.copy()
    qpos[_ARMS[0]] = arms.ravel()
    return qpos


def readout(qpos: Float[Array, "... nq"], qvel: Float[Array, "... nv"]) -> RobotState:
    """Robot state from MuJoCo's generalised coordinates and velocities.

    Args:
        qpos: coordinates; the first NQ entries are the robot's (root, ball, arms), others are ignored.
        qvel: velocities; the first NV entries are the robot's. MuJoCo gives the angular velocity of free and ball
            joints in the child body's frame.
    """
    xp = se2.array_module(qpos, qvel)
    body = _matrix(qpos[..., 3:7])
    yaw = xp.arctan2(body[..., 1, 0], body[..., 0, 0])
    c, s = xp.cos(yaw), xp.sin(yaw)
    c, s = c[..., None], s[..., None]
    rows = [c * body[..., 0, :] + s * body[..., 1, :], c * body[..., 1, :] - s * body[..., 0, :], body[..., 2, :]]
    rotation = xp.stack(rows, axis=-2)
    omega = xp.einsum("...ij,...j->...i", rotation, qvel[..., 3:6])
    lean = xp.arctan2(rotation[..., :2, 2], rotation[..., 2:, 2])
    return RobotState(
        pose=se2.stack(qpos[..., 0], qpos[..., 1], yaw),
        twist=se2.stack(qvel[..., 0], qvel[..., 1], omega[..., 2]),
        rotation=rotation,
        lean=lean,
        lean_rate=se2.stack(omega[..., 1], -omega[..., 0]),
        drive_rate=quat_rotate(qpos[..., _BALL[0]], qvel[..., _BALL[1]]),
        height=qpos[..., 2],
        arms=arm_joints(qpos),
        arm_rates=qvel[..., _ARMS[1]].reshape(*qvel.shape[:-1], 2, 3),
    )
