"""Dealing with an object, one machine for whoever moves one: approach a face, make contact, push, retreat.

A frozen state, a table of modes, and a list of events: ``step`` takes a state and an observation and gives the next
state, the command for the next sample, and what has happened. The navigator and the pushing task differ in their
tables: in what is decided before a push, and in what ends one.

Each mode *acts* at 10 Hz. What takes longer to compute, a global path or a planning stage, it *decides*: the decision
takes effect ``planning_time`` later, and until then the robot goes on as it did.
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
"""Time since the object's last detection at which a push ends [s]: a third of a metre at the speed allowed."""
_LOST_AFTER = 2.0
"""Time without contact after which contact counts as lost [s]: the hands catch up with what rolls ahead of them."""
ROLLED = 0.10
"""An object that has moved this far under a probe gives way beyond doubt [m]."""
_FOLDED = TUCKED_REACH + 0.06
"""Reach of the hands up to which the arms are folded [m]."""
_PUSH_LIMIT = 45.0
"""Longest push [s]: 11 m at the speed allowed on a way to a goal, 7 m at that to a pose."""
_ARM_ROOM = 0.05
"""Distance from walls at which the arms may unfold or fold [m]: they swing a little."""
_LONGEST_RETREAT = 6.0
"""Time after which a retreat ends wherever the robot is [s]."""
_LONGEST_CONTACT = 10.0
"""Time to feel the object after which something else must hold the hands [s]; two are usual."""
PROBE_ROOM = 0.03
"""How far the probe's lean may stay below what the governor grants, while the object has not moved yet [rad]: a verdict
on what was only touched gently would be worth little."""
Act = Callable[[Setup, NavigatorState, Observation], tuple[NavigatorState, Command]]
"""The next state and the command for the next sample, of one world, unbatched."""
Judge = Callable[[Setup, NavigatorState, Observation], NavigatorState]
"""The state with the push ended, if it is to end."""


class Rule(NamedTuple):
    """What is done in a mode."""

    act: Act
    """What the robot does; it may change the mode."""
    decide: Callable[[Setup, NavigatorState, Observation], NavigatorState | None]
    """What takes time to compute, if anything is due: the state in which it has been decided."""
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
    """Constant parts of a machine; see the fields of :class:`~shmoo_mjx.behavior.state.Setup`."""
    config = config or NavigatorConfig()
    planner = flat_qp.init(FlatModel(*shmoobot().flatness), config.trajectory)
    return Setup(sizes, controller, config, planner, first_status, kinds)


def step(
    modes: Mapping[Mode, Rule], setup: Setup, state: NavigatorState, obs: Observation
) -> tuple[NavigatorState, Command, tuple[Event, ...]]:
    """One sample: the next state, the command (a batch of one) and what has happened."""
    state, obs = _perceive(setup, state, obs)
    state = _settled(state, float(obs.time[0]))
    state, command = modes[state.mode].act(setup, state, equilibrium_lean.predicted(obs, setup.config.latency))
    state = _consider(modes, setup, state, obs)
    state = replace(state, last_u=np.asarray(command.u, dtype=float))
    return replace(state, events=()), equilibrium_lean.shifted(state.lean_offset, batched(command)), state.events


def _perceive(setup: Setup, state: NavigatorState, obs: Observation) -> tuple[NavigatorState, Observation]:
    """Take in an observation; its lean is counted from where the robot balances from here on."""
    obs = finite(obs, state.last_obs)
    now = float(obs.time[0])
    pushed = None if state.segment is None else state.segment.object
    belief, notes = state.belief.update(
        obs, setup.sizes, pushed=pushed, first_status=setup.first_status, kinds=setup.kinds
    )
    state = replace(state, last_obs=obs, belief=belief, lean_offset=equilibrium_lean.step(state.lean_offset, obs))
    return state.with_events(*(Note(now, text) for text in notes)), equilibrium_lean.corrected(state.lean_offset, obs)


def _settled(state: NavigatorState, now: float) -> NavigatorState:
    """Take over a decision that has become known; it is void if the mode has changed meanwhile."""
    pending = state.pending
    if pending is None:
        return state
    if state.mode is not pending.before.mode:
        return replace(state, pending=None)
    if now < pending.due - 1e-6:
        return state
    return pending.applied_to(state, now)


def _consider(modes: Mapping[Mode, Rule], setup: Setup, state: NavigatorState, obs: Observation) -> NavigatorState:
    """Begin to compute what the mode has to decide, if it is due and nothing else is being computed."""
    if state.pending is not None:
        return state
    before = replace(state, events=())
    decided = modes[state.mode].decide(setup, before, obs)
    if decided is None:
        return state
    due = float(obs.time[0]) + setup.config.planning_time
    waiting = replace(state, pending=Pending(due, before, decided))
    return waiting if setup.config.planning_time > 0 else _settled(waiting, float(obs.time[0]))


