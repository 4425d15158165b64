"""Quasi-static pushing controller, for comparison: geometry alone, no model of the object, nothing learned.

It takes the object to move as one with the two hands (a stable line contact, Lynch and Mason 1996) and to stand still
as soon as the hands do. The hands are driven along the arc that ends at the goal with the goal's yaw, as fast as
:func:`~shmoo_mjx.control.cost.allowed_speed` allows; the felt force is balanced by lean. Same signature as
:class:`~shmoo_mjx.control.pushing.PushController`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from shmoo_mjx.arrays import Array, Float, Key, Scalar
from shmoo_mjx.control.cost import PushCost, allowed_speed
from shmoo_mjx.control.governor import GovernorConfig, forward_lean
from shmoo_mjx.control.observation import LocalDistanceField, ObjectObservation
from shmoo_mjx.control.pushing import PushConfig
from shmoo_mjx.geometry import se2
from shmoo_mjx.geometry.hands import REACH
from shmoo_mjx.learning.online import Known
from shmoo_mjx.plant.lowlevel import Gains, velocity_to_lean

# Gains, tuned on objects of the development seeds.
_STEER = 1.2
"""Steering angle per rad of heading error [1]."""
_STEER_LIMIT = 0.35
"""Largest steering angle [rad]: a little less than the pushing controller's."""
_AHEAD = 0.4
"""How far ahead on the arc the heading is taken [m]."""
_CENTRE = 0.8
"""Sideways speed per metre that the hands are off the face's centre [1/s]."""
_SHIFT = 0.5
"""Metres that the hands are shifted along the face per rad of heading error [m/rad]."""
LEAN_LIMIT = PushConfig().control.high[0]
"""Largest forward lean [rad]: the pushing controller's."""


class QuasiStaticState(NamedTuple):
    """State of one push: the face, and where the object is."""

    face: Float[np.ndarray, "4"]
    pose: Float[np.ndarray, "3"]
    adapt: Known | None
    more: Scalar
    """Lean that the governor grants for lagging behind [rad]."""


class QuasiStaticPusher:
    """Pushing controller by quasi-static geometry; ``cost`` gives the speed allowed."""

    def __init__(self, cost: PushCost) -> None:
        self.cost = cost

    def init(
        self,
        obs: ObjectObservation,
        face: Float[Array, "4"],
        half_extents: Float[Array, "2"] | None,
        key: Key[Array, ""] | None,
        adapt: Known | None = None,
        kind: str | None = None,
    ) -> QuasiStaticState:
        """Start a push on ``face``."""
        return QuasiStaticState(np.asarray(face), obs.object_pose, adapt, np.zeros(()))

    def step(
        self,
        state: QuasiStaticState,
        obs: ObjectObservation,
        last_u: Float[Array, "3"],
        goal: Float[Array, "3"],
        around: LocalDistanceField,
        half_extents: Float[Array, "2"] | None,
    ) -> tuple[Float[np.ndarray, "3"], QuasiStaticState, None]:
        """The command for the next sample; arguments as for the controller it stands in for."""
        u, more = control(self.cost, state.face, obs, np.asarray(goal, dtype=float), state.more)
        return u, state._replace(pose=obs.object_pose, more=more), None

    def coast(self, state: QuasiStaticState) -> Float[np.ndarray, "3"]:
        """Pose at which the object comes to rest if it is let go now: where it is."""
        return state.pose


def control(
    cost: PushCost, face: Float[Array, "4"], obs: ObjectObservation, goal: Float[Array, "3"], more: Scalar
) -> tuple[Float[Array, "3"], Scalar]:
    """The command [rad] for ``face`` and ``goal`` in {W}, and the governor's next ``more``.

    Pure, on NumPy and JAX arrays alike.
    """
    pose, xp = obs.object_pose, se2.array_module(obs.object_pose, obs.robot_pose)
    offset = goal[:2] - pose[:2]
    bearing = xp.arctan2(offset[1], offset[0])
    lead = se2.wrap(bearing - goal[2] - face[2])
    # The arc to the goal starts at the bearing plus the lead; beside or past the goal only the yaw is left to mend.
    ahead = abs(lead) < np.pi / 2
    wanted = xp.where(ahead, bearing + xp.clip(lead, -0.6, 0.6), goal[2] + face[2])
    distance = xp.hypot(offset[0], offset[1])
    curvature = xp.where(ahead, -2.0 * xp.sin(lead) / xp.maximum(distance, 0.3), 0.0)
    # What the arc turns is wanted beforehand; the error alone would always lag behind it.
    error = se2.wrap(pose[2] + face[2] - wanted) - _AHEAD * curvature
    sideways = _sideways(face, obs, error)
    velocity = se2.rotate(obs.robot_twist[:2], -obs.robot_pose[2])
    lean = velocity_to_lean(Gains(), velocity, obs.lean_rate, xp.stack([0.0 * sideways, sideways]))
    limit = allowed_speed(cost, distance)
    forward, more = forward_lean(
        GovernorConfig(), obs.robot_pose, obs.robot_twist, obs.lean_rate, obs.wrench, limit, more
    )
    forward = xp.clip(forward, -LEAN_LIMIT, LEAN_LIMIT)
    return xp.stack([forward, lean[1], xp.clip(_STEER * error, -_STEER_LIMIT, _STEER_LIMIT)]), more


def _sideways(face: Array, obs: ObjectObservation, error: Scalar) -> Scalar:
    """Speed along the face [m/s] that brings the hands to where they turn the object against ``error`` [rad]."""
    xp = se2.array_module(obs.robot_pose, error)
    in_face = se2.relative(se2.compose(obs.object_pose, face[:3]), obs.robot_pose)
    hands = in_face[1] + REACH * xp.sin(in_face[2])
    # Pushing right of the centre turns the object left.
    room = xp.maximum(face[3] - 0.18, 0.0)
    return xp.clip(_CENTRE * (xp.clip(_SHIFT * error, -room, room) - hands), -0.1, 0.1)
