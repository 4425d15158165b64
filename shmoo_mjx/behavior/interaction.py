"""The state machine for pushing an object: approach a face, make contact, push, retreat.

It consists of a frozen state, a table of modes, and events. ``step`` takes a state and an observation and returns the
next state, the command for the next sample, and the events. The navigator and the push task use different tables: they
decide differently before a push and end a push differently.

Each mode *acts* at 10 Hz. A computation that takes longer, such as a global path or a planning stage, is a *decision*:
it takes effect ``planning_time`` later, and until then the robot continues its action.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import jax
import numpy as np

from shmoo_mjx.arrays import Array, Float, Numbers, finite_numbers
from shmoo_mjx.behavior import drive
from shmoo_mjx.behavior.belief import Belief, Status
from shmoo_mjx.behavior.skills import approach, batched, contact, hold, push, retreat
from shmoo_mjx.behavior.skills.push import Pusher
from shmoo_mjx.behavior.state import (
    Decision,
    Event,
    Mode,
    NavigatorConfig,
    NavigatorState,
    Note,
    Pending,
    Planned,
    Segment,
    Setup,
    Transition,
)
from shmoo_mjx.control import equilibrium_lean
from shmoo_mjx.control.observation import ObjectObservation, local_distance_field
from shmoo_mjx.control.pushing import PushController
from shmoo_mjx.geometry.hands import HAND_HEIGHT, REACH, TUCKED_HEIGHT, TUCKED_REACH
from shmoo_mjx.learning import online
from shmoo_mjx.planning import flat_qp
from shmoo_mjx.planning.flat_model import FlatModel
from shmoo_mjx.planning.paths import Path, project
from shmoo_mjx.plant import outline
from shmoo_mjx.plant.robot import shmoobot
from shmoo_mjx.sensing import finite
from shmoo_mjx.types import Command, Observation

_UNDETECTED_LIMIT = 1.5
"""Time since the object's last detection at which a push ends [s]: a third of a metre at the permitted speed."""
_LOST_AFTER = 2.0
"""Time without contact after which contact counts as lost [s]. The hands need time to catch up with rolling objects."""
ROLLED = 0.10
"""Displacement during a probe above which an object is certainly movable [m]."""
_FOLDED = TUCKED_REACH + 0.06
"""Maximum reach of folded arms [m]."""
_PUSH_LIMIT = 45.0
"""Maximum duration of a push [s]: 11 m at the permitted speed during navigation, 7 m when pushing to a pose."""
_ARM_ROOM = 0.05
"""Distance from walls at which the arms may unfold or fold [m]. They swing slightly."""
_LONGEST_RETREAT = 6.0
"""Maximum duration of a retreat [s]."""
_LONGEST_CONTACT = 10.0
"""Maximum time to make contact [s]; usually it takes two. After it something else must be blocking the hands."""
PROBE_ROOM = 0.03
"""Maximum difference between the probe's lean and the governor's limit while the object has not moved [rad]. A weak
push says little about whether the object can be moved."""
Act = Callable[[Setup, NavigatorState, Observation], tuple[NavigatorState, Command]]
"""(setup, state, observation) -> next state and command for the next sample, of one world, unbatched."""
Judge = Callable[[Setup, NavigatorState, Observation], NavigatorState]
"""(setup, state, observation) -> the state, in which the push has ended if it must end."""


class Rule(NamedTuple):
    """Action and decision of a mode."""

    act: Act
    """The robot's action; it may switch the mode."""
    decide: Callable[[Setup, NavigatorState, Observation], NavigatorState | None]
    """The state after a decision that takes time to compute; None if none is due."""
    leads_to: tuple[Mode, ...]
    """Modes that may follow."""


def setup_of(
    sizes: Sequence[tuple[float, float]],
    controller: Pusher,
    config: NavigatorConfig | None = None,
    *,
    first_status: Sequence[Status] | None = None,
    kinds: Sequence[str | None] | None = None,
) -> Setup:
    """Constant parts of a state machine; see the fields of :class:`~shmoo_mjx.behavior.state.Setup`."""
    config = config or NavigatorConfig()
    planner = flat_qp.init(FlatModel(*shmoobot().flatness), config.trajectory)
    return Setup(sizes, controller, config, planner, first_status, kinds)


def step(
    modes: Mapping[Mode, Rule], setup: Setup, state: NavigatorState, obs: Observation
) -> tuple[NavigatorState, Command, tuple[Event, ...]]:
    """One sample: the next state, the command (a batch of one) and the events."""
    state, obs = _perceive(setup, state, obs)
    state = _settled(state, float(obs.time[0]))
    state, command = modes[state.mode].act(setup, state, equilibrium_lean.predicted(obs, setup.config.latency))
    state = _consider(modes, setup, state, obs)
    state = replace(state, last_u=np.asarray(command.u, dtype=float))
    return replace(state, events=()), equilibrium_lean.shifted(state.lean_offset, batched(command)), state.events


