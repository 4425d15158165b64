"""Interactive navigation (Sec. IV): follow the path, push what is in the way, go round what can't be pushed.

A frozen state, a table of modes, and a list of events: ``step`` takes a state and an observation and gives the next
state, the command for the next sample, and what has happened. It perceives poses and sizes of objects and the force on
its hands; what it knows of an object's dynamics it has learned by touching it.

Each mode *acts* at 10 Hz. What takes longer to compute, a global path or a planning stage, it *decides*: the decision
takes effect ``planning_time`` later, and until then the robot goes on as it did.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import fields, is_dataclass, replace
from typing import Any, NamedTuple

import jax
import numpy as np

from shmoo_mjx.arrays import Array, Float, Numbers, finite_numbers
from shmoo_mjx.control import equilibrium_lean
from shmoo_mjx.control.observation import ObjectObservation
from shmoo_mjx.hands import HAND_HEIGHT, REACH, TUCKED_HEIGHT, TUCKED_REACH
from shmoo_mjx.learning import online
from shmoo_mjx.navigation import drive, flat_qp
from shmoo_mjx.navigation.belief import Belief, Status, belief_of
from shmoo_mjx.navigation.choices import look_ahead, replan
from shmoo_mjx.navigation.flat_model import FlatModel
from shmoo_mjx.navigation.maps import OccupancyGrid
from shmoo_mjx.navigation.paths import Path, project
from shmoo_mjx.navigation.records import (
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
from shmoo_mjx.navigation.scenario import ROBOT_RADIUS
from shmoo_mjx.navigation.verdicts import judge, review, rolled
from shmoo_mjx.plant import outline
from shmoo_mjx.plant.robot import shmoobot
from shmoo_mjx.sensing import finite
from shmoo_mjx.skills import approach, batched, contact, hold, push, retreat
from shmoo_mjx.types import Command, Observation

_NO_TRAJECTORY = 3.0
"""Time without a local trajectory after which another path is sought [s]."""
_ARM_ROOM = 0.05
"""Distance from walls at which the arms may unfold or fold [m]: they swing a little."""
_TURNING_ROOM = 0.05
"""Distance from walls beyond the robot's radius at which it may turn on its way [m]: its elbows sweep a circle."""
_LONGEST_RETREAT = 6.0
"""Time after which a retreat ends wherever the robot is [s]."""
_LONGEST_CONTACT = 10.0
"""Time to feel the object after which something else must hold the hands [s]; two are usual."""
PROBE_ROOM = 0.03
"""How far the probe's lean may stay below what the governor grants, while the object has not moved yet [rad]: a verdict
on what was only touched gently would be worth little."""


class _Mode(NamedTuple):
    """What the navigator does in a mode."""

    act: Callable[[Setup, NavigatorState, Observation], tuple[NavigatorState, Command]]
    """The command for the next sample (of one world, unbatched); it may change the mode."""
    decide: Callable[[Setup, NavigatorState, Observation], NavigatorState | None]
    """What takes time to compute, if anything is due: the state in which it has been decided."""
    leads_to: tuple[Mode, ...]
    """Modes that may follow."""


def setup_of(
    sizes: Sequence[tuple[float, float]],
    controller: Any,
    config: NavigatorConfig | None = None,
    first_status: Sequence[Status] | None = None,
    kinds: Sequence[str | None] | None = None,
) -> Setup:
    """Constant parts of a navigator; see the fields of :class:`~shmoo_mjx.navigation.records.Setup`."""
    config = config or NavigatorConfig()
    planner = flat_qp.init(FlatModel(*shmoobot().flatness), config.trajectory)
    return Setup(sizes, controller, config, planner, first_status, kinds)


def init(grid: OccupancyGrid, goal: Numbers | Float[Array, "2"], seed: int = 0) -> NavigatorState:
    """State at the start, with nothing known but the map; the goal is in {W} [m]."""
    return NavigatorState(_goal(goal), belief_of(grid), jax.random.key(seed))


def _goal(given: Numbers | Float[Array, "n"]) -> np.ndarray:
    """The place ``[2]`` of a goal, which may have a yaw too."""
    return finite_numbers("the goal", given[:2], "x, y")


