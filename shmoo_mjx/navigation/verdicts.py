"""Decisions during a push: is it over, lost or stuck, and can the object be moved at all (Algorithm 1)."""

from __future__ import annotations

import numpy as np

from shmoo_mjx.arrays import Bool, Float
from shmoo_mjx.faces import heading
from shmoo_mjx.navigation import decide, mobility
from shmoo_mjx.navigation.belief import Status
from shmoo_mjx.navigation.object_planner import ObjectDecision, planning_stage
from shmoo_mjx.navigation.records import Decision, Mode, NavigatorState, Note, Planned, Segment, Setup
from shmoo_mjx.planning.reach import Foresight
from shmoo_mjx.skills.push import PushState
from shmoo_mjx.types import DT, Observation

PROBE_TIME = 1.0
"""Contact time before the planning stage (Algorithm 1) [s], as in the paper; what has rolled away by then is not waited
for."""
UNDETECTED_LIMIT = 1.5
"""Time since the object's last detection at which a push ends [s]: a third of a metre at the speed allowed."""
_LOST_AFTER = 1.5
"""Time without contact after which contact counts as lost [s]: the hands catch up with what rolls ahead of them."""
_PUSH_LIMIT = 45.0
"""Longest push [s]: 11 m at the speed allowed."""
_AT_GOAL = 0.10
"""Distance from its goal at which an object has arrived [m]."""
_PASSED = -0.08
"""Way left to the goal along the push at which it has been passed [m]."""
_ROLLED = 0.10
"""An object that has moved this far under a probe gives way beyond doubt [m]."""
_STALL = (0.05, 6.0)
"""An object that moved less than this [m] in so much time of a push [s] has stalled."""
_PACE = 0.4
"""Speed of walking [m/s], for the time that a way round takes."""
_MOVED = 0.3
"""An object that a push has moved this far is not immovable, whatever holds it now: a wall, say [m]."""
_REVIEW_EVERY = 2.0
"""Contact time between two planning stages of a push [s]."""
_CLEAR_EVERY = 5
"""Samples between two looks whether a pushed object has left the path free: each plans two paths."""
_ROUND_MARGIN = 0.10
"""What a way round keeps from the object beside the robot's radius [m]: letting go moves it a little."""
_SHOWN = 40
"""Roll-outs of a planning stage that are kept for pictures."""


def rolled(push: PushState, pose: Float[np.ndarray, "3"]) -> bool:
    """Whether the object has moved so far that it gives way beyond doubt: a cart that rolls ahead of the hands gives
    little contact, but its motion tells as much."""
    return push.moved(pose) > _ROLLED


def judge(setup: Setup, state: NavigatorState, obs: Observation) -> NavigatorState:
    """End a push that is over, stuck or lost, as far as that takes no planning to see."""
    segment, known, now = state.current(), state.known(), float(obs.time[0])
    push, index, pushing = segment.push, segment.object, state.mode is Mode.PUSH
    assert push is not None

    def leave(reason: str) -> NavigatorState:
        return state.go(now, Mode.RETREAT, reason)

    if not push.ok:
        return leave("no roll-out of the model is finite: safe stop")
    if known.age > UNDETECTED_LIMIT:
        return leave(f"object {index} has not been detected for {UNDETECTED_LIMIT:g} s")
    # Where expected times decide, the goal is a direction: the push ends once the path is clear, or does not pay.
    to_goal = pushing and setup.foresight is None
    if to_goal and float(np.linalg.norm(known.pose[:2] - segment.goal[:2])) < _AT_GOAL:
        state = state.with_object(index, status=Status.PARKED)
        return leave(f"object {index} is at its goal")
    if to_goal and _left(segment.goal, known.pose, segment.face) < _PASSED:
        return leave(f"object {index} has gone past its goal, and can't be pulled")
    if push.since_contact > _LOST_AFTER:
        return leave(f"contact with object {index} lost for {_LOST_AFTER:g} s")
    if pushing and _stalled(push) and not _begins_anew(segment, now):
        return _stuck(setup, state, now, f"object {index} moved less than {_STALL[0]:g} m in {_STALL[1]:g} s")
    if now - push.started > _PUSH_LIMIT:
        return leave(f"object {index} has been pushed for {_PUSH_LIMIT:g} s")
    return state


def _stalled(push: PushState) -> bool:
    travelled = push.travelled(_STALL[1])
    return travelled is not None and travelled < _STALL[0]