def _perceive(setup: Setup, state: NavigatorState, obs: Observation) -> tuple[NavigatorState, Observation]:
    """Updates the belief from an observation and corrects the lean by the estimated offset of the balance point."""
    obs = finite(obs, state.last_obs)
    now = float(obs.time[0])
    pushed = None if state.segment is None else state.segment.object
    belief, notes = state.belief.update(
        obs, setup.sizes, pushed=pushed, first_status=setup.first_status, kinds=setup.kinds
    )
    state = replace(state, last_obs=obs, belief=belief, lean_offset=equilibrium_lean.step(state.lean_offset, obs))
    return state.with_events(*(Note(now, text) for text in notes)), equilibrium_lean.corrected(state.lean_offset, obs)


def _settled(state: NavigatorState, now: float) -> NavigatorState:
    """Applies a pending decision that is due. A decision is dropped if the mode has changed meanwhile."""
    pending = state.pending
    if pending is None:
        return state
    if state.mode is not pending.before.mode:
        return replace(state, pending=None)
    if now < pending.due - 1e-6:
        return state
    return pending.applied_to(state, now)


def _consider(modes: Mapping[Mode, Rule], setup: Setup, state: NavigatorState, obs: Observation) -> NavigatorState:
    """Starts the mode's decision if it is due and no other decision is pending."""
    if state.pending is not None:
        return state
    before = replace(state, events=())
    decided = modes[state.mode].decide(setup, before, obs)
    if decided is None:
        return state
    due = float(obs.time[0]) + setup.config.planning_time
    waiting = replace(state, pending=Pending(due, before, decided))
    return waiting if setup.config.planning_time > 0 else _settled(waiting, float(obs.time[0]))


# Actions of the modes.


def rest(setup: Setup, state: NavigatorState, obs: Observation) -> tuple[NavigatorState, Command]:
    """Stand still."""
    return state, hold(robot_alone(obs))


def arms(state: NavigatorState, obs: Observation) -> tuple[float, float]:
    """Reach and height of the hands while driving: folded, or drawn back where walls leave no room to fold."""
    hands = float(np.max(obs.hands[0, :, 0]))
    if hands < _FOLDED or _may_fold(state, obs, hands):
        return TUCKED_REACH, TUCKED_HEIGHT
    return REACH - retreat.WITHDRAW, HAND_HEIGHT


def _may_fold(state: NavigatorState, obs: Observation, hands: float) -> bool:
    return _arms_have_room(state, obs, (TUCKED_REACH, float(np.clip(hands, TUCKED_REACH, REACH))))


def _arms_have_room(state: NavigatorState, obs: Observation, between: tuple[float, float]) -> bool:
    return float(outline.room(state.belief.wall_clearance.at, obs.robot_pose[0], between).least) > _ARM_ROOM


def drive_along(
    setup: Setup, state: NavigatorState, obs: Observation, path: Path | None
) -> tuple[NavigatorState, Float[np.ndarray, "2"]]:
    """Lean command along ``path``, avoiding everything known."""
    driven, lean = drive.follow(setup.trajectories, state.drive, obs, path, clearance=state.belief.clearance)
    return replace(state, drive=driven), lean


def start_push(
    state: NavigatorState,
    now: float,
    index: int,
    *,
    side: int,
    goal: Float[np.ndarray, "3"],
    reached: tuple[Path, float, float],
) -> NavigatorState:
    """The state after choosing a push. The approach is next.

    Args:
        state: state before.
        now: time [s].
        index: index of the object.
        side: index of the face in `ObjectBelief.faces`.
        goal: target pose of the object in {W}.
        reached: path to the stand-off pose, its gap and its lateral offset, as `Routes.path_to_face` returns them.
    """
    target, (way, gap, lateral) = state.belief.objects[index], reached
    clearance = local_distance_field(state.belief.clearance(without=index), target.pose)
    segment = Segment(index, side, target.faces[side], goal, way, approach.init(now, gap, lateral), clearance)
    state = replace(state, segment=segment, drive=drive.init())
    return state.with_object(index, pushes=target.pushes + 1, registered=target.pose)