def step(setup: Setup, state: NavigatorState, obs: Observation) -> tuple[NavigatorState, Command, tuple[Event, ...]]:
    """One sample: the next state, the command (a batch of one) and what has happened."""
    state, obs = _perceive(setup, state, obs)
    state = _settled(state, float(obs.time[0]))
    state, command = MODES[state.mode].act(setup, state, equilibrium_lean.predicted(obs, setup.config.latency))
    state = _consider(setup, state, obs)
    state = replace(state, last_u=np.asarray(command.u, dtype=float))
    return replace(state, events=()), equilibrium_lean.shifted(state.lean_offset, batched(command)), state.events


def _perceive(setup: Setup, state: NavigatorState, obs: Observation) -> tuple[NavigatorState, Observation]:
    """Take in an observation; its lean is counted from where the robot balances from here on."""
    obs = finite(obs, state.last_obs)
    now = float(obs.time[0])
    pushed = None if state.segment is None else state.segment.object
    belief, notes = state.belief.update(obs, setup.sizes, pushed, setup.first_status, setup.kinds)
    state = replace(state, last_obs=obs, belief=belief, lean_offset=equilibrium_lean.step(state.lean_offset, obs))
    return state.with_events(*(Note(now, text) for text in notes)), equilibrium_lean.corrected(state.lean_offset, obs)


def _settled(state: NavigatorState, now: float) -> NavigatorState:
    """Take over a decision that has become known; it is void if the mode has changed meanwhile."""
    pending = state.pending
    if pending is None:
        return state
    if state.mode is not pending.asked.mode:
        return replace(state, pending=None)
    if now < pending.due - 1e-6:
        return state
    events = (*state.events, *(event._replace(t=now) for event in pending.decided.events))
    merged = _merged(pending.asked, pending.decided, replace(state, pending=None))
    begins = {"since": now} if merged.mode is not state.mode else {}
    return replace(merged, events=events, pending=None, **begins)


def _consider(setup: Setup, state: NavigatorState, obs: Observation) -> NavigatorState:
    """Begin to compute what the mode has to decide, if it is due and nothing else is being computed."""
    if state.pending is not None:
        return state
    asked = replace(state, events=())
    decided = MODES[state.mode].decide(setup, asked, obs)
    if decided is None:
        return state
    due = float(obs.time[0]) + setup.config.planning_time
    waiting = replace(state, pending=Pending(due, asked, decided))
    return waiting if setup.config.planning_time > 0 else _settled(waiting, float(obs.time[0]))


def _merged(asked: Any, decided: Any, current: Any) -> Any:
    """What a decision has changed, laid over what has happened since it was asked for."""
    if decided is asked:
        return current
    if current is asked:
        return decided
    same = type(asked) is type(decided) is type(current)
    if is_dataclass(asked) and not isinstance(asked, type) and same:
        names = [f.name for f in fields(asked)]
        merged = {n: _merged(getattr(asked, n), getattr(decided, n), getattr(current, n)) for n in names}
        changed: Any = replace(current, **merged)
        return changed
    if isinstance(asked, dict) and isinstance(decided, dict) and isinstance(current, dict):
        return {k: _merged(asked.get(k), decided.get(k, v), v) for k, v in current.items()}
    return decided


# What is done in each mode.


def _rest(setup: Setup, state: NavigatorState, obs: Observation) -> tuple[NavigatorState, Command]:
    return state, hold(_robot(obs))


def _brake(setup: Setup, state: NavigatorState, obs: Observation) -> tuple[NavigatorState, Command]:
    """While a path is sought: to the end of the present trajectory, which is at rest."""
    if state.drive.trajectory is None:
        return _rest(setup, state, obs)
    state, lean = _drive(setup, state, obs, None)
    return state, Command(np.append(lean, 0.0), obs.robot_pose[0, 2], *_arms(setup, state, obs))


def _arms(setup: Setup, state: NavigatorState, obs: Observation) -> tuple[float, float]:
    """Reach and height of the hands while driving: folded, or drawn back while walls leave no room to fold."""
    hands = float(np.max(obs.hands[0, :, 0]))
    if hands < TUCKED_REACH + 0.06 or _may_fold(state, obs, hands):
        return TUCKED_REACH, TUCKED_HEIGHT
    return REACH - retreat.WITHDRAW, HAND_HEIGHT


def _may_fold(state: NavigatorState, obs: Observation, hands: float) -> bool:
    between = (TUCKED_REACH, float(np.clip(hands, TUCKED_REACH, REACH)))
    return float(outline.room(state.belief.walls.at, obs.robot_pose[0], between).least) > _ARM_ROOM


