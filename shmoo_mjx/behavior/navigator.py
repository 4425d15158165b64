"""Interactive navigation (Sec. IV): follow the path, push objects out of the way, avoid immovable ones.

The navigator observes poses and sizes of objects and the force on its hands. It learns an object's dynamics from
contact only. `interaction` contains the pushes; this module contains the driving between them.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import jax
import numpy as np

from shmoo_mjx.arrays import Array, Float, Numbers
from shmoo_mjx.behavior import drive, interaction
from shmoo_mjx.behavior.belief import Status, belief_of
from shmoo_mjx.behavior.interaction import Machine, Rule, nothing, place_of, setup_of
from shmoo_mjx.behavior.path_decisions import look_ahead, replan
from shmoo_mjx.behavior.push_decisions import judge, review
from shmoo_mjx.behavior.skills import hold
from shmoo_mjx.behavior.skills.push import Pusher
from shmoo_mjx.behavior.state import Event, Mode, NavigatorConfig, NavigatorState, Setup
from shmoo_mjx.planning.maps import OccupancyGrid
from shmoo_mjx.planning.scenario import ROBOT_RADIUS
from shmoo_mjx.types import Command, Observation

_NO_TRAJECTORY = 3.0
"""Time without a local trajectory after which another path is planned [s]."""
_TURNING_ROOM = 0.05
"""Clearance beyond the robot's radius at which it may turn while driving [m]. Its elbows sweep a circle."""


def init(grid: OccupancyGrid, goal: Numbers | Float[Array, "2"], seed: int = 0) -> NavigatorState:
    """Initial state, in which only the map is known; the goal is in {W} [m]."""
    return NavigatorState(place_of(goal), belief_of(grid), jax.random.key(seed))


# Actions of the modes.


def _brake(setup: Setup, state: NavigatorState, obs: Observation) -> tuple[NavigatorState, Command]:
    """While a path is being planned: follow the current trajectory to its end, where the robot rests."""
    if state.drive.trajectory is None:
        return interaction.rest(setup, state, obs)
    state, lean = interaction.drive_along(setup, state, obs, None)
    return state, Command(np.append(lean, 0.0), obs.robot_pose[0, 2], *interaction.arms(state, obs))


def _turned(state: NavigatorState, obs: Observation, yaw: float) -> float:
    """The heading ``yaw``, or the current one where walls leave no room to turn."""
    room = float(state.belief.wall_clearance.at(obs.robot_pose[0, :2])) - ROBOT_RADIUS
    return yaw if room > _TURNING_ROOM else float(obs.robot_pose[0, 2])


def _follow(setup: Setup, state: NavigatorState, obs: Observation) -> tuple[NavigatorState, Command]:
    now, position, cfg = float(obs.time[0]), obs.robot_pose[0, :2], setup.config
    left, speed = float(np.linalg.norm(position - state.goal)), float(np.linalg.norm(obs.robot_twist[0, :2]))
    if left < cfg.goal_tolerance and speed < 0.1:
        return state.go(now, Mode.DONE, f"goal reached to {left:.2f} m"), hold(interaction.robot_alone(obs))
    path = state.path
    assert path is not None
    state, lean = interaction.drive_along(setup, state, obs, path)
    since = state.drive.failed_since
    if since is not None and now - since > _NO_TRAJECTORY:
        state = state.go(now, Mode.REPLAN, f"no local trajectory for {_NO_TRAJECTORY:g} s: {state.drive.reason}")
    yaw = _turned(state, obs, drive.yaw_ahead(obs, path))
    return state, Command(np.append(lean, 0.0), yaw, *interaction.arms(state, obs))


MODES: dict[Mode, Rule] = {
    Mode.REPLAN: Rule(_brake, replan, (Mode.FOLLOW, Mode.FAILED)),
    Mode.FOLLOW: Rule(_follow, look_ahead, (Mode.FOLLOW, Mode.APPROACH, Mode.REPLAN, Mode.DONE, Mode.FAILED)),
    Mode.APPROACH: Rule(interaction.approach_face, nothing, (Mode.CONTACT, Mode.REPLAN)),
    Mode.CONTACT: Rule(partial(interaction.make_contact, Mode.PROBE), nothing, (Mode.PROBE, Mode.REPLAN, Mode.RETREAT)),
    Mode.PROBE: Rule(partial(interaction.push_object, judge), review, (Mode.PUSH, Mode.RETREAT)),
    Mode.PUSH: Rule(partial(interaction.push_object, judge), review, (Mode.RETREAT,)),
    Mode.RETREAT: Rule(interaction.back_away, nothing, (Mode.REPLAN,)),
    Mode.DONE: Rule(interaction.rest, nothing, ()),
    Mode.FAILED: Rule(interaction.rest, nothing, ()),
}
"""The transition table. A test checks runs against it."""


def step(setup: Setup, state: NavigatorState, obs: Observation) -> tuple[NavigatorState, Command, tuple[Event, ...]]:
    """One sample: the next state, the command (a batch of one) and the events."""
    return interaction.step(MODES, setup, state, obs)


class Navigator(Machine):
    """The state machine that brings the robot to a goal. ``tick`` runs one sample."""

    def __init__(
        self,
        grid: OccupancyGrid,
        goal: Numbers | Float[Array, "2"],
        sizes: Sequence[tuple[float, float]],
        controller: Pusher,
        *,
        seed: int = 0,
        config: NavigatorConfig | None = None,
        first_status: Sequence[Status] | None = None,
        kinds: Sequence[str | None] | None = None,
    ) -> None:
        super().__init__(
            MODES, setup_of(sizes, controller, config, first_status=first_status, kinds=kinds), init(grid, goal, seed)
        )
