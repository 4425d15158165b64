"""The push task: bring one object to a pose, from any start pose of the robot around it.

The robot chooses a face, drives to its stand-off pose, extends the arms, makes contact, and pushes with MPPI while the
coefficients a adapt. It releases the object in time to coast to its goal, backs away, and looks at the result. If the
object is not at its goal, another push follows, on another face if that helps: an object that has passed its goal is
pushed back from the other side.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import jax
import numpy as np

from shmoo_mjx.arrays import Array, Float, Numbers, finite_numbers
from shmoo_mjx.behavior import interaction
from shmoo_mjx.behavior.belief import belief_of
from shmoo_mjx.behavior.interaction import Machine, Rule, nothing, setup_of, start_push
from shmoo_mjx.behavior.push_options import SIDES
from shmoo_mjx.behavior.skills import hold, push
from shmoo_mjx.behavior.skills.push import Pusher
from shmoo_mjx.behavior.state import Decision, Mode, NavigatorConfig, NavigatorState, Setup
from shmoo_mjx.control.presets import pose_push_config
from shmoo_mjx.errors import ShmooError
from shmoo_mjx.geometry import se2
from shmoo_mjx.geometry.faces import faces_of
from shmoo_mjx.learning.online import LearnerState
from shmoo_mjx.planning.footprints import footprints_free
from shmoo_mjx.planning.maps import OccupancyGrid
from shmoo_mjx.planning.reach import contact_foresight
from shmoo_mjx.planning.search import choose_push, push_displacements, push_error, residual
from shmoo_mjx.types import DT, Command, Observation

_FRESH = 0.3
"""Age of a detection above which the robot first turns to the object to look at it [s]."""
_LONGEST_LOOK = 4.0
"""Maximum duration of that look [s]."""
_WALL_CLEARANCE = 0.06
"""Distance of the footprint from walls at the end of a push [m]. The pushing controller uses the same."""
AT_REST = 0.03
"""Speed below which the object counts as resting [m/s]: 3 mm per sample."""
_STALL = (0.03, 6.0)
"""A push has stalled if it reduces the error by less than this [m] in this time [s]."""
_NO_NEARER = 0.1
"""A stalled push that has reduced the error by less than this counts as a failure of its side [m]."""


@dataclass(frozen=True)
class PushTaskConfig:
    """Settings of the task, SI units."""

    arrived: float = 0.07
    """Position error below which the object is left where it is [m]. Smaller values need more pushes."""
    arrived_yaw: float = float(np.deg2rad(10.0))
    """Yaw error below which the object is left where it is [rad]. Smaller values need more pushes."""
    max_pushes: int = 6
    """Maximum number of pushes [1]. Larger values can correct more and take longer."""
    moves: NavigatorConfig = NavigatorConfig()
    """Settings for driving between faces."""


class PushTask(Machine):
    """The state machine that brings an object to a pose. ``tick`` runs one sample."""

    def __init__(
        self,
        grid: OccupancyGrid,
        sizes: list[tuple[float, float]],
        goal: Numbers | Float[Array, "3"],
        pusher: Pusher,
        *,
        index: int = 0,
        seed: int = 0,
        config: PushTaskConfig | None = None,
        adapt: LearnerState | None = None,
        kinds: Sequence[str | None] | None = None,
    ) -> None:
        """Sets up the task.

        Args:
            grid: the map.
            sizes: half extents of each object [m].
            goal: target pose (x, y, yaw) of the object in {W}.
            pusher: the pushing controller.
            index: index of the object to push.
            seed: seed of the controller's random numbers.
            config: settings.
            adapt: initial learner state; the prior if not given.
            kinds: recognised kind of each object: "box", "cart", "wheelchair", or None for other objects. It determines
                the prior. All None if not given.

        Raises:
            ShmooError: the goal is not three finite numbers, or there is no object ``index``.
        """
        if not 0 <= index < len(sizes):
            raise ShmooError(f"PushTask: there is no object {index}; sizes has {len(sizes)}, counted from 0.")
        self.settings = config or PushTaskConfig()
        self.goal = finite_numbers("PushTask: the goal", goal, "x, y, yaw")
        setup = setup_of(sizes, pusher, self.settings.moves, kinds=kinds)
        modes = {
            Mode.REPLAN: Rule(self._look, self._choose, (Mode.APPROACH, Mode.DONE, Mode.FAILED)),
            Mode.APPROACH: Rule(interaction.approach_face, nothing, (Mode.CONTACT, Mode.REPLAN)),
            Mode.CONTACT: Rule(
                partial(interaction.make_contact, Mode.PUSH), nothing, (Mode.PUSH, Mode.REPLAN, Mode.RETREAT)
            ),
            Mode.PUSH: Rule(partial(interaction.push_object, self._judge), nothing, (Mode.RETREAT,)),
            Mode.RETREAT: Rule(interaction.back_away, nothing, (Mode.REPLAN,)),
            Mode.DONE: Rule(interaction.rest, nothing, ()),
            Mode.FAILED: Rule(interaction.rest, nothing, ()),
        }
        super().__init__(modes, setup, NavigatorState(self.goal[:2], belief_of(grid), jax.random.key(seed)))
        self._index = index
        self._first_adapt = adapt

    @property
    def pushes(self) -> int:
        """Number of pushes started."""
        return self.belief.pushes

    @property
    def adapt(self) -> LearnerState | None:
        """Learner state of the object."""
        target = self.belief.objects.get(self._index)
        return self._first_adapt if target is None or target.adapt is None else target.adapt

    def know(self, adapt: LearnerState) -> None:
        """Sets the learner state, also during a push."""
        self._first_adapt = adapt
        if self._index in self.belief.objects:
            self.state = self.state.with_object(self._index, adapt=adapt)
        if self.segment is not None and self.segment.push is not None:
            pushed = self.segment.push
            self.state = self.state.with_segment(push=replace(pushed, pusher=pushed.pusher._replace(adapt=adapt)))

    def head_for(self, goal: Numbers | Float[Array, "3"], now: float) -> None:
        """Switches to another pose in {W}. The belief stays."""
        self.goal = finite_numbers("PushTask: the goal", goal, "x, y, yaw")
        super().head_for(goal, now)
        if self._index in self.belief.objects:
            self.state = self.state.with_object(self._index, pushes=0, push_errors=())

    def _look(self, setup: Setup, state: NavigatorState, obs: Observation) -> tuple[NavigatorState, Command]:
        """Stand still and look at the object."""
        target, command = state.belief.objects.get(self._index), hold(interaction.robot_alone(obs))
        if target is None:
            return state, command
        offset = target.pose[:2] - obs.robot_pose[0, :2]
        return state, command._replace(yaw=np.arctan2(offset[1], offset[0]))

    def _choose(self, setup: Setup, state: NavigatorState, obs: Observation) -> NavigatorState | None:
        """With the object at rest: finish, or choose the next push."""
        if state.segment is not None:  # the previous push is over
            return _with_error(state)
        cfg, index, now = self.settings, self._index, float(obs.time[0])
        target = state.belief.objects.get(index)
        if target is None:
            return state.go(now, Mode.FAILED, f"object {index} is not in sight")
        looks = target.age < _FRESH or now - state.since > _LONGEST_LOOK
        if not looks or np.linalg.norm(obs.object_twist[0, index, :2]) >= AT_REST:
            return None
        distance = float(np.linalg.norm(target.pose[:2] - self.goal[:2]))
        turned = abs(float(se2.wrap(target.pose[2] - self.goal[2])))
        where = f"{distance:.2f} m and {np.rad2deg(turned):.0f} deg from its goal"
        if distance < cfg.arrived and turned < cfg.arrived_yaw:
            return state.go(now, Mode.DONE, f"the object is {where}")
        if target.pushes >= cfg.max_pushes:
            return state.go(now, Mode.DONE, f"the object is {where} after {target.pushes} pushes")
        routes, clearance = setup.routes(state), state.belief.clearance()
        clearance_without, faces = state.belief.clearance(without=index), faces_of(target.half_extents)
        ways = [routes.path_to_face(obs.robot_pose[0, :2], index, face, clearance) for face in faces]
        lengths = [w[0].length if w and i not in target.failed_faces else None for i, w in enumerate(ways)]
        if all(length is None for length in lengths):
            return state.go(now, Mode.FAILED, f"no face can be reached; the object is {where}")
        half, foresight = target.half_extents, contact_foresight(setup.controller, pose_push_config())
        reached = push_displacements(
            foresight, adapt=self.adapt, kind=target.kind, half_extents=half, goal=se2.relative(target.pose, self.goal)
        )
        free = partial(footprints_free, clearance_without, half_extents=np.array(half), wall_clearance=_WALL_CLEARANCE)
        choice = choose_push(
            reached,
            target.pose,
            self.goal,
            faces=faces,
            ways=lengths,
            free=free,
            error=push_error(target.push_errors),
        )
        if choice is None:
            return state.go(now, Mode.DONE, f"the object is {where}, and another push promises no better")
        chosen = ways[choice.side]
        assert chosen is not None
        state = state.with_object(index, adapt=self.adapt)
        state = start_push(state, now, index, side=choice.side, goal=choice.goal, reached=chosen)
        final = "" if np.array_equal(choice.goal, self.goal) else " to a place on the way"
        why = f"push {target.pushes + 1} from {SIDES[choice.side]}{final}; the object is {where}"
        none = np.zeros((0, 1, 2))
        event = Decision(now, index, np.nan, np.nan, True, choice.goal, why, none, choice.goal[None], None)
        return state.with_events(event).go(now, Mode.APPROACH, why)

    def _judge(self, setup: Setup, state: NavigatorState, obs: Observation) -> NavigatorState:
        """Ends a push that must release the object now, or that makes no progress."""
        now, segment, target = float(obs.time[0]), state.current(), state.target()
        pushed = segment.push
        assert pushed is not None
        coasts, left, let_go = push.lets_go(
            setup.controller.coast(pushed.pusher),
            pushed.coasts,
            object_pose=target.pose,
            face=segment.face,
            goal=segment.goal,
        )
        state = state.with_segment(push=replace(pushed, coasts=coasts))
        over = interaction.push_end_reason(state, now)
        if let_go and pushed.ok:
            over = f"let go {left:.2f} m before the goal, to coast {np.median(coasts):.2f} m"
        if over:
            return state.go(now, Mode.RETREAT, over)
        count = round(_STALL[1] / DT)
        if len(pushed.poses) < count:
            return state
        poses = np.array([pushed.poses[0], pushed.poses[-count], target.pose])
        at_first, before, here = residual(poses, segment.goal)
        if before - here >= _STALL[0]:
            return state
        if at_first - here < _NO_NEARER:
            state = state.failed()
        return state.go(now, Mode.RETREAT, f"hardly nearer to its goal after {_STALL[1]:g} s")


def _with_error(state: NavigatorState) -> NavigatorState:
    """The state after a push, with the error of where it has left the object."""
    target, segment = state.target(), state.current()
    errors = target.push_errors
    if segment.push is not None:
        start, end = residual(np.array([segment.push.poses[0], target.pose]), segment.goal)
        # Divided as `choose_push` multiplies: a constant part and one per metre; the residual at the start is the way.
        errors = (*errors, float(end / (1.0 + start)))
    return replace(state.with_object(segment.object, push_errors=errors), segment=None)