def _turned(setup: Setup, state: NavigatorState, obs: Observation, yaw: float) -> float:
    """The heading ``yaw``, or the present one where walls leave no room to turn."""
    room = float(state.belief.walls.at(obs.robot_pose[0, :2])) - ROBOT_RADIUS
    return yaw if room > _TURNING_ROOM else float(obs.robot_pose[0, 2])


def _drive(
    setup: Setup, state: NavigatorState, obs: Observation, path: Path | None
) -> tuple[NavigatorState, Float[np.ndarray, "2"]]:
    """Lean along ``path`` round everything that is known."""
    driven, lean = drive.follow(setup.trajectories, state.drive, obs, path, state.belief.clearance)
    return replace(state, drive=driven), lean


def _follow(setup: Setup, state: NavigatorState, obs: Observation) -> tuple[NavigatorState, Command]:
    now, position, cfg = float(obs.time[0]), obs.robot_pose[0, :2], setup.config
    left, speed = float(np.linalg.norm(position - state.goal)), float(np.linalg.norm(obs.robot_twist[0, :2]))
    if left < cfg.goal_tolerance and speed < 0.1:
        return state.go(now, Mode.DONE, f"goal reached to {left:.2f} m"), hold(_robot(obs))
    path = state.path
    assert path is not None
    state, lean = _drive(setup, state, obs, path)
    since = state.drive.failed_since
    if since is not None and now - since > _NO_TRAJECTORY:
        state = state.go(now, Mode.REPLAN, f"no local trajectory for {_NO_TRAJECTORY:g} s: {state.drive.reason}")
    yaw = _turned(setup, state, obs, drive.yaw_ahead(obs, path))
    return state, Command(np.append(lean, 0.0), yaw, *_arms(setup, state, obs))


def _approach(setup: Setup, state: NavigatorState, obs: Observation) -> tuple[NavigatorState, Command]:
    segment, now = state.current(), float(obs.time[0])
    state, lean = _drive(setup, state, obs, segment.way)
    remaining = segment.way.length - project(segment.way, obs.robot_pose[0, :2])
    yaw = drive.yaw_ahead(obs, segment.way)
    object_obs, pose = ObjectObservation.of(obs, segment.object), obs.robot_pose[0]
    room = float(outline.room(state.belief.walls.at, pose, (TUCKED_REACH, REACH)).least) > _ARM_ROOM
    reached, move = approach.step(segment.approach, now, object_obs, segment.face, lean, yaw, remaining, room)
    state = state.with_segment(approach=reached)
    if move.over:
        begun = contact.init(object_obs, segment.approach.lateral)
        state = replace(state.with_segment(contact=begun), drive=drive.init())
        state = state.go(now, Mode.CONTACT, "at the stand-off pose, arms extended")
    elif move.failed:
        state = state.failed().go(now, Mode.REPLAN, "the stand-off pose was not reached in time")
    elif state.known().displaced:
        state = state.go(now, Mode.REPLAN, f"object {segment.object} was moved while it was being approached")
    return state, move.command


def _contact(setup: Setup, state: NavigatorState, obs: Observation) -> tuple[NavigatorState, Command]:
    segment, known, now = state.current(), state.known(), float(obs.time[0])
    object_obs = ObjectObservation.of(obs, segment.object)
    assert segment.contact is not None
    _, move = contact.step(segment.contact, object_obs, segment.face)
    if move.over:
        key, own = jax.random.split(state.key)
        begun = push.init(
            setup.controller, now, object_obs, segment.face, known.half_extents, own, known.adapt, known.kind
        )
        state = replace(state, key=key).with_segment(push=begun)
        state = state.go(now, Mode.PROBE, f"contact with object {segment.object}")
    elif move.failed:
        state = state.failed().go(now, Mode.REPLAN, "drifted off the face while making contact")
    elif now - state.since > _LONGEST_CONTACT:
        text = f"object {segment.object} was not felt in {_LONGEST_CONTACT:g} s of reaching for it"
        state = replace(state.failed(), drive=drive.init()).go(now, Mode.RETREAT, text)
    return state, move.command


