"""Shmoobot's numbers and kinematics, as the low-level control knows them.

The control knows nominal values only: what models_xml/shmoobot.xml says, never what an engine's randomised model holds.
``ROBOT`` is the single home of the numbers that are not in the XML; a test compares the two where both have one.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from shmoo_mjx import se2

__all__ = [
    "ROBOT",
    "Robot",
    "RobotState",
    "arm_angles",
    "arm_jacobian",
    "com_offset",
    "hand_in_body",
    "quat_rotate",
    "readout",
]

Array = Any


@dataclass(frozen=True)
class Robot:
    """Nominal robot, SI units."""

    ball_radius: float = 0.105
    ball_mass: float = 2.5
    body_mass: float = 32.0
    body_com_height: float = 0.5
    """Height of the body's CoM (without arms) above the ball's centre."""
    body_inertia: tuple[float, float, float] = (3.0, 3.0, 0.5)
    """Principal moments about the body's CoM."""
    shoulder: tuple[float, float, float] = (0.06, 0.17, 0.675)
    """Left shoulder in the body frame (origin at the ball's centre); the right one mirrors y."""
    upper_arm: float = 0.30
    forearm: float = 0.33
    upper_arm_mass: float = 1.0
    forearm_mass: float = 0.6
    hand_mass: float = 0.2
    drive_limit: float = 50.0
    """Roll and pitch torque limit between body and ball."""
    drive_coulomb: float = 1.5
    drive_viscous: float = 0.6
    """Drive friction between body and ball [N m, N m s/rad]."""
    radius: float = 0.18
    """Radius of the body seen from above."""

    @property
    def flatness(self) -> tuple[float, float, float]:
        """(a, b, c) of one linearised plane, a x'' + b phi'' = c phi, arms folded near the body's CoM.

        The flat output is S = x + (b/a) phi and phi = (a/c) S''.
        """
        m, height, r = self.upper_mass, self.body_com_height, self.ball_radius
        total = m + self.ball_mass * (1 + 2 / 5)  # a solid ball's I / r^2
        moment = m * height
        return total * r + moment, self.body_inertia[0] + moment * (height + r), moment * 9.81

    @property
    def upper_mass(self) -> float:
        """Mass of everything above the ball."""
        return self.body_mass + 2 * (self.upper_arm_mass + self.forearm_mass + self.hand_mass)


ROBOT = Robot()


class RobotState(NamedTuple):
    """The robot's state in the frames the control works in."""

    pose: Array
    """``[..., 3]`` of {R} in {W}."""
    twist: Array
    """``[..., 3]`` of {R} in {W}."""
    rotation: Array
    """``[..., 3, 3]`` body axes in the levelled robot frame {R} (columns)."""
    lean: Array
    """``[..., 2]`` lean of the body axis towards +x, +y of {R} [rad]."""
    lean_rate: Array
    """``[..., 2]`` [rad/s]"""
    drive_rate: Array
    """``[..., 3]`` angular velocity of the ball relative to the body, in the body frame [rad/s]."""
    height: Array
    """``[...]`` of the ball's centre above the floor [m]."""
    arms: Array
    """``[..., 2, 3]`` joint angles (left, right) x (yaw, pitch, elbow) [rad]."""
    arm_rates: Array
    """``[..., 2, 3]`` [rad/s]"""


def quat_rotate(quat: Array, vector: Array) -> Array:
    """Rotate ``vector [..., 3]`` by the unit quaternion ``quat [..., 4]`` (w, x, y, z)."""
    xp = se2.array_module(quat, vector)
    w, q = quat[..., :1], quat[..., 1:]
    t = 2.0 * xp.stack(_cross(q, vector), axis=-1)
    return vector + w * t + xp.stack(_cross(q, t), axis=-1)


def _cross(a: Array, b: Array) -> list[Array]:
    # numpy.cross costs ten times as much for one vector, and this runs at 500 Hz.
    return [
        a[..., 1] * b[..., 2] - a[..., 2] * b[..., 1],
        a[..., 2] * b[..., 0] - a[..., 0] * b[..., 2],
        a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0],
    ]


def _matrix(quat: Array) -> Array:
    xp = se2.array_module(quat)
    w, x, y, z = quat[..., 0], quat[..., 1], quat[..., 2], quat[..., 3]
    rows = [
        1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
        2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
        2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y),
    ]  # fmt: skip
    return xp.stack(rows, axis=-1).reshape(*quat.shape[:-1], 3, 3)


