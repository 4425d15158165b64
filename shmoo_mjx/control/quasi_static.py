"""Quasi-static pushing controller, a baseline from geometry alone, without a learned model of the object.

It assumes that the object moves rigidly with the two hands (a stable line contact, Lynch and Mason 1996) and stops when
the hands stop. The hands follow the arc that ends at the goal with the goal's yaw, at the speed of
a :class:`~shmoo_mjx.control.speed.SpeedProfile`. The lean balances the sensed force. The interface is that of
:class:`~shmoo_mjx.control.pushing.PushController`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from shmoo_mjx.arrays import Array, Float, Key, Scalar
from shmoo_mjx.control.governor import GovernorConfig, forward_lean
from shmoo_mjx.control.observation import LocalDistanceField, ObjectObservation
from shmoo_mjx.control.presets import PushConfig
from shmoo_mjx.control.speed import SpeedProfile
from shmoo_mjx.geometry import se2
from shmoo_mjx.geometry.hands import REACH
from shmoo_mjx.learning.online import LearnerState
from shmoo_mjx.plant.lowlevel import Gains, velocity_to_lean

# The gains are tuned on objects of the development seeds.
_STEER = 1.2
"""Steering angle per heading error [1]. Larger steers more."""
_STEER_LIMIT = 0.35
"""Largest steering angle [rad], a little less than that of the pushing controller."""
_AHEAD = 0.4
"""Look-ahead distance on the arc for the heading [m]. Larger anticipates the curvature more."""
_CENTRE = 0.8
"""Sideways speed per lateral offset of the hands from their target on the face [1/s]. Larger corrects faster."""
_SHIFT = 0.5
"""Lateral shift of the hands along the face per heading error [m/rad]. Larger turns the object more."""
LEAN_LIMIT = PushConfig().control.high[0]
"""Largest forward lean [rad], the same as for the pushing controller."""


class QuasiStaticState(NamedTuple):
    """State of one push."""

    face: Float[Array, "4"]
    """The pushed face in {O}: centre x, y [m], direction of the inward normal [rad], half width [m]."""
    pose: Float[Array, "3"]
    """Current pose of the object in {W}."""
    adapt: LearnerState | None
    """Estimate of the object, passed through unchanged."""
    governor_integral: Scalar
    """Integral state of the governor's velocity loop [rad]."""


class QuasiStaticPusher:
    """Pushing controller with quasi-static geometry, at the speed that ``speed`` allows."""

    def __init__(self, speed: SpeedProfile) -> None:
        self.speed = speed

    def init(
        self,
        obs: ObjectObservation,
        face: Float[Array, "4"],
        half_extents: Float[Array, "2"] | None,
        key: Key[Array, ""] | None,
        *,
        adapt: LearnerState | None = None,
        kind: str | None = None,
    ) -> QuasiStaticState:
        """The initial state of a push on ``face``. The arguments are those of `PushController.init`."""
        return QuasiStaticState(np.asarray(face), obs.object_pose, adapt, np.zeros(()))

    def step(
        self,
        state: QuasiStaticState,
        obs: ObjectObservation,
        *,
        goal: Float[Array, "3"],
        last_u: Float[Array, "3"] | None = None,
        half_extents: Float[Array, "2"] | None = None,
        clearance: LocalDistanceField | None = None,
    ) -> tuple[Float[np.ndarray, "3"], QuasiStaticState, None]:
        """The command for the next sample [rad]. The arguments are those of `PushController.step`."""
        goal = np.asarray(goal, dtype=float)
        u, integral = control(self.speed, obs, state.governor_integral, face=state.face, goal=goal)
        return np.asarray(u), state._replace(pose=obs.object_pose, governor_integral=integral), None

    def coast(self, state: QuasiStaticState) -> Float[np.ndarray, "3"]:
        """Pose in {W} at which the object comes to rest if it is released now: its current pose."""
        return np.asarray(state.pose)


def control(
    speed: SpeedProfile,
    obs: ObjectObservation,
    governor_integral: Scalar,
    *,
    face: Float[Array, "4"],
    goal: Float[Array, "3"],
) -> tuple[Float[Array, "3"], Scalar]:
    """The command [rad] and the governor's next integral state [rad]. A pure function for NumPy and JAX arrays.

    Args:
        speed: allowed speed.
        obs: current observation.
        governor_integral: integral state of the governor's velocity loop [rad].
        face: the pushed face in {O}.
        goal: desired object pose in {W}.
    """
    pose, xp = obs.object_pose, se2.array_module(obs.object_pose, obs.robot_pose)
    offset = goal[:2] - pose[:2]
    bearing = xp.arctan2(offset[1], offset[0])
    lead = se2.wrap(bearing - goal[2] - face[2])
    # The arc to the goal starts in the direction of the bearing plus the lead. Beside or beyond the goal, only the yaw
    # is corrected.
    ahead = abs(lead) < np.pi / 2
    wanted = xp.where(ahead, bearing + xp.clip(lead, -0.6, 0.6), goal[2] + face[2])
    distance = xp.hypot(offset[0], offset[1])
    curvature = xp.where(ahead, -2.0 * xp.sin(lead) / xp.maximum(distance, 0.3), 0.0)
    # Feed the curvature of the arc forward, because the error alone would lag behind it.
    error = se2.wrap(pose[2] + face[2] - wanted) - _AHEAD * curvature
    sideways = _sideways(face, obs, error)
    velocity = se2.rotate(obs.robot_twist[:2], -obs.robot_pose[2])
    lean = velocity_to_lean(Gains(), velocity, obs.lean_rate, xp.stack([0.0 * sideways, sideways]))
    forward, integral = forward_lean(GovernorConfig(), obs, speed.allowed(distance), governor_integral)
    forward = xp.clip(forward, -LEAN_LIMIT, LEAN_LIMIT)
    return xp.stack([forward, lean[1], xp.clip(_STEER * error, -_STEER_LIMIT, _STEER_LIMIT)]), integral


def _sideways(face: Array, obs: ObjectObservation, error: Scalar) -> Scalar:
    """Speed along the face [m/s] that moves the hands to where their push reduces the heading ``error`` [rad]."""
    xp = se2.array_module(obs.robot_pose, error)
    in_face = se2.relative(se2.compose(obs.object_pose, face[:3]), obs.robot_pose)
    hands = in_face[1] + REACH * xp.sin(in_face[2])
    # A push to the right of the centre turns the object to the left.
    room = xp.maximum(face[3] - 0.18, 0.0)
    return xp.clip(_CENTRE * (xp.clip(_SHIFT * error, -room, room) - hands), -0.1, 0.1)
