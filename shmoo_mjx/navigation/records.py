"""What the navigator is set to, what it remembers of a push, and what it writes down."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum
from typing import NamedTuple

import numpy as np

from shmoo_mjx.control.pushing import LocalField, PushState
from shmoo_mjx.navigation import drive
from shmoo_mjx.navigation.flat_trajectory import TrajectoryConfig
from shmoo_mjx.navigation.object_planner import ObjectPlannerConfig
from shmoo_mjx.navigation.paths import Path
from shmoo_mjx.navigation.scenario import ROBOT_RADIUS

__all__ = ["Approach", "Decision", "Mode", "NavigatorConfig", "Push", "Transition"]


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

    robot_radius: float = ROBOT_RADIUS
    """Radius of the disc that paths keep clear: body, folded hands and a reserve."""
    sensing_range: float = 3.5
    goal_tolerance: float = 0.15
    """Distance at which the goal counts as reached; the scenario's own tolerance may be wider."""
    act_within: float = 2.2
    """An object in the way is dealt with once the path's blocked point is this near."""
    detour: float = 1.5
    """A way round that is at most this much longer is taken rather than a push."""
    passing: float = 0.3
    """A pushed object is out of the way once passing it makes the path at most this much longer."""
    probe_room: float = 0.03
    """How far the probe's lean may stay below what the governor grants, while the object has not moved yet [rad]: a
    verdict on what was only touched gently would be worth little. 1 leaves the lean to the plan."""
    contact_gap: float = 0.12
    """Distance between hands and face at the stand-off pose."""
    contact_speed: float = 0.12
    """Speed at which contact is made."""
    contact_force: float = 5.0
    """Force on the hands at which contact counts as made [N]: above what a grazing hand gives."""
    contact_shift: float = 0.03
    """An object near the hands that has moved this far is touched, however little it resists [m]."""
    at_goal: float = 0.10
    """Distance from its goal at which an object has arrived."""
    probe_time: float = 1.0
    """Contact time before the planning stage (Algorithm 1)."""
    doubt_time: float = 3.0
    """Contact time before K is believed: in the first second the lean still grows, and friction that holds against that
    says little about a firm push. What has ``rolled`` needs no more time to count as manipulable."""
    doubt_limit: float = 6.0
    """... while the object gives way under the push."""
    doubt_every: float = 0.5
    """Contact time between two planning stages until then."""
    gives_way: float = 0.02
    """Way of the object's corners in the last second of contact from which it gives way [m]."""
    probe_limit: float = 2.5
    """Time since the first contact at which the planning stage comes, however short the contacts were, for ..."""
    rolled: float = 0.10
    """... an object that has moved this far meanwhile: a cart rolls ahead of the hands after a short touch."""
    review_every: float = 2.0
    """Contact time between two planning stages of one push."""
    stall_distance: float = 0.05
    """An object that moved less than this ..."""
    stall_time: float = 5.0
    """... in this much contact time has stalled."""
    moved: float = 0.3
    """An object that a push has moved this far is not immovable, whatever holds it now: a wall, say."""
    push_limit: float = 45.0
    """Longest push."""
    lost_after: float = 1.5
    """Time without contact after which contact counts as lost."""
    max_pushes: int = 4
    """Pushes of one object before it is registered as an obstacle."""
    blind_limit: float = 1.5
    """A push ends when the object has not been detected for this long."""
    goes_round: bool = True
    """False: every object in the way is pushed, none is ever registered or gone round. For comparison."""
    second_chance: bool = True
    """Try each registered object once more before giving up."""
    retreat: float = 0.05
    """Distance between the extended hands' place and the face at which a retreat stops and the arms fold."""
    withdraw: float = 0.12
    """How far the hands draw back as soon as a push ends [m]."""
    path_margin: float = 0.05
    """What must be free beside the robot's radius between the path and a pushed object."""
    wall_margin: float = 0.05
    """What must be free between walls and a pushed object's goal."""
    far_area: float = 5.0
    """Side of the square in which first goals are sought where the planner's own holds none [m]."""
    other_paths: int = 12
    """Goals for which another path is sought when none leaves the path free."""
    planner: ObjectPlannerConfig = ObjectPlannerConfig(min_displacement=0.6)
    trajectory: TrajectoryConfig = TrajectoryConfig(robot_radius=0.24)
    drive: drive.DriveConfig = drive.DriveConfig()


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
    goal: np.ndarray | None
    reason: str
    rollouts: np.ndarray
    """``[R, T, 2]`` predicted object positions, best first."""
    candidates: np.ndarray
    """``[C, 3]``"""
    asked: np.ndarray
    """``[3]`` where the roll-outs were to bring the object, in {W}."""


@dataclass
class Approach:
    """Memory of one approach to a face."""

    path: Path
    """Way to the stand-off pose."""
    started: float
    """[s]"""
    extended_at: float | None = None
    """When the arms were told to extend [s]."""
    touched_from: np.ndarray | None = None
    """Pose of the object when the hands began to feel for it."""
    drive: drive.DriveState = field(default_factory=drive.init)


@dataclass
class Push:
    """Memory of dealing with one object."""

    object: int
    side: int
    """Index of the face among ``faces_of``."""
    face: np.ndarray
    goal: np.ndarray
    approach: Approach
    around: LocalField
    state: PushState | None = None
    contact_time: float = 0.0
    since_contact: float = 0.0
    reviewed_at: float = 0.0
    """Contact time of the last planning stage."""
    started: float = 0.0
    """When contact was made [s]."""
    blind: bool = False
    """Was the object's pose a guess in the last sample."""
    marks: list[tuple[float, np.ndarray]] = field(default_factory=list)
    """(contact time, object pose) once a sample."""