def _left(
    goal: Float[np.ndarray, "*g 3"], pose: Float[np.ndarray, "3"], face: Float[np.ndarray, "4"]
) -> Float[np.ndarray, "*g"]:
    """Way left to ``goal`` along the push [m]."""
    ahead = heading(pose, face)
    return np.asarray((goal[..., :2] - pose[:2]) @ np.array([np.cos(ahead), np.sin(ahead)]))


def review(setup: Setup, state: NavigatorState, obs: Observation) -> NavigatorState | None:
    """Look whether the path is clear, or hold the planning stage of Algorithm 1, where either is due."""
    now, push = float(obs.time[0]), state.current().push
    assert push is not None
    moves_on = state.mode is Mode.PUSH or push.contact_time > setup.config.decide_after
    looks = moves_on and round(now / DT) % _CLEAR_EVERY == 0
    if looks and setup.routes(state).path_clear(obs.robot_pose[0, :2], state.known()):
        index = state.current().object
        state = state.with_object(index, status=Status.PARKED)
        return state.go(now, Mode.RETREAT, f"object {index} no longer blocks the path")
    if foresight := setup.foresight:
        due = push.contact_time >= state.current().reviewed + PROBE_TIME
        return _think_again(setup, foresight, state, obs, push) if due else None
    if not _due(setup, state, push):
        return None
    return _planning_stage(setup, state, obs, push)


def _think_again(
    setup: Setup, foresight: Foresight, state: NavigatorState, obs: Observation, push: PushState
) -> NavigatorState:
    """Go on with this push, or leave it for a way round or another face, whichever takes less time on average."""
    now, segment, known = float(obs.time[0]), state.current(), state.known()
    state, routes, position = state.with_segment(reviewed=push.contact_time), setup.routes(state), obs.robot_pose[0, :2]
    through = routes.free_path(position, known)
    if through is None:
        return state
    field = state.belief.clearance(without=segment.object)
    (here,) = decide.pushes(
        foresight, known, through, field, [segment.side], {segment.side: segment.goal}, round(now / DT)
    )
    detour = routes.free_path(position, known, known.polygon.buffer(_ROUND_MARGIN)) if setup.config.goes_round else None
    around = decide.BLOCKED if detour is None else decide.AWAY + detour.length / decide.PACE
    here.seconds = decide.expected(here, 0.0, through.length / decide.PACE, around)
    told = f"{here.told}; {decide.round_told(None if detour is None else around)}"
    state = state.with_events(
        Decision(
            now, segment.object, np.nan, np.nan, here.probability >= 0.5, here.goal, told, here.ends[:_SHOWN],
            here.goal[None], segment.goal, here.probability,
        )
    )  # fmt: skip
    if detour is not None and around < here.seconds:
        state = state.with_object(segment.object, status=Status.PARKED)
        return state.go(now, Mode.RETREAT, f"object {segment.object}: {told}")
    if here.probability > 0.0:
        state = state.with_segment(goal=here.goal)
    if state.mode is Mode.PROBE:
        state = state.go(now, Mode.PUSH, f"object {segment.object}: {told}")
    return state


def _due(setup: Setup, state: NavigatorState, push: PushState) -> bool:
    """Whether a planning stage is due: in a probe the one with the verdict, in a push one every so often."""
    if state.mode is Mode.PUSH:
        return push.contact_time >= state.current().reviewed + _REVIEW_EVERY
    cfg, pose = setup.config, state.known().pose
    if _stalled(push):
        return True
    if push.contact_time < PROBE_TIME and not rolled(push, pose):
        return False
    if cfg.decides_by == "K":
        return True
    p, late = _probability(push, pose), push.contact_time >= cfg.decide_after
    if p < 0.5:
        return p < _worth_trying(state.current()) and (late or p < 1.0 - cfg.sure)
    return late or p > cfg.sure


def _worth_trying(segment: Segment) -> float:
    """Probability from which to push on takes less time, on average, than to go round: down to 0 where there is no way
    round, so that nothing but a stall ends the probe."""
    return min(0.5, _STALL[1] / (_STALL[1] + segment.detour / _PACE))


def _probability(push: PushState, pose: Float[np.ndarray, "3"]) -> float:
    return mobility.probability(push.moved(pose), push.impulse)


