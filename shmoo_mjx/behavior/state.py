"""Settings, state and events of the navigator."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from enum import StrEnum
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np

from shmoo_mjx.arrays import Array, Float, Key
from shmoo_mjx.behavior import drive
from shmoo_mjx.behavior.belief import Belief, ObjectBelief, Status
from shmoo_mjx.behavior.routes import Routes
from shmoo_mjx.behavior.skills.approach import ApproachState
from shmoo_mjx.behavior.skills.contact import ContactState
from shmoo_mjx.behavior.skills.push import Pusher, PushState
from shmoo_mjx.control import equilibrium_lean
from shmoo_mjx.control.observation import LocalDistanceField
from shmoo_mjx.planning.flat_qp import Planner, TrajectoryConfig
from shmoo_mjx.planning.object_planner import ObjectPlannerConfig
from shmoo_mjx.planning.paths import Path
from shmoo_mjx.types import Observation

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

_MOVED = 0.3
"""After a push that has moved an object this far its sides are others than before [m]."""
_PRICES = {"when quicker": None, "always": 1e4, "never": 0.0}
"""What it is taken to cost to push an object aside, where that does not come from what is known of it [s]."""


class Mode(StrEnum):
    """States of the navigator."""

    FOLLOW = "follow path"
    APPROACH = "approach"
    CONTACT = "make contact"
    PROBE = "probe"
    PUSH = "push"
    RETREAT = "retreat"
    REPLAN = "replan"
    DONE = "done"
    FAILED = "failed"


@dataclass(frozen=True)
class NavigatorConfig:
    """Settings of the state machine, SI units."""

    goal_tolerance: float = 0.15
    """Distance at which the goal counts as reached [m]; the scenario's own may be wider. Less takes longer."""
    planning_time: float = 0.0
    """Time that a planning stage or a global path takes to compute [s]; the robot goes on as it did meanwhile, and
    what it decides is the older for it."""
    latency: float = 0.0
    """Time from what a command answers to its effect [s]; the robot's motion is foreseen for so long, the less exactly
    the longer."""
    decides_by: Literal["time", "K"] = "time"
    """What decides about an object: the expected time of each option, by roll-outs of what was learned of it; or
    Algorithm 1 of the paper, which pushes whatever is in the way and goes round where K says that it can't be moved."""
    goes_round: Literal["when quicker", "always", "never"] = "when quicker"
    """Whether a way round is taken, where expected times decide: where it takes less time than a push, wherever there
    is one, or never. The last two are for comparison."""
    planner: ObjectPlannerConfig = ObjectPlannerConfig()
    trajectory: TrajectoryConfig = TrajectoryConfig(robot_radius=0.27)


class Transition(NamedTuple):
    """A change of state."""

    t: float
    source: Mode
    target: Mode
    reason: str


class Decision(NamedTuple):
    """What to do about an object, with the evidence."""

    t: float
    object: int
    K: float
    G: float
    manipulable: bool
    goal: Float[np.ndarray, "3"] | None
    reason: str
    rollouts: Float[np.ndarray, "R T 2"]
    """Predicted object positions, best first."""
    candidates: Float[np.ndarray, "C 3"]
    probability: float | None
    """That a push frees the path, of the best option; None where K decides."""


class Note(NamedTuple):
    """Something that the robot noticed without having done it."""

    t: float
    text: str


class Planned(NamedTuple):
    """A global path that was taken, or on which a decision rests."""

    t: float
    points: Float[np.ndarray, "N 2"]
    """In {W} [m]."""


Event = Transition | Decision | Note | Planned


@dataclass(frozen=True, eq=False)
class Segment:
    """Everything about one push, from the choice of a face to the retreat."""

    object: int
    side: int
    """Index of the face among `ObjectBelief.faces`."""
    face: Float[np.ndarray, "4"]
    goal: Float[np.ndarray, "3"]
    """Pose in {W} to bring the object to."""
    way: Path
    """To the stand-off pose."""
    approach: ApproachState
    clearance: LocalDistanceField
    contact: ContactState | None = None
    push: PushState | None = None
    back: Path | None = None
    """Away from the object, once the push is over."""
    reviewed: float = 0.0
    """Contact time at the last planning stage [s]."""