def approach_face(setup: Setup, state: NavigatorState, obs: Observation) -> tuple[NavigatorState, Command]:
    """Drive to the stand-off pose and extend the arms."""
    segment, now = state.current(), float(obs.time[0])
    state, lean = drive_along(setup, state, obs, segment.way)
    remaining = segment.way.length - project(segment.way, obs.robot_pose[0, :2])
    yaw, object_obs = drive.yaw_ahead(obs, segment.way), ObjectObservation.of(obs, segment.object)
    room = _arms_have_room(state, obs, (TUCKED_REACH, REACH))
    reached, move = approach.step(
        segment.approach, now, object_obs, segment.face, lean=lean, yaw=yaw, remaining=remaining, room=room
    )
    state = state.with_segment(approach=reached)
    if move.over:
        feeling = contact.init(object_obs, segment.approach.lateral)
        state = replace(state.with_segment(contact=feeling), drive=drive.init())
        state = state.go(now, Mode.CONTACT, "at the stand-off pose, arms extended")
    elif move.failed:
        state = state.failed().go(now, Mode.REPLAN, "the stand-off pose was not reached in time")
    elif state.target().displaced:
        state = state.go(now, Mode.REPLAN, f"object {segment.object} was moved while it was being approached")
    return state, move.command


def make_contact(then: Mode, setup: Setup, state: NavigatorState, obs: Observation) -> tuple[NavigatorState, Command]:
    """Move slowly forward until the hands touch the object. ``then`` is the mode of the push that follows."""
    segment, target, now = state.current(), state.target(), float(obs.time[0])
    object_obs = ObjectObservation.of(obs, segment.object)
    assert segment.contact is not None
    _, move = contact.step(segment.contact, object_obs, segment.face)
    if move.over:
        key, own = jax.random.split(state.key)
        pushed = push.init(
            setup.controller,
            now,
            object_obs,
            segment.face,
            half_extents=target.half_extents,
            key=own,
            adapt=target.adapt,
            kind=target.kind,
        )
        state = replace(state, key=key).with_segment(push=pushed)
        state = state.go(now, then, f"contact with object {segment.object}")
    elif move.failed:
        state = state.failed().go(now, Mode.REPLAN, "drifted off the face while making contact")
    elif now - state.since > _LONGEST_CONTACT:
        text = f"object {segment.object} was not felt in {_LONGEST_CONTACT:g} s of reaching for it"
        state = replace(state.failed(), drive=drive.init()).go(now, Mode.RETREAT, text)
    return state, move.command


def push_object(judge: Judge, setup: Setup, state: NavigatorState, obs: Observation) -> tuple[NavigatorState, Command]:
    """One sample of a push, until ``judge`` ends it."""
    segment, target = state.current(), state.target()
    assert segment.push is not None
    firm = PROBE_ROOM if state.mode is Mode.PROBE and not rolled(segment.push, target.pose) else None
    object_obs = ObjectObservation.of(obs, segment.object)
    pushed, command = push.step(
        setup.controller,
        segment.push,
        object_obs,
        segment.face,
        last_u=state.last_u,
        goal=segment.goal,
        clearance=segment.clearance,
        half_extents=target.half_extents,
        governor_room=firm,
    )
    state = state.with_segment(push=pushed).with_object(segment.object, adapt=pushed.pusher.adapt)
    state = judge(setup, state, obs)
    return back_away(setup, state, obs) if state.mode is Mode.RETREAT else (state, command)


def rolled(pushed: push.PushState, pose: Float[np.ndarray, "3"]) -> bool:
    """Whether the object has moved so far that it is certainly movable.

    A cart that rolls ahead of the hands has little contact, but its motion is equally conclusive.
    """
    return pushed.moved(pose) > ROLLED


def push_end_reason(state: NavigatorState, now: float) -> str | None:
    """Reason why a push must end regardless of its result; None if it can continue."""
    target, pushed, index = state.target(), state.current().push, state.current().object
    assert pushed is not None
    if not pushed.ok:
        return "no roll-out of the model is finite: safe stop"
    if target.age > _UNDETECTED_LIMIT:
        return f"object {index} has not been detected for {_UNDETECTED_LIMIT:g} s"
    if pushed.since_contact > _LOST_AFTER:
        return f"contact with object {index} lost for {_LOST_AFTER:g} s"
    if now - pushed.started > _PUSH_LIMIT:
        return f"object {index} has been pushed for {_PUSH_LIMIT:g} s"
    return None