def _planning_stage(setup: Setup, state: NavigatorState, obs: Observation, push: PushState) -> NavigatorState:
    """The planning stage of Algorithm 1 on the roll-outs of the adapted model."""
    now, segment, known = float(obs.time[0]), state.current(), state.known()
    state = state.with_segment(reviewed=push.contact_time)
    asked = _asked(setup, state)
    half = np.array(known.half_extents)
    poses, _, costs = setup.controller.planning_rollouts(push.pusher, asked, segment.around, half)
    routes, position = setup.routes(state), obs.robot_pose[0, :2]
    path = routes.free_path(position, known)
    if path is not None and state.mode is Mode.PROBE:
        state = state.with_events(Planned(now, path.points))
    free = routes.collision_free(position, known, state.belief.clearance(without=segment.object), path)

    def reachable(ends: Float[np.ndarray, "N 3"]) -> Bool[np.ndarray, "N"]:
        # What a roll-out turns may end a little behind, and a goal there would be passed before it is pushed to.
        return free(ends) & (_left(ends, known.pose, segment.face) > 0.0)

    # What a push moves has been judged: walls that leave its roll-outs no way on don't make it immovable.
    p = _probability(push, known.pose)
    by_k = setup.config.decides_by == "K" and state.mode is Mode.PROBE
    moves = None if by_k else state.mode is Mode.PUSH or p >= 0.5
    result = planning_stage(poses[:, -1], costs, known.pose, reachable, setup.config.planner, moves)
    if not by_k:
        way = f"it has moved {push.moved(known.pose):.2f} m for {push.impulse:.0f} N s: P = {p:.2f}"
        result = result._replace(reason=f"{way}; {result.reason}")
    best = poses[np.argsort(costs)[:_SHOWN]][:, :, :2]
    state = state.with_events(
        Decision(
            now, segment.object, result.K, result.G, result.manipulable, result.goal, result.reason, best,
            result.candidates, asked, p,
        )
    )  # fmt: skip
    return _verdict(setup, state, now, result)


def _asked(setup: Setup, state: NavigatorState) -> Float[np.ndarray, "3"]:
    """Where the roll-outs are to bring the object. K asks how far it can be moved: a goal that is nearly reached, or
    already behind the object, would say nothing about that, so a place ahead takes its part."""
    segment, pose = state.current(), state.known().pose
    if _left(segment.goal, pose, segment.face) >= setup.config.planner.min_displacement:
        return segment.goal
    return _straight_ahead(setup, segment, pose)


def _straight_ahead(setup: Setup, segment: Segment, pose: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
    ahead, reach = heading(pose, segment.face), setup.config.planner.min_displacement
    return np.array([*(pose[:2] + reach * np.array([np.cos(ahead), np.sin(ahead)])), segment.goal[2]])


def _begins_anew(segment: Segment, now: float) -> bool:
    """Whether it is too early to judge a push straight ahead."""
    return segment.straight_from is not None and now < segment.straight_from + _STALL[1]


def _verdict(setup: Setup, state: NavigatorState, now: float, result: ObjectDecision) -> NavigatorState:
    index = state.current().object
    state = state.with_object(index, manipulable=result.manipulable)
    if not result.manipulable:
        return _stuck(setup, state, now, f"object {index} is not manipulable: {result.reason}")
    if result.goal is not None and state.current().straight_from is None:
        state = state.with_segment(goal=result.goal)
    if state.mode is Mode.PROBE:
        state = state.go(now, Mode.PUSH, f"object {index} is manipulable: {result.reason}")
    return state


def _stuck(setup: Setup, state: NavigatorState, now: float, why: str) -> NavigatorState:
    """What to do about a push that leads no further.

    What has been called manipulable is pushed straight ahead once: on the way to its goal it may have to turn where
    there is no room for that. If this does not help the push ends. Only what no push has moved counts as immovable;
    what has given way before is left where it is, and tried on another face where the way round is long enough."""
    segment, known = state.current(), state.known()
    assert segment.push is not None
    if state.mode is Mode.PUSH and segment.straight_from is None:
        state = state.with_segment(goal=_straight_ahead(setup, segment, known.pose), straight_from=now)
        return state.with_events(Note(now, f"{why}; pushes it straight ahead"))
    moved = segment.push.moved(known.pose)
    if moved >= _MOVED:
        state = state.with_object(segment.object, status=Status.PARKED)
        return state.go(now, Mode.RETREAT, f"{why}; but it has been moved {moved:.2f} m, and is left where it is")
    if not setup.config.goes_round:
        return state.go(now, Mode.RETREAT, f"{why}; tried again, since going round is not allowed")
    state = state.with_object(segment.object, failed_faces=(*known.failed_faces, segment.side))
    if known.gave_way:
        state = state.with_object(segment.object, status=Status.PARKED)
        return state.go(now, Mode.RETREAT, f"{why}; but it has given way before, and is left where it is")
    state = state.with_object(
        segment.object, status=Status.FIXED, manipulable=False, registered=known.pose, fixed_at=now
    )
    return state.go(now, Mode.RETREAT, f"{why}; registered as an obstacle")
