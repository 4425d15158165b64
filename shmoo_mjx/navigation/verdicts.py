"""Decisions during a push: is it over, lost or stuck, and does something else take less time."""

from __future__ import annotations

import numpy as np

from shmoo_mjx.arrays import Float
from shmoo_mjx.navigation import decide, paper
from shmoo_mjx.navigation.belief import Status
from shmoo_mjx.navigation.records import Decision, Mode, NavigatorState, Setup
from shmoo_mjx.planning.reach import foresight_of
from shmoo_mjx.skills.push import PushState
from shmoo_mjx.types import DT, Observation

UNDETECTED_LIMIT = 1.5
"""Time since the object's last detection at which a push ends [s]: a third of a metre at the speed allowed."""
PROBE_TIME = 1.0
"""Contact time before the first decision and between two [s], the first as in the paper."""
_LOST_AFTER = 1.5
"""Time without contact after which contact counts as lost [s]: the hands catch up with what rolls ahead of them."""
_PUSH_LIMIT = 45.0
"""Longest push [s]: 11 m at the speed allowed."""
_ROLLED = 0.10
"""An object that has moved this far under a probe gives way beyond doubt [m]."""
_STALLED = 0.05
"""An object that moved less than this in the time that a push is given has stalled [m]."""
_CLEAR_EVERY = 5
"""Samples between two looks whether a pushed object has left the path free: each plans two paths."""
_ROUND_MARGIN = 0.10
"""What a way round keeps from the object beside the robot's radius [m]: letting go moves it a little."""


def rolled(push: PushState, pose: Float[np.ndarray, "3"]) -> bool:
    """Whether the object has moved so far that it gives way beyond doubt: a cart that rolls ahead of the hands gives
    little contact, but its motion tells as much."""
    return push.moved(pose) > _ROLLED


def judge(setup: Setup, state: NavigatorState, obs: Observation) -> NavigatorState:
    """End a push that is over, stuck or lost, as far as that takes no planning to see."""
    segment, known, now = state.current(), state.known(), float(obs.time[0])
    push, index = segment.push, segment.object
    assert push is not None

    def leave(reason: str) -> NavigatorState:
        return state.failed().go(now, Mode.RETREAT, reason)

    if not push.ok:
        return leave("no roll-out of the model is finite: safe stop")
    if known.age > UNDETECTED_LIMIT:
        return leave(f"object {index} has not been detected for {UNDETECTED_LIMIT:g} s")
    if push.since_contact > _LOST_AFTER:
        return leave(f"contact with object {index} lost for {_LOST_AFTER:g} s")
    if now - push.started > _PUSH_LIMIT:
        return leave(f"object {index} has been pushed for {_PUSH_LIMIT:g} s")
    travelled = push.travelled(decide.GIVES_UP)
    if travelled is not None and travelled < _STALLED:
        why = f"object {index} moved less than {_STALLED:g} m in {decide.GIVES_UP:g} s"
        return leave(why) if setup.by_time else paper.immovable(state, now, why)
    return state if setup.by_time else paper.arrived(state, now)


def review(setup: Setup, state: NavigatorState, obs: Observation) -> NavigatorState | None:
    """Look whether the path is clear, or decide again, where either is due."""
    now, segment = float(obs.time[0]), state.current()
    push, known, routes = segment.push, state.known(), setup.routes(state)
    assert push is not None
    looks = (state.mode is Mode.PUSH or rolled(push, known.pose)) and round(now / DT) % _CLEAR_EVERY == 0
    if looks and routes.path_clear(obs.robot_pose[0, :2], segment.object):
        state = state.with_object(segment.object, status=Status.PARKED)
        return state.go(now, Mode.RETREAT, f"object {segment.object} no longer blocks the path")
    if push.contact_time < segment.reviewed + PROBE_TIME:
        return None
    state = state.with_segment(reviewed=push.contact_time)
    return _think_again(setup, state, obs) if setup.by_time else paper.planning(setup, state, obs)


def _think_again(setup: Setup, state: NavigatorState, obs: Observation) -> NavigatorState:
    """Go on with this push, or leave it where the way round takes less time on average."""
    now, segment, known = float(obs.time[0]), state.current(), state.known()
    index, routes, position = segment.object, setup.routes(state), obs.robot_pose[0, :2]
    through = routes.quickest(position, without=index)
    if through is None:
        return state
    field, side = state.belief.clearance(without=index), segment.side
    found = decide.pushes(
        foresight_of(setup.controller), known, through.path, field, [side], {side: segment.goal}, round(now / DT)
    )
    never = setup.config.goes_round == "never"
    detour = None if never else routes.quickest(position, {index: _ROUND_MARGIN})
    # Without a way round what follows a failure is another push, at what that was taken to cost.
    again = through.seconds + (decide.BLOCKED if known.price is None else known.price)
    around = decide.AWAY + (again if detour is None else detour.seconds)
    (here,) = decide.weigh(found, {side: 0.0}, known.failed_faces, through.seconds, around)
    told = decide.told((here,), None if detour is None else around)
    moves = here.probability >= 0.5
    state = state.with_object(index, manipulable=moves).with_events(
        Decision(now, index, np.nan, np.nan, moves, here.goal, told, here.ends, here.goal[None], here.probability)
    )
    if detour is not None and around < here.seconds:
        return state.failed().go(now, Mode.RETREAT, f"object {index}: {told}")
    if np.isfinite(here.free).any():
        state = state.with_segment(goal=here.goal)
    return state.go(now, Mode.PUSH, f"object {index}: {told}") if state.mode is Mode.PROBE else state
