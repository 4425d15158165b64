"""Decisions on the way to the goal: which path, and whether to bypass an object in it or to push it, and from where.

Each takes a state and an observation and gives the state in which the choice has been made.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import shapely

from shmoo_mjx.control.observation import local_distance_field
from shmoo_mjx.faces import corners_of, faces_of, heading
from shmoo_mjx.navigation import decide, drive
from shmoo_mjx.navigation.belief import Status
from shmoo_mjx.navigation.object_planner import InitialGoal, initial_goal
from shmoo_mjx.navigation.paths import Path, path_blocked_by, project
from shmoo_mjx.navigation.records import Mode, NavigatorState, Note, Planned, Segment, Setup
from shmoo_mjx.navigation.scenario import ROBOT_RADIUS
from shmoo_mjx.planning.reach import Foresight
from shmoo_mjx.skills import approach
from shmoo_mjx.types import DT, Observation

_FAR_AREA = 5.0
"""Side of the square in which first goals are sought where the planner's own holds none, as in a corridor [m]."""
_PATIENCE = 4.0
"""How long it waits where every route is blocked before it gives up: what rolls comes to rest, others walk on [s]."""
_ASK_AGAIN = 1.0
"""Time between two looks meanwhile [s]."""
_SLACK = 0.03
"""By how much an object may come nearer to the path than the robot's radius before it blocks it [m]."""
_LEFT_AFTER = 2 * ROBOT_RADIUS
"""Distance along the path after which it keeps the robot's radius from what the robot stood too near to [m]."""
_FAILED_FACE = 5.0
"""Way round that is taken rather than another face, for each push that has failed [m]: it takes some 10 s."""
_ACT_WITHIN = 2.2
"""Distance along the path within which an object in the way is dealt with [m]: room to brake and for a stand-off
pose."""


def replan(setup: Setup, state: NavigatorState, obs: Observation) -> NavigatorState | None:
    """A path to the goal round everything that is not to be pushed; without one, wait and then give up."""
    now = float(obs.time[0])
    if state.waits_from is not None and now - state.since < _ASK_AGAIN:
        return None
    if state.segment is not None:
        index = state.segment.object
        state = replace(state.with_object(index, registered=state.belief.objects[index].pose), segment=None)
    state = _take_up_again(setup, state, obs)
    path = _to_goal(setup, state, obs)
    if path is None:
        state, again = _another_chance(setup, state, obs)
        path = _to_goal(setup, state, obs) if again else None
    if path is not None:
        state = _on_path(replace(state, gone_round=frozenset(), waits_from=None), now, path)
        return state.go(now, Mode.FOLLOW, f"path of {path.length:.2f} m found")
    begun = now if state.waits_from is None else state.waits_from
    if now - begun >= _PATIENCE:
        why = "every route to the goal is blocked by walls and objects that can't be moved"
        return state.go(now, Mode.FAILED, why)
    if state.waits_from is None:
        state = state.with_events(Note(now, "every route to the goal is blocked; waits a little and looks again"))
    return replace(state, waits_from=begun, since=now)


def _to_goal(setup: Setup, state: NavigatorState, obs: Observation) -> Path | None:
    return setup.routes(state).plan(obs.robot_pose[0, :2], state.belief.avoided())


def _on_path(state: NavigatorState, now: float, path: Path) -> NavigatorState:
    return replace(state, path=path, drive=drive.init()).with_events(Planned(now, path.points))


def _take_up_again(setup: Setup, state: NavigatorState, obs: Observation) -> NavigatorState:
    """A parked object that still costs a long way round may be pushed again, unless it has been too often."""
    cfg, parked = setup.config, [i for i, o in state.belief.objects.items() if o.status is Status.PARKED]
    if not parked:
        return state
    routes, position = setup.routes(state), obs.robot_pose[0, :2]
    around = routes.plan(position, state.belief.avoided())
    through = routes.plan(position, state.belief.polygons((Status.FIXED,)))
    if through is None:
        return state
    longer = np.inf if around is None else around.length - through.length
    for index in parked:
        known = state.belief.objects[index]
        worth = longer >= setup.detour + _FAILED_FACE * len(known.failed_faces) and known.pushes < cfg.max_pushes
        if worth and path_blocked_by(through, known.polygon, ROBOT_RADIUS)[0]:
            state = state.with_object(index, status=Status.UNKNOWN)
    return state


def _another_chance(setup: Setup, state: NavigatorState, obs: Observation) -> tuple[NavigatorState, bool]:
    """With every route blocked, each registered object is tried again, with nothing learned of it but which faces have
    failed, that with the fewest chances first.

    Not in the moment in which it was registered: what was out of reach then would be so still.
    """
    cfg, now, objects = setup.config, float(obs.time[0]), state.belief.objects
    tried = [(i, o) for i, o in objects.items() if o.status is not Status.UNKNOWN and o.chances < cfg.chances]
    rested = [i for i, o in tried if now - o.fixed_at > 1.0]
    if not rested:
        return state, False
    others = [o.polygon for i, o in objects.items() if i not in rested]
    through = setup.routes(state).plan(obs.robot_pose[0, :2], others)
    for index in sorted(rested, key=lambda i: objects[i].chances):
        known = objects[index]
        if through is not None and path_blocked_by(through, known.polygon, ROBOT_RADIUS)[0]:
            pushes = min(known.pushes, cfg.max_pushes - 1)
            state = state.with_object(
                index, status=Status.UNKNOWN, chances=known.chances + 1, adapt=None, pushes=pushes
            )
            text = f"every route is blocked: object {index}, registered as an obstacle, is tried again"
            return state.with_events(Note(now, text)), True
    return state, False