def back_away(setup: Setup, state: NavigatorState, obs: Observation) -> tuple[NavigatorState, Command]:
    """Move away from the object to a place where the arms have room to fold."""
    segment, now, pose = state.current(), float(obs.time[0]), obs.robot_pose[0]
    if segment.back is None:
        way = setup.routes(state).retreat_path(pose[:2], state.target().pose)
        state = replace(state.with_segment(back=way), drive=drive.init())
    lean = None
    if state.current().back is not None:
        state, lean = drive_along(setup, state, obs, state.current().back)
    folded = bool(np.all(obs.hands[0, :, 0] < _FOLDED))
    room = _may_fold(state, obs, float(np.max(obs.hands[0, :, 0])))
    move = retreat.step(ObjectObservation.of(obs, segment.object), segment.face, folded, lean=lean, room=room)
    if move.over or now - state.since > _LONGEST_RETREAT:
        state = replace(state, drive=drive.init())
        state = state.go(now, Mode.REPLAN, f"backed away from object {segment.object}")
    return state, move.command


def robot_alone(obs: Observation) -> ObjectObservation:
    """The robot's observation without an object."""
    none = np.zeros(3)
    pose, twist, lean, rate = (np.asarray(v[0]) for v in (obs.robot_pose, obs.robot_twist, obs.lean, obs.lean_rate))
    return ObjectObservation(pose, twist, lean, rate, none, none, none, False)


def place_of(goal: Numbers | Float[Array, "n"]) -> Float[np.ndarray, "2"]:
    """Position (x, y) of a goal in {W} [m], which may have a yaw as well."""
    return finite_numbers("the goal", goal[:2], "x, y")


def nothing(setup: Setup, state: NavigatorState, obs: Observation) -> NavigatorState | None:
    """The decision of modes without one."""
    return None


class Machine:
    """``step`` with its state and all events, for use sample by sample."""

    def __init__(self, modes: Mapping[Mode, Rule], setup: Setup, state: NavigatorState) -> None:
        self.modes, self.setup, self.state = modes, setup, state
        self.events: list[Event] = []

    def tick(self, obs: Observation) -> Command:
        """One step of the state machine: the command for the next sample, from an observation of a single world."""
        self.state, command, events = step(self.modes, self.setup, self.state, obs)
        self.events += events
        return command

    def head_for(self, goal: Numbers | Float[Array, "2"], now: float) -> None:
        """Switches to another goal in {W}. The belief stays; each side of an object may be tried again."""
        state = replace(self.state, goal=place_of(goal), path=None, drive=drive.init())
        for index in state.belief.objects:
            state = state.with_object(index, failed_faces=(), price=None, in_the_way=0)
            if state.belief.objects[index].given_up is not None:
                state = state.with_object(index, given_up=-1)
        self.state = replace(state, mode=Mode.REPLAN, since=now, segment=None, pending=None, waits_from=None)

    def expect(self, sizes: Sequence[tuple[float, float]], kinds: Sequence[str | None] | None = None) -> None:
        """Sets new objects: half extents [m] and kind of each. A pending decision is dropped."""
        self.setup = self.setup._replace(sizes=sizes, kinds=kinds)
        self.state = replace(self.state, last_obs=None, pending=None)

    def use(self, controller: PushController) -> None:
        """Continues with another controller that has the same weights. A pending decision is dropped."""
        self.setup, segment = self.setup._replace(controller=controller), self.state.segment
        self.state = replace(self.state, pending=None)
        if segment is not None and segment.push is not None:
            pushed = replace(segment.push, pusher=controller.resumed(segment.push.pusher))
            self.state = self.state.with_segment(push=pushed)

    @property
    def config(self) -> NavigatorConfig:
        """Settings of driving and decisions."""
        return self.setup.config

    @property
    def mode(self) -> Mode:
        """The current mode."""
        return self.state.mode

    @property
    def belief(self) -> Belief:
        """The current belief."""
        return self.state.belief

    @property
    def segment(self) -> Segment | None:
        """The current push, if any."""
        return self.state.segment

    @property
    def finished(self) -> bool:
        """Whether the run is over."""
        return self.mode in (Mode.DONE, Mode.FAILED)

    @property
    def learned(self) -> tuple[int, dict[str, float]] | None:
        """Index of the object being pushed and its estimate (`online.summary`); None without a push."""
        if self.segment is None or self.segment.push is None:
            return None
        return self.segment.object, online.summary(self.segment.push.pusher.adapt)

    def _of(self, kind: type) -> list[Any]:
        return [event for event in self.events if isinstance(event, kind)]

    @property
    def transitions(self) -> list[Transition]:
        """All mode switches so far."""
        return self._of(Transition)

    @property
    def decisions(self) -> list[Decision]:
        """All planning stages so far."""
        return self._of(Decision)

    @property
    def plans(self) -> list[Planned]:
        """All global paths so far."""
        return self._of(Planned)

    @property
    def notes(self) -> list[Note]:
        """All notes so far."""
        return self._of(Note)