@dataclass(frozen=True, eq=False)
class NavigatorState:
    """Complete state of the navigator; every step makes a new one."""

    goal: Float[np.ndarray, "2"]
    """In {W} [m]."""
    belief: Belief
    key: Key[Array, ""]
    mode: Mode = Mode.REPLAN
    since: float = 0.0
    """When the mode began [s]."""
    path: Path | None = None
    waits_from: float | None = None
    """Since when no way to the goal has been known [s]."""
    segment: Segment | None = None
    drive: drive.DriveState = field(default_factory=drive.init)
    lean_offset: equilibrium_lean.LeanOffset = field(default_factory=equilibrium_lean.init)
    last_u: Float[np.ndarray, "3"] = field(default_factory=lambda: np.zeros(3))
    last_obs: Observation | None = None
    pending: Pending | None = None
    events: tuple[Event, ...] = ()
    """Of the present step."""

    def go(self, now: float, target: Mode, reason: str) -> NavigatorState:
        """The state in mode ``target``, with the event that says why."""
        event = Transition(now, self.mode, target, reason)
        return replace(self, mode=target, since=now, events=(*self.events, event))

    def with_events(self, *events: Event) -> NavigatorState:
        """The state with more events."""
        return replace(self, events=(*self.events, *events))

    def target(self) -> ObjectBelief:
        """The object that is dealt with."""
        return self.belief.objects[self.current().object]

    def current(self) -> Segment:
        """Dealing with an object; only asked in modes that do."""
        assert self.segment is not None, f"{self.mode} needs an object"
        return self.segment

    def with_segment(self, **changes: Any) -> NavigatorState:
        """The state with these fields of the segment changed."""
        return replace(self, segment=replace(self.current(), **changes))

    def with_object(self, index: int, **changes: Any) -> NavigatorState:
        """The state with these fields of object ``index`` changed."""
        return replace(self, belief=self.belief.with_object(index, **changes))

    def failed(self) -> NavigatorState:
        """The state in which the push has not freed the way: one that has hardly moved the object counts against its
        side."""
        target, segment = self.target(), self.current()
        if segment.push is not None and segment.push.moved(target.pose) > _MOVED:
            return self
        return self.with_object(segment.object, failed_faces=(*target.failed_faces, segment.side))

    def given_up(self, index: int) -> NavigatorState:
        """The state in which object ``index`` is registered as an obstacle."""
        target, pushes = self.belief.objects[index], self.belief.pushes
        return self.with_object(index, status=Status.FIXED, registered=target.pose, given_up=pushes)


@dataclass(frozen=True, eq=False)
class Pending:
    """A decision that is being computed while the robot goes on."""

    due: float
    """When it will be known [s]."""
    before: NavigatorState
    """On which it rests."""
    decided: NavigatorState
    """The same with what is decided."""

    def applied_to(self, current: NavigatorState, now: float) -> NavigatorState:
        """The ``current`` state with what the decision changes: in the state, in its segment and in each object."""
        before, decided = self.before, self.decided
        objects = dict(current.belief.objects)
        for index, item in before.belief.objects.items():
            objects[index] = _with_changes(objects[index], item, decided.belief.objects[index])
        segment = decided.segment
        if segment is before.segment:
            segment = current.segment
        elif segment is not None and before.segment is not None and current.segment is not None:
            segment = _with_changes(current.segment, before.segment, segment)
        state = _with_changes(current, before, decided)
        return replace(
            state,
            belief=replace(current.belief, objects=objects),
            segment=segment,
            since=state.since if state.mode is current.mode else now,
            events=(*current.events, *(event._replace(t=now) for event in decided.events)),
            pending=None,
        )


def _with_changes[T: DataclassInstance](current: T, before: T, decided: T) -> T:
    """The ``current`` value with those fields that a decision has changed."""
    names = [field.name for field in fields(before)]
    changes = {name: getattr(decided, name) for name in names if getattr(decided, name) is not getattr(before, name)}
    return replace(current, **changes)


class Setup(NamedTuple):
    """Constant parts of a navigator."""

    sizes: Sequence[tuple[float, float]]
    """Half extents of each object [m]."""
    controller: Pusher
    """The :class:`~shmoo_mjx.control.pushing.PushController`, or what is compared with it."""
    config: NavigatorConfig
    trajectories: Planner
    first_status: Sequence[Status] | None = None
    """What each object is taken to be at first sight; UNKNOWN if not given."""
    kinds: Sequence[str | None] | None = None
    """What each object looks like: "box", "cart", "wheelchair", or None for none of them, as all are if not given."""

    @property
    def by_time(self) -> bool:
        """Whether expected times decide."""
        return self.config.decides_by == "time"

    def routes(self, state: NavigatorState) -> Routes:
        """Path queries on the present belief."""
        if not self.by_time:
            return Routes(state.belief, state.goal, (Status.UNKNOWN,), 0.0)
        return Routes(state.belief, state.goal, price=_PRICES[self.config.goes_round])
