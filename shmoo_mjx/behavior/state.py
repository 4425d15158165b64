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
"""Displacement of an object above which a push counts as having moved it [m]. Its sides are then in new places."""
_PRICES = {"when quicker": None, "always": 1e4, "never": 0.0}
"""Assumed cost of pushing an object aside [s], where the estimate of the object does not determine it."""


class Mode(StrEnum):
    """Modes of the navigator."""

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
    """Settings of the navigator, SI units."""

    goal_tolerance: float = 0.15
    """Distance at which the goal counts as reached [m]. The scenario's own tolerance may be larger. Smaller values take
    longer."""
    planning_time: float = 0.0
    """Simulated computing time of a planning stage or a global path [s]. The robot continues its action meanwhile.
    Larger values make decisions older when they take effect."""
    latency: float = 0.0
    """Time from an observation to the effect of its command [s]. The robot's motion is predicted over this time. Larger
    values make the prediction less accurate."""
    decides_by: Literal["time", "K"] = "time"
    """Decision rule for an object in the path. "time" compares the expected time of each option, by roll-outs of the
    learned dynamics. "K" is Algorithm 1 of the paper: it pushes the object, and takes a detour if K says that it cannot
    be moved."""
    goes_round: Literal["when quicker", "always", "never"] = "when quicker"
    """When a detour is taken, for decisions by expected time: if it takes less time than a push, whenever there is one,
    or never. The last two are baselines."""
    planner: ObjectPlannerConfig = ObjectPlannerConfig()
    """Settings of Algorithm 1."""
    trajectory: TrajectoryConfig = TrajectoryConfig(robot_radius=0.27)
    """Settings of the local trajectories."""


class Transition(NamedTuple):
    """A mode switch."""

    t: float
    """Time [s]."""
    source: Mode
    """Mode before."""
    target: Mode
    """Mode after."""
    reason: str
    """Reason for the switch, as text."""


class Option(NamedTuple):
    """One option that a decision compares: a push from a side, or the detour."""

    text: str
    """Description of the option."""
    works: float
    """Expected time to the robot's goal if the option works [s]."""
    seconds: float
    """Expected time to the robot's goal, failures and their consequences included [s]. Without a detour it contains the
    assumed cost of giving up."""
    probability: float
    """Probability that the option works."""


class Decision(NamedTuple):
    """A decision about an object, with the evidence for it."""

    t: float
    """Time [s]."""
    object: int
    """Index of the object."""
    K: float
    """Criterion K of Algorithm 1 [m^2]; NaN if expected times decide."""
    G: float
    """Criterion G of Algorithm 1 [m]; NaN if expected times decide."""
    manipulable: bool
    """Whether the object counts as movable or, before a push by expected times, whether a push is best."""
    goal: Float[np.ndarray, "3"] | None
    """Target pose of the object in {W}, if any."""
    reason: str
    """Reason for the decision, as text."""
    rollouts: Float[np.ndarray, "R T 2"]
    """Predicted object positions, best first."""
    candidates: Float[np.ndarray, "C 3"]
    """Candidate target poses in {W}."""
    probability: float | None
    """Probability that the best option frees the path; None if K decides."""
    options: tuple[Option, ...] = ()
    """The options that were compared, pushes before the detour; empty if K decides."""


class Note(NamedTuple):
    """An event that the robot observes but does not cause."""

    t: float
    """Time [s]."""
    text: str
    """Description of the observation."""


class Planned(NamedTuple):
    """A global path that the robot follows, or that a decision is based on."""

    t: float
    """Time [s]."""
    points: Float[np.ndarray, "N 2"]
    """Vertices in {W} [m]."""


Event = Transition | Decision | Note | Planned


@dataclass(frozen=True, eq=False)
class Segment:
    """Data of one push, from the choice of a face to the retreat."""

    object: int
    """Index of the object."""
    side: int
    """Index of the face in `ObjectBelief.faces`."""
    face: Float[np.ndarray, "4"]
    """The face itself, as `faces_of` and `corners_of` return it."""
    goal: Float[np.ndarray, "3"]
    """Target pose of the object in {W}."""
    way: Path
    """Path to the stand-off pose."""
    approach: ApproachState
    """State of the approach."""
    clearance: LocalDistanceField
    """Distance to obstacles near the object, without the object itself."""
    contact: ContactState | None = None
    """State of making contact; None before."""
    push: PushState | None = None
    """State of the push; None before."""
    back: Path | None = None
    """Path away from the object after the push."""
    reviewed: float = 0.0
    """Contact time at the last planning stage [s]."""


