"""Decisions during a push: whether it is finished, lost or stuck, and whether another option takes less time."""

from __future__ import annotations

import numpy as np

from shmoo_mjx.behavior import paper, push_options
from shmoo_mjx.behavior.belief import Status
from shmoo_mjx.behavior.interaction import push_end_reason, rolled
from shmoo_mjx.behavior.state import Decision, Mode, NavigatorState, Setup
from shmoo_mjx.planning.reach import foresight_of
from shmoo_mjx.types import DT, Observation

PROBE_TIME = 1.0
"""Contact time before the first decision, as in the paper, and between two decisions [s]."""
_STALLED = 0.05
"""Distance moved in the stall time below which a push has stalled [m]."""
_CLEAR_EVERY = 5
"""Samples between two checks whether the path is free. Each check plans two paths."""
_ROUND_MARGIN = 0.10
"""Extra distance between a detour and the object [m]. The object moves slightly when it is released."""


def judge(setup: Setup, state: NavigatorState, obs: Observation) -> NavigatorState:
    """Ends a push that is finished, stuck or lost, as far as this needs no planning."""
    now, push, index = float(obs.time[0]), state.current().push, state.current().object
    over = push_end_reason(state, now)
    if over:
        return state.failed().go(now, Mode.RETREAT, over)
    assert push is not None
    travelled = push.travelled(push_options.GIVES_UP)
    if travelled is not None and travelled < _STALLED:
        why = f"object {index} moved less than {_STALLED:g} m in {push_options.GIVES_UP:g} s"
        return state.failed().go(now, Mode.RETREAT, why) if setup.by_time else paper.immovable(state, now, why)
    return state if setup.by_time else paper.arrived(state, now)


def review(setup: Setup, state: NavigatorState, obs: Observation) -> NavigatorState | None:
    """Checks whether the path is clear, or decides again, if either is due."""
    now, segment = float(obs.time[0]), state.current()
    push, target, routes = segment.push, state.target(), setup.routes(state)
    assert push is not None
    looks = (state.mode is Mode.PUSH or rolled(push, target.pose)) and round(now / DT) % _CLEAR_EVERY == 0
    if looks and push_options.path_clear(routes, obs.robot_pose[0, :2], segment.object):
        state = state.with_object(segment.object, status=Status.PARKED)
        return state.go(now, Mode.RETREAT, f"object {segment.object} no longer blocks the path")
    if push.contact_time < segment.reviewed + PROBE_TIME:
        return None
    state = state.with_segment(reviewed=push.contact_time)
    return _think_again(setup, state, obs) if setup.by_time else paper.planning(setup, state, obs)


def _think_again(setup: Setup, state: NavigatorState, obs: Observation) -> NavigatorState:
    """Continues this push, or leaves it if the detour has the lower expected time."""
    now, segment, target = float(obs.time[0]), state.current(), state.target()
    index, routes, position = segment.object, setup.routes(state), obs.robot_pose[0, :2]
    through = routes.quickest(position, without=index)
    if through is None:
        return state
    clearance, side = state.belief.clearance(without=index), segment.side
    pushes = push_options.predict_pushes(
        foresight_of(setup.controller),
        target,
        through.path,
        clearance=clearance,
        sides=[side],
        places={side: segment.goal},
        seed=round(now / DT),
    )
    never = setup.config.goes_round == "never"
    detour = None if never else routes.quickest(position, {index: _ROUND_MARGIN})
    # Without a detour, a failure is followed by another push, which costs the object's price.
    again = through.seconds + (push_options.BLOCKED if target.price is None else target.price)
    otherwise = push_options.AWAY + (again if detour is None else detour.seconds)
    (here,) = push_options.rank_pushes(
        pushes, walks={side: 0.0}, failed=target.failed_faces, rest=through.seconds, otherwise=otherwise
    )
    way_round = None if detour is None else otherwise
    summary, options = push_options.describe_options((here,), way_round), push_options.option_list((here,), way_round)
    moves = here.probability >= 0.5
    decision = Decision(
        now, index, np.nan, np.nan, moves, here.goal, summary, here.ends, here.goal[None], here.probability, options
    )
    state = state.with_object(index, manipulable=moves).with_events(decision)
    if detour is not None and otherwise < here.seconds:
        return state.failed().go(now, Mode.RETREAT, f"object {index}: {summary}")
    if np.isfinite(here.free).any():
        state = state.with_segment(goal=here.goal)
    return state.go(now, Mode.PUSH, f"object {index}: {summary}") if state.mode is Mode.PROBE else state