# What is done in each mode.


def rest(setup: Setup, state: NavigatorState, obs: Observation) -> tuple[NavigatorState, Command]:
    """Stand still."""
    return state, hold(robot_alone(obs))


def arms(state: NavigatorState, obs: Observation) -> tuple[float, float]:
    """Reach and height of the hands while driving: folded, or drawn back while walls leave no room to fold."""
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
    """Lean along ``path`` round everything that is known."""
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
    """The state in which a push has been chosen; the approach is next.

    Args:
        state: before.
        now: [s]
        index: the object.
        side: index of the face among `ObjectBelief.faces`.
        goal: pose of the object in {W}.
        reached: way to the stand-off pose, its gap and its place along the face, as `Routes.path_to_face` gives them.
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
    """Move slowly forward until the hands feel the object; ``then`` is the mode in which it is pushed."""
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
    """Whether the object has moved so far that it gives way beyond doubt: a cart that rolls ahead of the hands gives
    little contact, but its motion tells as much."""
    return pushed.moved(pose) > ROLLED


def push_end_reason(state: NavigatorState, now: float) -> str | None:
    """Why no push goes on, wherever it leads: None if it can."""
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
    """Away from the object to where the arms have room to fold."""
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
    """The robot, as a sighting of nothing."""
    none = np.zeros(3)
    pose, twist, lean, rate = (np.asarray(v[0]) for v in (obs.robot_pose, obs.robot_twist, obs.lean, obs.lean_rate))
    return ObjectObservation(pose, twist, lean, rate, none, none, none, False)


def place_of(goal: Numbers | Float[Array, "n"]) -> Float[np.ndarray, "2"]:
    """The place of a goal in {W} [m], which may have a yaw too."""
    return finite_numbers("the goal", goal[:2], "x, y")


def nothing(setup: Setup, state: NavigatorState, obs: Observation) -> NavigatorState | None:
    """Nothing to decide."""
    return None


class Machine:
    """``step`` with its state and all its events kept, for whoever runs it sample by sample."""

    def __init__(self, modes: Mapping[Mode, Rule], setup: Setup, state: NavigatorState) -> None:
        self.modes, self.setup, self.state = modes, setup, state
        self.events: list[Event] = []

    def tick(self, obs: Observation) -> Command:
        """One decision from one observation of a single world: the command for the next sample."""
        self.state, command, events = step(self.modes, self.setup, self.state, obs)
        self.events += events
        return command

    def head_for(self, goal: Numbers | Float[Array, "2"], now: float) -> None:
        """Go on to another goal in {W}, with all that is known; each side of an object may be tried anew."""
        state = replace(self.state, goal=place_of(goal), path=None, drive=drive.init())
        for index in state.belief.objects:
            state = state.with_object(index, failed_faces=(), price=None, in_the_way=0)
            if state.belief.objects[index].given_up is not None:
                state = state.with_object(index, given_up=-1)
        self.state = replace(state, mode=Mode.REPLAN, since=now, segment=None, pending=None, waits_from=None)

    def expect(self, sizes: Sequence[tuple[float, float]], kinds: Sequence[str | None] | None = None) -> None:
        """There are more objects, or others: half extents [m] and looks of each. What is being computed is dropped."""
        self.setup = self.setup._replace(sizes=sizes, kinds=kinds)
        self.state = replace(self.state, last_obs=None, pending=None)

    @property
    def config(self) -> NavigatorConfig:
        """The settings of how it drives and decides."""
        return self.setup.config

    @property
    def mode(self) -> Mode:
        """What it is doing."""
        return self.state.mode

    @property
    def belief(self) -> Belief:
        """What it knows of the world."""
        return self.state.belief

    @property
    def segment(self) -> Segment | None:
        """The object that it is dealing with."""
        return self.state.segment

    @property
    def finished(self) -> bool:
        """Whether the run has come to its end."""
        return self.mode in (Mode.DONE, Mode.FAILED)

    @property
    def learned(self) -> tuple[int, dict[str, float]] | None:
        """The object that is pushed at present, and what has been learned of it (`online.summary`)."""
        if self.segment is None or self.segment.push is None:
            return None
        return self.segment.object, online.summary(self.segment.push.pusher.adapt)

    def _of(self, kind: type) -> list[Any]:
        return [event for event in self.events if isinstance(event, kind)]

    @property
    def transitions(self) -> list[Transition]:
        """Every change of mode so far."""
        return self._of(Transition)

    @property
    def decisions(self) -> list[Decision]:
        """Every planning stage so far."""
        return self._of(Decision)

    @property
    def plans(self) -> list[Planned]:
        """Every global path so far."""
        return self._of(Planned)

    @property
    def notes(self) -> list[Note]:
        """What it noticed so far."""
        return self._of(Note)