def readout(qpos: Array, qvel: Array) -> RobotState:
    """Robot state from MuJoCo's generalised coordinates of the robot: root (7, 6), ball (4, 3), arms (6, 6).

    Args:
        qpos: ``[..., 17]``.
        qvel: ``[..., 15]``; MuJoCo gives the angular velocity of free and ball joints in the child's own frame.
    """
    xp = se2.array_module(qpos, qvel)
    body = _matrix(qpos[..., 3:7])
    yaw = xp.arctan2(body[..., 1, 0], body[..., 0, 0])
    c, s = xp.cos(yaw), xp.sin(yaw)
    c, s = c[..., None], s[..., None]
    rows = [c * body[..., 0, :] + s * body[..., 1, :], c * body[..., 1, :] - s * body[..., 0, :], body[..., 2, :]]
    rotation = xp.stack(rows, axis=-2)
    omega = xp.einsum("...ij,...j->...i", rotation, qvel[..., 3:6])
    lean = xp.stack(
        [xp.arctan2(rotation[..., 0, 2], rotation[..., 2, 2]), xp.arctan2(rotation[..., 1, 2], rotation[..., 2, 2])],
        axis=-1,
    )
    return RobotState(
        pose=xp.stack([qpos[..., 0], qpos[..., 1], yaw], axis=-1),
        twist=xp.stack([qvel[..., 0], qvel[..., 1], omega[..., 2]], axis=-1),
        rotation=rotation,
        lean=lean,
        lean_rate=xp.stack([omega[..., 1], -omega[..., 0]], axis=-1),
        drive_rate=quat_rotate(qpos[..., 7:11], qvel[..., 6:9]),
        height=qpos[..., 2],
        arms=qpos[..., 11:17].reshape(*qpos.shape[:-1], 2, 3),
        arm_rates=qvel[..., 9:15].reshape(*qvel.shape[:-1], 2, 3),
    )


_SHOULDERS = np.array([ROBOT.shoulder, (ROBOT.shoulder[0], -ROBOT.shoulder[1], ROBOT.shoulder[2])])


def hand_in_body(arms: Array) -> Array:
    """Hand centres ``[..., 2, 3]`` in the body frame from joint angles ``[..., 2, 3]``."""
    xp = se2.array_module(arms)
    yaw, pitch, fore = arms[..., 0], arms[..., 1], arms[..., 1] + arms[..., 2]
    out = ROBOT.upper_arm * xp.cos(pitch) + ROBOT.forearm * xp.cos(fore)
    down = ROBOT.upper_arm * xp.sin(pitch) + ROBOT.forearm * xp.sin(fore)
    return _SHOULDERS + xp.stack([out * xp.cos(yaw), out * xp.sin(yaw), -down], axis=-1)


def arm_angles(hands: np.ndarray) -> np.ndarray:
    """Joint angles ``[2, 3]`` that put the hands ``[2, 3]`` (body frame) there, elbows up: inverts `hand_in_body`."""
    x, y, z = (hands - _SHOULDERS).T
    out, l1, l2 = np.hypot(x, y), ROBOT.upper_arm, ROBOT.forearm
    elbow = -np.arccos(np.clip((out * out + z * z - l1 * l1 - l2 * l2) / (2 * l1 * l2), -1.0, 1.0))
    pitch = np.arctan2(-z, out) - np.arctan2(l2 * np.sin(elbow), l1 + l2 * np.cos(elbow))
    return np.stack([np.arctan2(y, x), pitch, elbow], axis=-1)


def arm_jacobian(arms: Array) -> Array:
    """d hand / d joint angles ``[..., 2, 3, 3]`` (arm, x y z, joint) in the body frame."""
    xp = se2.array_module(arms)
    yaw, pitch, fore = arms[..., 0], arms[..., 1], arms[..., 1] + arms[..., 2]
    l1, l2 = ROBOT.upper_arm, ROBOT.forearm
    c, s = xp.cos(yaw), xp.sin(yaw)
    out = l1 * xp.cos(pitch) + l2 * xp.cos(fore)
    down, fore_down = l1 * xp.sin(pitch) + l2 * xp.sin(fore), l2 * xp.sin(fore)
    fore_out = l2 * xp.cos(fore)
    zero = xp.zeros_like(out)
    columns = [
        xp.stack([-out * s, out * c, zero], axis=-1),
        xp.stack([-down * c, -down * s, -out], axis=-1),
        xp.stack([-fore_down * c, -fore_down * s, -fore_out], axis=-1),
    ]
    return xp.stack(columns, axis=-1)


def com_offset(arms: Array) -> Array:
    """Horizontal CoM ``[..., 2]`` of body and arms in the body frame [m]: what the CoM feed-forward subtracts."""
    xp = se2.array_module(arms)
    yaw, pitch, fore = arms[..., 0], arms[..., 1], arms[..., 1] + arms[..., 2]
    l1, l2 = ROBOT.upper_arm, ROBOT.forearm
    elbow, hand = l1 * xp.cos(pitch), l1 * xp.cos(pitch) + l2 * xp.cos(fore)
    masses = ROBOT.upper_arm_mass, ROBOT.forearm_mass, ROBOT.hand_mass
    out = masses[0] * elbow / 2 + masses[1] * (elbow + hand) / 2 + masses[2] * hand
    moment = sum(masses) * _SHOULDERS[:, :2] + xp.stack([out * xp.cos(yaw), out * xp.sin(yaw)], axis=-1)
    return xp.sum(moment, axis=-2) / ROBOT.upper_mass