def _push(setup: Setup, state: NavigatorState, obs: Observation) -> tuple[NavigatorState, Command]:
    segment, known = state.current(), state.known()
    assert segment.push is not None
    firm = PROBE_ROOM if state.mode is Mode.PROBE and not rolled(segment.push, known.pose) else None
    object_obs = ObjectObservation.of(obs, segment.object)
    pushed, command = push.step(
        setup.controller, segment.push, object_obs, segment.face, state.last_u, segment.goal, segment.around,
        known.half_extents, firm,
    )  # fmt: skip
    state = state.with_segment(push=pushed)
    state = state.with_object(segment.object, adapt=pushed.pusher.adapt)
    state = judge(setup, state, obs)
    return _retreat(setup, state, obs) if state.mode is Mode.RETREAT else (state, command)


def _retreat(setup: Setup, state: NavigatorState, obs: Observation) -> tuple[NavigatorState, Command]:
    segment, now, pose = state.current(), float(obs.time[0]), obs.robot_pose[0]
    if segment.back is None:
        way = setup.routes(state).retreat_path(pose[:2], state.known().pose)
        state = replace(state.with_segment(back=way), drive=drive.init())
    lean = None
    if state.current().back is not None:
        state, lean = _drive(setup, state, obs, state.current().back)
    folded = bool(np.all(obs.hands[0, :, 0] < TUCKED_REACH + 0.06))
    room = _may_fold(state, obs, float(np.max(obs.hands[0, :, 0])))
    object_obs = ObjectObservation.of(obs, segment.object)
    move = retreat.step(object_obs, segment.face, folded, lean, room)
    if move.over or now - state.since > _LONGEST_RETREAT:
        state = replace(state, drive=drive.init())
        state = state.go(now, Mode.REPLAN, f"backed away from object {segment.object}")
    return state, move.command


def _robot(obs: Observation) -> ObjectObservation:
    """The robot alone, as a sighting of nothing."""
    none = np.zeros(3)
    pose, twist, lean, rate = (np.asarray(v[0]) for v in (obs.robot_pose, obs.robot_twist, obs.lean, obs.lean_rate))
    return ObjectObservation(pose, twist, lean, rate, none, none, none, False)


def _nothing(setup: Setup, state: NavigatorState, obs: Observation) -> NavigatorState | None:
    return None


MODES: dict[Mode, _Mode] = {
    Mode.REPLAN: _Mode(_brake, replan, (Mode.FOLLOW, Mode.FAILED)),
    Mode.FOLLOW: _Mode(_follow, look_ahead, (Mode.FOLLOW, Mode.APPROACH, Mode.REPLAN, Mode.DONE, Mode.FAILED)),
    Mode.APPROACH: _Mode(_approach, _nothing, (Mode.CONTACT, Mode.REPLAN)),
    Mode.CONTACT: _Mode(_contact, _nothing, (Mode.PROBE, Mode.REPLAN, Mode.RETREAT)),
    Mode.PROBE: _Mode(_push, review, (Mode.PUSH, Mode.RETREAT)),
    Mode.PUSH: _Mode(_push, review, (Mode.RETREAT,)),
    Mode.RETREAT: _Mode(_retreat, _nothing, (Mode.REPLAN,)),
    Mode.DONE: _Mode(_rest, _nothing, ()),
    Mode.FAILED: _Mode(_rest, _nothing, ()),
}
"""The transition table. A test follows runs through it."""


class Navigator:
    """``step`` with its state and all its events kept, for whoever runs it sample by sample."""

    def __init__(
        self,
        grid: OccupancyGrid,
        goal: Numbers | Float[Array, "2"],
        sizes: Sequence[tuple[float, float]],
        controller: Any,
        seed: int = 0,
        config: NavigatorConfig | None = None,
        first_status: Sequence[Status] | None = None,
        kinds: Sequence[str | None] | None = None,
    ) -> None:
        self.setup = setup_of(sizes, controller, config, first_status, kinds)
        self.state = init(grid, goal, seed)
        self.events: list[Event] = []

    def tick(self, obs: Observation) -> Command:
        """One decision from one observation of a single world."""
        self.state, command, events = step(self.setup, self.state, obs)
        self.events += events
        return command

    def head_for(self, goal: Numbers | Float[Array, "2"], now: float) -> None:
        """Go on to another goal in {W}, with all that is known; each side of an object may be tried anew."""
        state = replace(self.state, goal=_goal(goal), path=None, drive=drive.init())
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
        """The settings."""
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
        """The object that is pushed at present, and what has been learned of it (`online.learned`)."""
        if self.segment is None or self.segment.push is None:
            return None
        return self.segment.object, online.learned(self.segment.push.pusher.adapt)

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
