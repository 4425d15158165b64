"""Settings, state and events of the navigator."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import Any, Literal, NamedTuple

import numpy as np

from shmoo_mjx.arrays import Array, Float, Key
from shmoo_mjx.control import equilibrium_lean
from shmoo_mjx.control.observation import LocalDistanceField
from shmoo_mjx.navigation import drive
from shmoo_mjx.navigation.belief import Belief, KnownObject, Status
from shmoo_mjx.navigation.flat_qp import Planner, TrajectoryConfig
from shmoo_mjx.navigation.object_planner import ObjectPlannerConfig
from shmoo_mjx.navigation.paths import Path
from shmoo_mjx.navigation.routes import Routes
from shmoo_mjx.planning.reach import Foresight, foresight_of
from shmoo_mjx.skills.approach import ApproachState
from shmoo_mjx.skills.contact import ContactState
from shmoo_mjx.skills.push import PushState
from shmoo_mjx.types import Observation

_DETOUR = 9.0
"""Extra length up to which a way round is taken where nothing foresees what a push would lead to [m]: it takes some
15 s, in which the robot walks twice as far."""


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
    detour: float | None = None
    """Extra length up to which a way round is taken rather than a push [m]; more makes for fewer pushes. None leaves it
    to the expected time, or takes 9 m where that does not decide."""
    decides_by: Literal["time", "mobility", "K"] = "time"
    """What decides about an object: the expected time of each option, by roll-outs of what was learned of it (of a
    pushing controller with a learned model); how far it has come for what the hands have spent on it; or K of its first
    planning stage, as in the paper."""
    sure: float = 0.95
    """Probability [1] from which a verdict by mobility falls before ``decide_after``; nearer to 1 it is later, and more
    often right."""
    decide_after: float = 3.0
    """Contact time after which a verdict falls whatever its probability [s]; later it is more often right."""
    max_pushes: int = 4
    """Pushes of one object before it is registered as an obstacle; more try longer."""
    goes_round: bool = True
    """False: every object in the way is pushed, none is ever registered or gone round. For comparison."""
    chances: int = 3
    """How often each registered object is tried again where every route is blocked; more gets through more often, and
    gives up later."""
    planner: ObjectPlannerConfig = ObjectPlannerConfig()
    trajectory: TrajectoryConfig = TrajectoryConfig(robot_radius=0.27)


class Transition(NamedTuple):
    """A change of state."""

    t: float
    source: Mode
    target: Mode
    reason: str


class Decision(NamedTuple):
    """One planning stage of the object planner, with its evidence."""

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
    asked: Float[np.ndarray, "3"]
    """Where the roll-outs were to bring the object, in {W}."""
    probability: float
    """That the object can be moved, by what the push has shown so far."""


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
    """Index of the face among ``faces_of``, and after them ``corners_of``."""
    face: Float[np.ndarray, "4"]
    goal: Float[np.ndarray, "3"]
    """Pose in {W} to bring the object to."""
    way: Path
    """To the stand-off pose."""
    approach: ApproachState
    around: LocalDistanceField
    detour: float
    """How much longer the way round is than the path through the object [m]; infinite where there is none."""
    contact: ContactState | None = None
    push: PushState | None = None
    back: Path | None = None
    """Away from the object, once the push is over."""
    reviewed: float = 0.0
    """Contact time at the last planning stage [s]."""
    straight_from: float | None = None
    """Since when the object has been pushed straight ahead, wherever it was to go before it stuck [s]."""


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
    gone_round: frozenset[int] = frozenset()
    """Objects that the path has been led round since the last plan."""
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

    def known(self) -> KnownObject:
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


@dataclass(frozen=True, eq=False)
class Pending:
    """A decision that is being computed while the robot goes on."""

    due: float
    """When it will be known [s]."""
    asked: NavigatorState
    decided: NavigatorState


class Setup(NamedTuple):
    """Constant parts of a navigator."""

    sizes: Sequence[tuple[float, float]]
    """Half extents of each object [m]."""
    controller: Any
    """The :class:`~shmoo_mjx.control.pushing.PushController`."""
    config: NavigatorConfig
    trajectories: Planner
    first_status: Sequence[Status] | None = None
    """What each object is taken to be at first sight; UNKNOWN if not given."""
    kinds: Sequence[str | None] | None = None
    """What each object looks like: "box", "cart", "wheelchair", or None for none of them, as all are if not given."""

    @property
    def foresight(self) -> Foresight | None:
        """What foresees outcomes where expected times decide; None where they do not."""
        return foresight_of(self.controller) if self.config.decides_by == "time" else None

    @property
    def detour(self) -> float:
        """Extra length up to which a way round is taken whatever a push may promise [m]."""
        if self.config.detour is not None:
            return self.config.detour
        return 0.0 if self.foresight else _DETOUR

    def routes(self, state: NavigatorState) -> Routes:
        """Path queries on the present belief."""
        return Routes(state.belief, state.goal)
