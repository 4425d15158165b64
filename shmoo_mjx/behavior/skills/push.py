"""Push: a controller moves the object towards a goal; forces and motion are recorded for the decisions on it."""

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
"""An object is let go where it is expected to stop this far before its goal [m]: hands relax by about that much."""
_WITHIN = 0.3
"""Largest distance from the goal at which an object is let go [m]: after that it can't be steered."""


@runtime_checkable
class Pusher(Protocol):
    """Interface of pushing controllers: :class:`~shmoo_mjx.control.pushing.PushController`, or something to compare it
    with.

    Its state is a NamedTuple of its own with a field ``adapt``: what has been learned of the object.
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
        """Start a push; ``kind`` is what the object looks like, "box", "cart" or "wheelchair", None for none of
        them."""

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
        """One 10 Hz step."""

    def coast(self, state: Any) -> Float[np.ndarray, "3"]:
        """Where the object comes to rest if it is let go now."""


@runtime_checkable
class RolloutPlanner(Protocol):
    """What plans by roll-outs of its model, as Algorithm 1 asks for."""

    def planning_rollouts(
        self, state: Any, goal: Float[Array, "3"], clearance: LocalDistanceField, half_extents: Float[Array, "2"]
    ) -> tuple[Float[np.ndarray, "S T 3"], Float[np.ndarray, "S T 2"], Float[np.ndarray, "S"]]:
        """Object poses and robot positions in {W}, and costs, of roll-outs towards ``goal``."""


@dataclass(frozen=True, eq=False)
class PushState:
    """State of one push."""

    pusher: Any
    """The pusher's own."""
    started: float
    """[s]"""
    contact_time: float = 0.0
    """Time in contact so far [s]."""
    since_contact: float = 0.0
    """Time since the hands last touched the object [s]."""
    impulse: float = 0.0
    """What the hands have spent on the object so far [N s]."""
    poses: tuple[Float[np.ndarray, "3"], ...] = ()
    """Of the object in {W}, one of each sample."""
    coasts: Float[Array, "5"] = field(default_factory=lambda: np.zeros(5))
    """How far it would coast along the push, in the last samples [m]; for who lets go in time (:func:`lets_go`)."""
    ok: bool = True
    """Whether the last plan had a finite roll-out."""

    def moved(self, pose: Float[np.ndarray, "3"]) -> float:
        """Displacement of the object since the push began [m]."""
        start = self.poses[0] if self.poses else pose
        return float(np.linalg.norm(pose[:2] - start[:2]))

    def travelled(self, seconds: float) -> float | None:
        """How far the object has come in the last ``seconds`` of the push [m]; None if it is younger. Twice the way
        between the means of both halves, so that neither noise nor a jammed object's rocking counts. Contact does
        not count either: what the pusher dares touch no more is as stuck as what does not move."""
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
    """A push on ``face`` that starts at ``time`` [s]. Its first step comes a sample later: a pusher that was
    stepped with the very observation it began with would take the object to have been pushed and not moved."""
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
    """One sample: adapt, plan, and give the command; stand still if no roll-out of the model is finite.

    Args:
        pusher: what pushes.
        state: from :func:`init` or the last step.
        obs: robot and object, with the wrench of the sample that ended.
        face: that is pushed.
        last_u: what was applied during that sample.
        goal: pose of the object in {W}.
        clearance: distance to obstacles near the object; None for a pusher that does not ask.
        half_extents: of the object's footprint [m].
        governor_room: in place of the pusher's own, for this step.
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
    """Release criterion: whether an object that is let go now coasts into its goal; pure, NumPy and JAX alike.

    Args:
        rest: where the object comes to rest if it is let go now, in {W}.
        coasts: how far it would have coasted along the push in the last samples [m]; a single one is noisy.
        object_pose: now.
        face: that is pushed.
        goal: in {W}.

    Returns:
        The coasting distances with this one, the way left along the push [m], and whether to let go.
    """
    xp = se2.array_module(rest, object_pose)
    ahead = heading(object_pose, face)
    normal = xp.stack([xp.cos(ahead), xp.sin(ahead)])
    left = (goal[:2] - object_pose[:2]) @ normal
    coasts = xp.concatenate([coasts[1:], ((rest[:2] - object_pose[:2]) @ normal)[None]])
    return coasts, left, (left - xp.median(coasts) < _LEAD) & (left < _WITHIN)