@dataclass(frozen=True, eq=False)
class NavigatorState:
    """Complete state of the navigator. It is immutable; every step makes a new one."""

    goal: Float[np.ndarray, "2"]
    """Goal position in {W} [m]."""
    belief: Belief
    """The map and the known objects."""
    key: Key[Array, ""]
    """Random key of the pushing controller."""
    mode: Mode = Mode.REPLAN
    """The current mode."""
    since: float = 0.0
    """Time at which the mode began [s]."""
    path: Path | None = None
    """The global path, if there is one."""
    waits_from: float | None = None
    """Time since which no path to the goal has been available [s]."""
    segment: Segment | None = None
    """The current push, if there is one."""
    drive: drive.DriveState = field(default_factory=drive.init)
    """The local trajectory."""
    lean_offset: equilibrium_lean.LeanOffset = field(default_factory=equilibrium_lean.init)
    """Estimate of the lean at which the robot balances."""
    last_u: Float[np.ndarray, "3"] = field(default_factory=lambda: np.zeros(3))
    """Command of the last sample [rad]."""
    last_obs: Observation | None = None
    """Observation of the last sample."""
    pending: Pending | None = None
    """A decision that has not taken effect yet."""
    events: tuple[Event, ...] = ()
    """Events of the current step."""

    def go(self, now: float, target: Mode, reason: str) -> NavigatorState:
        """The state in mode ``target``, with an event that gives the reason."""
        event = Transition(now, self.mode, target, reason)
        return replace(self, mode=target, since=now, events=(*self.events, event))

    def with_events(self, *events: Event) -> NavigatorState:
        """The state with ``events`` appended."""
        return replace(self, events=(*self.events, *events))

    def target(self) -> ObjectBelief:
        """The object of the current segment."""
        return self.belief.objects[self.current().object]

    def current(self) -> Segment:
        """The current segment. Only valid in modes that deal with an object."""
        assert self.segment is not None, f"{self.mode} needs an object"
        return self.segment

    def with_segment(self, **changes: Any) -> NavigatorState:
        """The state with these fields of the segment changed."""
        return replace(self, segment=replace(self.current(), **changes))

    def with_object(self, index: int, **changes: Any) -> NavigatorState:
        """The state with these fields of object ``index`` changed."""
        return replace(self, belief=self.belief.with_object(index, **changes))

    def failed(self) -> NavigatorState:
        """The state after a push that has not freed the path.

        If the push has hardly moved the object, the face is added to its failed faces.
        """
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
    """A decision that is being computed while the robot continues."""

    due: float
    """Time at which the decision takes effect [s]."""
    before: NavigatorState
    """State that the decision is based on."""
    decided: NavigatorState
    """That state after the decision."""

    def applied_to(self, current: NavigatorState, now: float) -> NavigatorState:
        """The ``current`` state with the changes of the decision: to the state, to its segment and to each object."""
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
    """The ``current`` value with those fields that the decision changed between ``before`` and ``decided``."""
    names = [field.name for field in fields(before)]
    changes = {name: getattr(decided, name) for name in names if getattr(decided, name) is not getattr(before, name)}
    return replace(current, **changes)


class Setup(NamedTuple):
    """Constant parts of a navigator."""

    sizes: Sequence[tuple[float, float]]
    """Half extents of each object [m]."""
    controller: Pusher
    """The :class:`~shmoo_mjx.control.pushing.PushController`, or a baseline."""
    config: NavigatorConfig
    """Settings."""
    trajectories: Planner
    """Precomputed data of the local trajectories."""
    first_status: Sequence[Status] | None = None
    """Initial status of each object; UNKNOWN if not given."""
    kinds: Sequence[str | None] | None = None
    """Recognised kind of each object: "box", "cart", "wheelchair", or None for other objects. All None if not given."""

    @property
    def by_time(self) -> bool:
        """Whether expected times decide."""
        return self.config.decides_by == "time"

    def routes(self, state: NavigatorState) -> Routes:
        """Path queries on the current belief."""
        if not self.by_time:
            return Routes(state.belief, state.goal, (Status.UNKNOWN,), 0.0)
        return Routes(state.belief, state.goal, price=_PRICES[self.config.goes_round])
