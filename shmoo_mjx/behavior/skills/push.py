"""Push: a controller moves the object towards a goal. Forces and motion are recorded for decisions."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any, Protocol, runtime_checkable

import numpy as np

from shmoo_mjx.arrays import Array, Bool, Float, Key, Scalar
from shmoo_mjx.behavior.skills.settings import hold
from shmoo_mjx.control.mppi import Plan
from shmoo_mjx.control.observation import LocalDistanceField, ObjectObservation
from shmoo_mjx.geometry import se2
from shmoo_mjx.geometry.faces import heading
from shmoo_mjx.geometry.hands import HAND_HEIGHT, REACH, touches
from shmoo_mjx.learning.online import LearnerState
from shmoo_mjx.types import DT, Command

_LEAD = 0.015
"""An object is released when it is expected to stop this far before its goal [m], because the relaxing hands move it by
about this much."""
_WITHIN = 0.3
"""Maximum distance from the goal at which an object is released [m]. Afterwards it cannot be steered."""


@runtime_checkable
class Pusher(Protocol):
    """Interface of pushing controllers: :class:`~shmoo_mjx.control.pushing.PushController`, or a baseline.

    The state is a NamedTuple with a field ``adapt``: the learner state of the object.
    """

    def init(
        self,
        obs: ObjectObservation,
        face: Float[Array, "4"],
        half_extents: Float[Array, "2"],
        key: Key[Array, ""],
        *,
        adapt: LearnerState | None = None,
        kind: str | None = None,
    ) -> Any:
        """Starts a push. ``kind`` is the recognised kind: "box", "cart" or "wheelchair"; None for other objects."""

    def step(
        self,
        state: Any,
        obs: ObjectObservation,
        *,
        goal: Float[Array, "3"],
        last_u: Float[Array, "3"],
        half_extents: Float[Array, "2"],
        clearance: LocalDistanceField,
    ) -> tuple[Float[np.ndarray, "3"], Any, Plan | None]:
        """One 10 Hz step: the command u, the next state, and the plan, if any."""

    def coast(self, state: Any) -> Float[np.ndarray, "3"]:
        """Pose at which the object comes to rest if it is released now."""


@runtime_checkable
class RolloutPlanner(Protocol):
    """A controller that can plan by roll-outs of its model, as Algorithm 1 requires."""

    def planning_rollouts(
        self, state: Any, goal: Float[Array, "3"], clearance: LocalDistanceField, half_extents: Float[Array, "2"]
    ) -> tuple[Float[np.ndarray, "S T 3"], Float[np.ndarray, "S T 2"], Float[np.ndarray, "S"]]:
        """Object poses and robot positions in {W}, and costs, of roll-outs towards ``goal``."""


@dataclass(frozen=True, eq=False)
class PushState:
    """State of one push."""

    pusher: Any
    """State of the pusher."""
    started: float
    """Start time [s]."""
    contact_time: float = 0.0
    """Time in contact so far [s]."""
    since_contact: float = 0.0
    """Time since the hands last touched the object [s]."""
    impulse: float = 0.0
    """Impulse of the hands on the object so far [N s]."""
    poses: tuple[Float[np.ndarray, "3"], ...] = ()
    """Pose of the object in {W} at each sample."""
    coasts: Float[Array, "5"] = field(default_factory=lambda: np.zeros(5))
    """Predicted coasting distances along the push in the last samples [m], for :func:`lets_go`."""
    ok: bool = True
    """Whether the last plan had a finite roll-out."""

    def moved(self, pose: Float[np.ndarray, "3"]) -> float:
        """Displacement of the object since the push began [m]."""
        start = self.poses[0] if self.poses else pose
        return float(np.linalg.norm(pose[:2] - start[:2]))

    def travelled(self, seconds: float) -> float | None:
        """Distance that the object moved in the last ``seconds`` of the push [m]; None if the push is shorter.

        It is twice the distance between the mean positions of both halves of this time, so that noise and the rocking
        of a jammed object do not count. Contact does not matter: an object that the pusher no longer touches is stuck
        as well.
        """
        half = round(seconds / DT / 2)
        if len(self.poses) < 2 * half:
            return None
        recent = np.array(self.poses)[-2 * half :, :2]
        return 2.0 * float(np.linalg.norm(recent[half:].mean(axis=0) - recent[:half].mean(axis=0)))


def init(
    pusher: Any,
    time: float,
    obs: ObjectObservation,
    face: Float[Array, "4"],
    *,
    half_extents: tuple[float, float] | Float[Array, "2"],
    key: Key[Array, ""] | None,
    adapt: LearnerState | None,
    kind: str | None = None,
) -> PushState:
    """A push on ``face`` that starts at ``time`` [s].

    Its first step must use the next sample. With the same observation twice, a pusher would infer that the object was
    pushed and did not move.
    """
    return PushState(pusher.init(obs, face, np.asarray(half_extents), key, adapt=adapt, kind=kind), time)


def step(
    pusher: Any,
    state: PushState,
    obs: ObjectObservation,
    face: Float[Array, "4"],
    *,
    last_u: Float[Array, "3"],
    goal: Float[Array, "3"],
    clearance: LocalDistanceField | None,
    half_extents: tuple[float, float] | Float[Array, "2"],
    governor_room: float | None = None,
) -> tuple[PushState, Command]:
    """One sample: adapts, plans, and returns the command. The robot stands still if no roll-out of the model is finite.

    Args:
        pusher: the pushing controller.
        state: from :func:`init` or the last step.
        obs: robot and object, with the wrench of the sample that ended.
        face: the face to push on.
        last_u: command during that sample.
        goal: target pose of the object in {W}.
        clearance: distance to obstacles near the object; None for a pusher that does not use it.
        half_extents: half sizes of the object's footprint [m].
        governor_room: replaces the pusher's own value in this step.
    """
    options = {} if governor_room is None else {"governor_room": governor_room}
    half = np.asarray(half_extents)
    u, own, plan = pusher.step(
        state.pusher, obs, goal=goal, last_u=last_u, half_extents=half, clearance=clearance, **options
    )
    touching = bool(touches(obs.wrench))
    ok = (plan is None or bool(plan.ok)) and bool(np.isfinite(u).all())
    state = replace(
        state,
        pusher=own,
        contact_time=state.contact_time + (DT if touching else 0.0),
        since_contact=0.0 if touching else state.since_contact + DT,
        impulse=state.impulse + (float(np.hypot(*obs.wrench[:2])) * DT if touching else 0.0),
        poses=(*state.poses, np.array(obs.object_pose)),
        ok=ok,
    )
    command = Command(np.asarray(u), heading(obs.object_pose, face), REACH, HAND_HEIGHT)
    return state, command if ok else hold(obs, extended=True)


def lets_go(
    rest: Float[Array, "3"],
    coasts: Float[Array, "5"],
    *,
    object_pose: Float[Array, "3"],
    face: Float[Array, "4"],
    goal: Float[Array, "3"],
) -> tuple[Float[Array, "5"], Scalar, np.bool | Bool[Array, ""]]:
    """Release criterion: whether an object that is released now coasts to its goal. Pure; takes NumPy or JAX arrays.

    Args:
        rest: pose in {W} at which the object comes to rest if it is released now.
        coasts: predicted coasting distances along the push in the last samples [m]; a single one is noisy.
        object_pose: current pose in {W}.
        face: the pushed face.
        goal: target pose in {W}.

    Returns:
        The coasting distances including this one, the remaining distance along the push [m], and whether to release.
    """
    xp = se2.array_module(rest, object_pose)
    ahead = heading(object_pose, face)
    normal = xp.stack([xp.cos(ahead), xp.sin(ahead)])
    left = (goal[:2] - object_pose[:2]) @ normal
    coasts = xp.concatenate([coasts[1:], ((rest[:2] - object_pose[:2]) @ normal)[None]])
    return coasts, left, (left - xp.median(coasts) < _LEAD) & (left < _WITHIN)
