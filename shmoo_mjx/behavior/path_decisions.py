"""Decisions on the way to the goal: the path, and whether and from where to push an object that blocks it.

Each function takes a state and an observation and returns the state after the decision.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import shapely

from shmoo_mjx.arrays import Float
from shmoo_mjx.behavior import drive, paper, push_options
from shmoo_mjx.behavior.belief import Status
from shmoo_mjx.behavior.interaction import start_push
from shmoo_mjx.behavior.routes import SLACK, Route, Routes
from shmoo_mjx.behavior.state import Decision, Mode, NavigatorState, Note, Planned, Setup
from shmoo_mjx.geometry.faces import heading
from shmoo_mjx.planning.object_planner import initial_goal
from shmoo_mjx.planning.paths import Path, path_blocked_by, project
from shmoo_mjx.planning.reach import foresight_of
from shmoo_mjx.planning.scenario import ROBOT_RADIUS
from shmoo_mjx.types import DT, Observation

_PATIENCE = 4.0
"""Waiting time while every route is blocked, before the robot gives up [s]. Meanwhile rolling objects come to rest and
people walk on."""
_ASK_AGAIN = 1.0
"""Time between two attempts while waiting [s]."""
_LEFT_AFTER = 2 * ROBOT_RADIUS
"""Distance along the path after which an object that is too close to the robot now must keep the robot's radius [m]."""
_ACT_WITHIN = 2.2
"""Distance along the path within which the robot acts on an object [m]. It leaves room to brake and for a stand-off
pose."""


def replan(setup: Setup, state: NavigatorState, obs: Observation) -> NavigatorState | None:
    """Plans a path to the goal. If every route is blocked, the robot waits and then gives up."""
    now = float(obs.time[0])
    if state.waits_from is not None and now - state.since < _ASK_AGAIN:
        return None
    if state.segment is not None:
        index = state.segment.object
        state = replace(state.with_object(index, registered=state.belief.objects[index].pose), segment=None)
    way = setup.routes(state).quickest(position := obs.robot_pose[0, :2])
    if way is None:
        state = _another_chance(state, now)
        way = setup.routes(state).quickest(position)
    if way is not None:
        state = _on_path(replace(state, waits_from=None), now, way.path)
        return state.go(now, Mode.FOLLOW, f"path of {way.path.length:.2f} m found")
    waits_from = now if state.waits_from is None else state.waits_from
    if now - waits_from >= _PATIENCE:
        why = "every route to the goal is blocked by walls and objects that can't be moved"
        return state.go(now, Mode.FAILED, why)
    if state.waits_from is None:
        state = state.with_events(Note(now, "every route to the goal is blocked; waits a little and looks again"))
    return replace(state, waits_from=waits_from, since=now)


def _on_path(state: NavigatorState, now: float, path: Path) -> NavigatorState:
    return replace(state, path=path, drive=drive.init()).with_events(Planned(now, path.points))


def _another_chance(state: NavigatorState, now: float) -> NavigatorState:
    """If anything was pushed since, reconsiders objects that were registered as obstacles."""
    pushes = state.belief.pushes
    for index, item in state.belief.objects.items():
        if item.status is Status.FIXED and item.given_up is not None and item.given_up < pushes:
            state = state.with_object(index, status=Status.UNKNOWN)
            text = f"every route is blocked: object {index}, registered as an obstacle, is looked at again"
            state = state.with_events(Note(now, text))
    return state


def first_block(
    setup: Setup, state: NavigatorState, obs: Observation, within: float = np.inf
) -> tuple[int, float] | None:
    """The first known object that blocks the path, and its distance along the path [m], at most ``within``.

    An object that is already too close to the robot, as after a push, does not block the beginning of a path that leads
    away from it.
    """
    assert state.path is not None
    position, blocks = obs.robot_pose[0, :2], []
    here = project(state.path, position)
    for index, item in state.belief.objects.items():
        nearest = float(shapely.distance(item.polygon, shapely.Point(position)))
        for clearance, after in ((min(nearest, ROBOT_RADIUS), here), (ROBOT_RADIUS, here + _LEFT_AFTER)):
            blocked, s = path_blocked_by(state.path, item.polygon, clearance - SLACK, after)
            if blocked and s is not None and s - here < within:
                blocks.append((s - here, index))
    return (min(blocks)[1], min(blocks)[0]) if blocks else None


def look_ahead(setup: Setup, state: NavigatorState, obs: Observation) -> NavigatorState | None:
    """Decides about an object that blocks the path: detour, push or replan. None if the path is free."""
    blocked = first_block(setup, state, obs, np.inf if setup.by_time else _ACT_WITHIN)
    if blocked is None or state.path is None:
        return None
    (index, distance), now, position = blocked, float(obs.time[0]), obs.robot_pose[0, :2]
    target, near, routes = state.belief.objects[index], distance < _ACT_WITHIN, setup.routes(state)
    if target.status not in routes.pushed:
        again = state.with_object(index, in_the_way=target.in_the_way + 1)
        return again.go(now, Mode.REPLAN, f"object {index} ({target.status}) is in the way") if near else None
    if not setup.by_time:
        return paper.choose(setup, state, obs, index, distance=distance)
    if not near and target.price is not None:
        return None
    through, detour = routes.quickest(position, without=index), routes.quickest(position, {index: 0.0})
    if through is None:
        return state.go(now, Mode.REPLAN, f"object {index} is in the way, and nothing leads on behind it")
    if setup.config.goes_round == "never":
        detour = None
    return _least_time(setup, state, obs, index, through=through, detour=detour, near=near)