def first_block(setup: Setup, state: NavigatorState, obs: Observation) -> tuple[int, float] | None:
    """The known object that blocks the path first, and how far along the path [m].

    What the robot stands too near to, as after a push, does not block the beginning of a path that leads away from it.
    """
    assert state.path is not None
    position, found = obs.robot_pose[0, :2], []
    here = project(state.path, position)
    for index, known in state.belief.objects.items():
        nearest = float(shapely.distance(known.polygon, shapely.Point(position)))
        for clearance, after in ((min(nearest, ROBOT_RADIUS), here), (ROBOT_RADIUS, here + _LEFT_AFTER)):
            blocked, s = path_blocked_by(state.path, known.polygon, clearance - _SLACK, after)
            if blocked and s is not None and s - here < _ACT_WITHIN:
                found.append((s - here, index))
    return (min(found)[1], min(found)[0]) if found else None


def look_ahead(setup: Setup, state: NavigatorState, obs: Observation) -> NavigatorState | None:
    """Decision on an object that blocks the path: bypass it, push it, or replan; None if the path is free."""
    blocked = first_block(setup, state, obs)
    if blocked is None or state.path is None:
        return None
    (index, distance), now, cfg = blocked, float(obs.time[0]), setup.config
    known, position = state.belief.objects[index], obs.robot_pose[0, :2]
    if known.status is not Status.UNKNOWN:
        again = state.with_object(index, in_the_way=known.in_the_way + 1)
        return again.go(now, Mode.REPLAN, f"object {index} ({known.status}) is in the way")
    remaining = state.path.length - project(state.path, position)
    # Not through another one that this path goes round already: it would turn from one to the other for ever.
    gone_round = [state.belief.objects[i].polygon for i in state.gone_round | {index}]
    detour = setup.routes(state).plan(position, [*state.belief.avoided(), *gone_round])
    longer = np.inf if detour is None else detour.length - remaining
    if cfg.goes_round and detour is not None and longer < setup.detour:
        state = _on_path(replace(state, gone_round=state.gone_round | {index}), now, detour)
        return state.go(now, Mode.FOLLOW, f"object {index} is in the way; going round it costs {longer:+.2f} m")
    if foresight := setup.foresight:
        return _least_time(setup, foresight, state, obs, index, remaining, detour)
    cost = "there is no way round" if detour is None else f"the way round is {longer:.2f} m longer"
    why = f"object {index} blocks the path {distance:.2f} m ahead and {cost}"
    return _start_push(setup, state, obs, index, why, distance, longer)


def _start_push(
    setup: Setup, state: NavigatorState, obs: Observation, index: int, why: str, distance: float, detour: float
) -> NavigatorState:
    """Choose goal, face and way to the stand-off pose, or give the object up; ``distance`` [m] is that along the path,
    ``detour`` as in `Segment`."""
    # Walking to a face is worth while only if that and the rest of the path are shorter than the way round.
    longest = distance + detour if setup.config.goes_round else np.inf
    known, now, routes = state.belief.objects[index], float(obs.time[0]), setup.routes(state)
    if known.pushes >= setup.config.max_pushes:
        text = f"object {index} has been pushed {known.pushes} times without clearing the path"
        return _give_up(setup, state, obs, index, text)
    position, everything, failed = obs.robot_pose[0, :2], state.belief.clearance(), known.failed_faces.count
    sides, corners = faces_of(known.half_extents), corners_of(known.half_extents)
    faces, first_corner = np.concatenate([sides, corners]), len(sides)

    def reached(those: range) -> dict[int, tuple[Path, float, float]]:
        ways = {
            i: routes.path_to_face(position, index, faces[i], everything, failed(i), corner=i >= first_corner)
            for i in those
        }
        return {i: way for i, way in ways.items() if way is not None and way[0].length < longest}

    usable = reached(range(first_corner))
    if all(failed(i) for i in usable):  # where none of the sides helps, or can be reached, a corner may
        usable |= reached(range(first_corner, len(faces)))
    if not usable:
        return _give_up(setup, state, obs, index, f"no face of object {index} can be reached on a way worth taking")
    fewest = min(failed(i) for i in usable)
    if fewest > known.chances:
        text = f"object {index} could not be moved from any face that can be reached"
        return _give_up(setup, state, obs, index, text)
    usable = {i: way for i, way in usable.items() if failed(i) == fewest}
    around = state.belief.clearance(without=index)
    first = _first_goal(setup, state, obs, index, [heading(known.pose, faces[i]) for i in usable])
    if first.goal is None or first.direction is None:
        return _give_up(setup, state, obs, index, f"object {index} can be put nowhere: {first.reason}")
    side = list(usable)[first.direction]
    way, *place = usable[side]
    field = local_distance_field(around, known.pose)
    segment = Segment(index, side, faces[side], first.goal, way, approach.init(now, *place), field, detour)
    state = replace(state, segment=segment, drive=drive.init())
    state = state.with_object(index, pushes=known.pushes + 1, registered=known.pose)
    where = "; at a corner, since no side helps" if side >= first_corner else ""
    return state.go(now, Mode.APPROACH, f"{why}{where}; first goal: {first.reason}")


