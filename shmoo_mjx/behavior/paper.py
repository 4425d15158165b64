"""Algorithm 1 as the paper prints it, as a baseline for decisions by expected time.

It pushes an object in the path to the nearest free place, and takes a detour if K says that the object cannot be moved.
There are three additions: faces must be reachable, first goals lie in a cone around a face's push direction, and an
object whose push stalls counts as immovable.
"""

from __future__ import annotations

import numpy as np

from shmoo_mjx.arrays import Bool, Float
from shmoo_mjx.behavior.belief import Status
from shmoo_mjx.behavior.interaction import start_push
from shmoo_mjx.behavior.skills.push import RolloutPlanner
from shmoo_mjx.behavior.state import Decision, Mode, NavigatorState, Planned, Setup
from shmoo_mjx.geometry.faces import faces_of, heading
from shmoo_mjx.planning.object_planner import initial_goal, planning_stage
from shmoo_mjx.types import Observation

_FAR_AREA = 5.0
"""Side of the square for first goals if the planner's own square contains none, for example in a corridor [m]."""
_AT_GOAL = 0.10
"""Distance from its goal at which an object has arrived [m]."""
_PASSED = -0.08
"""Remaining distance to the goal along the push at which the object has passed it [m]."""
_SHOWN = 40
"""Number of roll-outs of a planning stage that are kept for display."""


def choose(setup: Setup, state: NavigatorState, obs: Observation, index: int, *, distance: float) -> NavigatorState:
    """Initialisation stage: chooses first goal, face and path to the stand-off pose, or registers the object.

    Object ``index`` blocks the path ``distance`` [m] ahead.
    """
    target, now, routes = state.belief.objects[index], float(obs.time[0]), setup.routes(state)
    position, clearance = obs.robot_pose[0, :2], state.belief.clearance()
    faces, failed = faces_of(target.half_extents), target.failed_faces
    ways = {i: routes.path_to_face(position, index, f, clearance) for i, f in enumerate(faces) if i not in failed}
    usable = {i: way for i, way in ways.items() if way is not None}
    clearance_without, path = state.belief.clearance(without=index), routes.free_path(position, target)
    free = routes.collision_free(position, target, clearance_without, path)
    directions, planner = np.array([heading(target.pose, faces[i]) for i in usable]), setup.config.planner
    first = initial_goal(target.pose, free, directions, planner)
    first = initial_goal(target.pose, free, directions, planner, area=_FAR_AREA) if first.goal is None else first
    if first.goal is None or first.direction is None:
        why = f"object {index} can be put nowhere: {first.reason}; registered as an obstacle"
        return state.given_up(index).go(now, Mode.REPLAN, why)
    side = list(usable)[first.direction]
    state = start_push(state, now, index, side=side, goal=first.goal, reached=usable[side])
    why = f"object {index} blocks the path {distance:.2f} m ahead; first goal: {first.reason}"
    return state.go(now, Mode.APPROACH, why)


def planning(setup: Setup, state: NavigatorState, obs: Observation) -> NavigatorState:
    """Planning stage on roll-outs of the adapted model: K during the probe, and a reachable goal."""
    now, segment, target = float(obs.time[0]), state.current(), state.target()
    assert segment.push is not None and isinstance(setup.controller, RolloutPlanner)
    index, cfg, probes = segment.object, setup.config.planner, state.mode is Mode.PROBE
    # Near the goal K is uninformative, so it is evaluated for a point ``min_displacement`` ahead of the object.
    ahead = heading(target.pose, segment.face)
    straight = target.pose[:2] + cfg.min_displacement * np.array([np.cos(ahead), np.sin(ahead)])
    near = _left(segment.goal, target.pose, segment.face) < cfg.min_displacement
    probe_goal = np.array([*straight, segment.goal[2]]) if near else segment.goal
    half = np.array(target.half_extents)
    poses, _, costs = setup.controller.planning_rollouts(segment.push.pusher, probe_goal, segment.clearance, half)
    routes, position = setup.routes(state), obs.robot_pose[0, :2]
    path = routes.free_path(position, target)
    if path is not None and probes:
        state = state.with_events(Planned(now, path.points))
    free = routes.collision_free(position, target, state.belief.clearance(without=index), path)

    def reachable(ends: Float[np.ndarray, "N 3"]) -> Bool[np.ndarray, "N"]:
        # A roll-out that turns the object may end slightly behind it. Such a goal would count as passed at once.
        return free(ends) & (_left(ends, target.pose, segment.face) > 0.0)

    result = planning_stage(poses[:, -1], costs, target.pose, reachable, cfg=cfg, manipulable=None if probes else True)
    best = poses[np.argsort(costs)[:_SHOWN]][:, :, :2]
    event = Decision(
        now, index, result.K, result.G, result.manipulable, result.goal, result.reason, best, result.candidates, None
    )
    state = state.with_events(event).with_object(index, manipulable=result.manipulable)
    if not result.manipulable:
        return immovable(state, now, f"object {index} is not manipulable: {result.reason}")
    if result.goal is not None:
        state = state.with_segment(goal=result.goal)
    return state.go(now, Mode.PUSH, f"object {index} is manipulable: {result.reason}") if probes else state


def arrived(state: NavigatorState, now: float) -> NavigatorState:
    """Ends a push whose object is at its goal or has passed it."""
    segment, target, index = state.current(), state.target(), state.current().object
    if state.mode is Mode.PUSH and float(np.linalg.norm(target.pose[:2] - segment.goal[:2])) < _AT_GOAL:
        state = state.with_object(index, status=Status.PARKED)
        return state.go(now, Mode.RETREAT, f"object {index} is at its goal")
    if state.mode is Mode.PUSH and _left(segment.goal, target.pose, segment.face) < _PASSED:
        return state.failed().go(now, Mode.RETREAT, f"object {index} has gone past its goal, and can't be pulled")
    return state


def immovable(state: NavigatorState, now: float, why: str) -> NavigatorState:
    """Registers the pushed object as an obstacle."""
    state = state.failed().given_up(state.current().object)
    return state.go(now, Mode.RETREAT, f"{why}; registered as an obstacle")


def _left(
    goal: Float[np.ndarray, "*g 3"], pose: Float[np.ndarray, "3"], face: Float[np.ndarray, "4"]
) -> Float[np.ndarray, "*g"]:
    """Remaining distance to ``goal`` along the push [m]."""
    ahead = heading(pose, face)
    return np.asarray((goal[..., :2] - pose[:2]) @ np.array([np.cos(ahead), np.sin(ahead)]))