def _least_time(
    setup: Setup,
    state: NavigatorState,
    obs: Observation,
    index: int,
    *,
    through: Route,
    detour: Route | None,
    near: bool,
) -> NavigatorState:
    """Takes a detour around object ``index`` or pushes it, whichever has the lower expected time.

    If the object is not ``near``, no push is started.
    """
    now, target, routes = float(obs.time[0]), state.belief.objects[index], setup.routes(state)
    position, clearance = obs.robot_pose[0, :2], state.belief.clearance()
    dislike = routes.price or 0.0
    otherwise = push_options.time_without_push(through, detour)
    faces, failed = target.faces, target.failed_faces.count
    ways, may_pay = {}, detour is None or otherwise > through.seconds + push_options.LEAST + dislike
    for side, face in enumerate(faces if may_pay else ()):
        reached = routes.path_to_face(position, index, face, clearance, failed=failed(side), corner=side >= 4)
        if reached is not None and push_options.walk_time(reached[0].length) < otherwise:
            ways[side] = reached
    way_round = None if detour is None else detour.seconds
    best, summary = None, push_options.describe_options((), way_round)
    if ways:
        clearance_without = state.belief.clearance(without=index)
        places = _places(setup, routes, obs, index, through=through.path, faces={side: faces[side] for side in ways})
        pushes = push_options.predict_pushes(
            foresight_of(setup.controller),
            target,
            through.path,
            clearance=clearance_without,
            sides=list(ways),
            places=places,
            seed=round(now / DT),
        )
        walks = {side: push_options.walk_time(way[0].length) for side, way in ways.items()}
        rank = partial(push_options.rank_pushes, pushes, walks=walks, failed=target.failed_faces, rest=through.seconds)
        # The price assumes no other pushes. Otherwise each of two immovable objects would count as a detour around the
        # other.
        alone = routes.quickest(position, dict.fromkeys(state.belief.objects, 0.0))
        price = rank(otherwise=push_options.time_without_push(through, alone))[0].seconds - through.seconds
        options = rank(otherwise=otherwise)
        best, summary = options[0], push_options.describe_options(options[:3], way_round)
        decision = _decision(now, index, summary=summary, options=options, otherwise=otherwise)
        state = state.with_events(decision._replace(options=push_options.option_list(options, way_round)))
        state = state.with_object(index, price=max(price, 0.0))
        if near and price >= push_options.BLOCKED:
            return _give_up(setup, state, now, index, why=summary)
    if detour is not None and (best is None or best.seconds + dislike >= otherwise):
        state = _on_path(state.with_object(index, in_the_way=target.in_the_way + near), now, detour.path)
        return state.go(now, Mode.FOLLOW, f"object {index} is in the way: {summary}")
    if not near:
        return state if best else state.with_object(index, price=push_options.BLOCKED)
    if best is None:
        return _give_up(setup, state, now, index, why=f"no face can be reached; {summary}")
    state = start_push(state, now, index, side=best.side, goal=best.goal, reached=ways[best.side])
    return state.go(now, Mode.APPROACH, f"object {index} is in the way: {summary}")


def _places(
    setup: Setup,
    routes: Routes,
    obs: Observation,
    index: int,
    *,
    through: Path,
    faces: dict[int, Float[np.ndarray, "4"]],
) -> dict[int, Float[np.ndarray, "3"]]:
    """The first goal of Algorithm 1 for each side that has one."""
    target, clearance = routes.belief.objects[index], routes.belief.clearance(without=index)
    free = routes.collision_free(obs.robot_pose[0, :2], target, clearance, through)
    goals = {
        side: initial_goal(target.pose, free, np.array([heading(target.pose, face)]), setup.config.planner).goal
        for side, face in faces.items()
    }
    return {side: goal for side, goal in goals.items() if goal is not None}


def _decision(now: float, index: int, *, summary: str, options: list[push_options.Push], otherwise: float) -> Decision:
    """The decision before a push, with the predicted outcomes of the options."""
    best = options[0]
    pushed, goals = best.seconds < otherwise, np.stack([push.goal for push in options])
    ends = np.concatenate([push.ends for push in options])
    return Decision(now, index, np.nan, np.nan, pushed, best.goal, summary, ends, goals, best.probability)


def _give_up(setup: Setup, state: NavigatorState, now: float, index: int, *, why: str) -> NavigatorState:
    """Registers object ``index`` as an obstacle, or fails if detours are not allowed."""
    if setup.config.goes_round == "never":
        return state.go(now, Mode.FAILED, f"object {index}: {why}, and going round is not allowed")
    return state.given_up(index).go(now, Mode.REPLAN, f"object {index}: {why}; registered as an obstacle")