def _least_time(
    setup: Setup,
    foresight: Foresight,
    state: NavigatorState,
    obs: Observation,
    index: int,
    remaining: float,
    detour: Path | None,
) -> NavigatorState:
    """Go round object ``index`` or push it, whichever takes less time on average; ``remaining`` [m] is the length of
    the path through it."""
    now, known, routes = float(obs.time[0]), state.belief.objects[index], setup.routes(state)
    position, everything = obs.robot_pose[0, :2], state.belief.clearance()
    around = decide.BLOCKED if detour is None or not setup.config.goes_round else detour.length / decide.PACE
    if known.pushes >= setup.config.max_pushes:
        text = f"object {index} has been pushed {known.pushes} times without clearing the path"
        return _give_up(setup, state, obs, index, text)
    faces, failed = decide.faces_about(known.half_extents), known.failed_faces.count
    ways = {}
    for side, face in enumerate(faces):
        reached = routes.path_to_face(position, index, face, everything, failed(side), corner=side >= 4)
        if reached is not None and failed(side) <= known.chances and reached[0].length / decide.PACE < around:
            ways[side] = reached
    through = routes.free_path(position, known)
    if not ways or through is None:
        return _instead(setup, state, obs, index, detour, f"no face of object {index} can be reached")
    field = state.belief.clearance(without=index)
    free, near = routes.collision_free(position, known, field, through), setup.config.planner
    first = {
        side: initial_goal(known.pose, free, np.array([heading(known.pose, faces[side])]), near).goal for side in ways
    }
    places = {side: goal for side, goal in first.items() if goal is not None}
    found = decide.pushes(foresight, known, through, field, list(ways), places, round(now / DT))
    rest = remaining / decide.PACE
    for push in found:
        push.seconds = decide.expected(push, decide.walk(ways[push.side][0].length), rest, around)
    best = min(found, key=lambda push: push.seconds)
    options = ", ".join(p.told for p in sorted(found, key=lambda push: push.seconds)[:3])
    told = f"{options}; {decide.round_told(None if detour is None else around)}"
    if around <= best.seconds and detour is not None and setup.config.goes_round:
        return _instead(setup, state, obs, index, detour, told)
    way, *place = ways[best.side]
    local = local_distance_field(field, known.pose)
    longer = np.inf if detour is None else detour.length - remaining
    begun = approach.init(now, *place)
    segment = Segment(index, best.side, faces[best.side], best.goal, way, begun, local, longer)
    state = replace(state, segment=segment, drive=drive.init())
    state = state.with_object(index, pushes=known.pushes + 1, registered=known.pose)
    return state.go(now, Mode.APPROACH, f"object {index} is in the way: {told}")


def _instead(
    setup: Setup, state: NavigatorState, obs: Observation, index: int, detour: Path | None, why: str
) -> NavigatorState:
    """Go round object ``index``, or give it up where there is no way round."""
    if detour is None or not setup.config.goes_round:
        return _give_up(setup, state, obs, index, why)
    now = float(obs.time[0])
    state = _on_path(replace(state, gone_round=state.gone_round | {index}), now, detour)
    return state.go(now, Mode.FOLLOW, f"object {index} is in the way: {why}")


def _first_goal(
    setup: Setup, state: NavigatorState, obs: Observation, index: int, directions: list[float]
) -> InitialGoal:
    """The initialisation stage of Algorithm 1."""
    routes, known, position = setup.routes(state), state.belief.objects[index], obs.robot_pose[0, :2]
    around = state.belief.clearance(without=index)
    free = routes.collision_free(position, known, around, routes.free_path(position, known))
    near = setup.config.planner
    first = initial_goal(known.pose, free, np.array(directions), near)
    if first.goal is not None:
        return first
    return initial_goal(known.pose, free, np.array(directions), near, _FAR_AREA)


def _give_up(setup: Setup, state: NavigatorState, obs: Observation, index: int, why: str) -> NavigatorState:
    now = float(obs.time[0])
    if not setup.config.goes_round:
        return state.go(now, Mode.FAILED, f"{why}, and going round is not allowed")
    state = state.with_object(index, status=Status.FIXED, registered=state.belief.objects[index].pose, fixed_at=now)
    return state.go(now, Mode.REPLAN, f"{why}; registered as an obstacle")
