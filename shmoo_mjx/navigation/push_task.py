"""Adaptive pushing by itself: bring one object to a pose, from any start pose of the robot round it.

Choose a face, drive to its stand-off pose, extend the arms, make contact, push with MPPI while a adapts, let go in time
for the object to coast into its goal, back away, and look. If the object is not where it should be, another push
follows, on another face where that helps: what has gone too far is pushed back from the other side.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import NamedTuple

import jax
import numpy as np

from shmoo_mjx import se2
from shmoo_mjx.arrays import Array, Float, Numbers, finite_numbers
from shmoo_mjx.control import equilibrium_lean
from shmoo_mjx.control.cost import PushCost
from shmoo_mjx.control.observation import LocalDistanceField, ObjectObservation, local_distance_field
from shmoo_mjx.control.pushing import PushConfig
from shmoo_mjx.errors import ShmooError
from shmoo_mjx.faces import faces_of
from shmoo_mjx.hands import TUCKED_REACH
from shmoo_mjx.learning.online import Known
from shmoo_mjx.navigation import drive
from shmoo_mjx.navigation.belief import KnownObject, belief_of
from shmoo_mjx.navigation.footprints import footprints_free
from shmoo_mjx.navigation.maps import OccupancyGrid
from shmoo_mjx.navigation.navigator import setup_of
from shmoo_mjx.navigation.paths import Path, project
from shmoo_mjx.navigation.records import NavigatorConfig
from shmoo_mjx.navigation.routes import Routes
from shmoo_mjx.navigation.verdicts import UNDETECTED_LIMIT
from shmoo_mjx.planning.reach import contact_foresight
from shmoo_mjx.planning.search import choose, reached_by, residual
from shmoo_mjx.sensing import finite
from shmoo_mjx.skills import approach, batched, contact, hold, push, retreat
from shmoo_mjx.skills.push import Pusher
from shmoo_mjx.types import DT, Command, Observation

_LONGEST_RETREAT = 5.0
"""[s]"""
_FRESH = 0.3
"""Age of a pose from which the robot first turns to the object to look where it is [s]."""
_LONGEST_LOOK = 4.0
"""How long it looks for it [s]."""
_WALL_CLEARANCE = 0.06
"""Distance from walls that the footprint keeps at the end of a push [m]: what the pushing controller keeps, too."""
AT_REST = 0.03
"""Speed below which the object counts as resting [m/s]: 3 mm in a sample."""
_LOST_AFTER = 2.5
"""Time without contact after which contact counts as lost [s]: longer than the hands need to catch up."""
_STALL = (0.03, 6.0)
"""A push that brought the object less nearer to its goal than this [m of error] in so much time [s] has stalled."""
_PUSH_LIMIT = 40.0
"""Longest push [s]: 6 m at the speed allowed."""


class Phase(StrEnum):
    """States of the task."""

    CHOOSE = "choose"
    APPROACH = "approach"
    CONTACT = "make contact"
    PUSH = "push"
    RETREAT = "retreat"
    DONE = "done"
    FAILED = "failed"


def pose_push_config() -> PushConfig:
    """The pushing controller's settings where the object's yaw counts and it has to stop at its goal."""
    base = PushConfig()
    cost: PushCost = replace(
        base.cost, yaw_weight=0.6, aim_weight=0.7, lateral_weight=0.8, terminal_speed=0.07, slow_down=0.25,
        speed_limit=0.16, overspeed_weight=3.0, speed_weight=0.3, change=0.03,
    )  # fmt: skip
    # Small, slow noise: a plan that jumps about shakes what rolls off the hands.
    control = replace(base.control, sigma=(0.015, 0.012, 0.07), noise_correlation=0.95)
    return replace(base, cost=cost, control=control, governor_room=0.04, foresees_governor=True)


@dataclass(frozen=True)
class PushTaskConfig:
    """Settings of the task, SI units."""

    arrived: float = 0.07
    """Distance from the goal at which the object is left where it is [m]; less makes for more pushes."""
    arrived_yaw: float = float(np.deg2rad(10.0))
    """Yaw error at which it is [rad]; less makes for more pushes."""
    max_pushes: int = 6
    """Pushes after which the object is left where it is [1]; more can mend more, and take longer."""
    moves: NavigatorConfig = NavigatorConfig()
    """How the robot drives from face to face."""


@dataclass(frozen=True, eq=False)
class _PushSegment:
    """One push on one face."""

    side: int
    face: Float[np.ndarray, "4"]
    goal: Float[np.ndarray, "3"]
    way: Path
    """To the stand-off pose."""
    approach: approach.ApproachState
    around: LocalDistanceField
    contact: contact.ContactState | None = None
    push: push.PushState | None = None
    """Once there is contact."""
    coasts: Float[np.ndarray, "5"] = field(default_factory=lambda: np.zeros(5))
    """How far the object would coast along the push, in the last samples [m]."""


class Event(NamedTuple):
    """A change of phase."""

    t: float
    source: Phase
    target: Phase
    reason: str


class PushTask:
    """The state machine. ``tick`` takes an observation of one world and gives the command for the next sample."""

    def __init__(
        self,
        grid: OccupancyGrid,
        sizes: list[tuple[float, float]],
        goal: Numbers | Float[Array, "3"],
        pusher: Pusher,
        index: int = 0,
        seed: int = 0,
        config: PushTaskConfig | None = None,
        adapt: Known | None = None,
        kinds: Sequence[str | None] | None = None,
    ) -> None:
        """Set up the task.

        Args:
            grid: the map.
            sizes: half extents of each object [m].
            goal: pose (x, y, yaw) in {W} to bring the object to.
            pusher: the pushing controller.
            index: the object.
            seed: of the controller's random numbers.
            config: settings.
            adapt: coefficients to start from; the prior if not given.
            kinds: what each object looks like: "box", "cart", "wheelchair", or None for none of them, as all are if not
                given. It decides the prior.

        Raises:
            ShmooError: the goal is not three finite numbers, or there is no object ``index``.
        """
        if not 0 <= index < len(sizes):
            raise ShmooError(f"PushTask: there is no object {index}; sizes has {len(sizes)}, counted from 0.")
        self.config = config or PushTaskConfig()
        self.goal = finite_numbers("PushTask: the goal", goal, "x, y, yaw")
        self.belief = belief_of(grid)
        self.phase = Phase.CHOOSE
        self.since = 0.0
        self.events: list[Event] = []
        self.pushes = 0
        self.segment: _PushSegment | None = None
        self.lean_offset = equilibrium_lean.init()
        self._setup = setup_of(sizes, pusher, self.config.moves, kinds=kinds)
        self._index = index
        self._pusher = pusher
        self._adapt = adapt
        self._drive = drive.init()
        self._key = jax.random.key(seed)
        self._last_u = np.zeros(3)
        self._seen: Observation | None = None
        self._handlers = {
            Phase.CHOOSE: self._choose,
            Phase.APPROACH: self._approach,
            Phase.CONTACT: self._contact,
            Phase.PUSH: self._push,
            Phase.RETREAT: self._retreat,
            Phase.DONE: self._rest,
            Phase.FAILED: self._rest,
        }

    @property
    def finished(self) -> bool:
        """Whether the task has come to its end."""
        return self.phase in (Phase.DONE, Phase.FAILED)

    @property
    def adapt(self) -> Known | None:
        """What has been learned of the object."""
        return self._adapt

    def know(self, adapt: Known) -> None:
        """Take over coefficients from elsewhere, in the middle of a push too."""
        self._adapt = adapt
        if self.segment is not None and self.segment.push is not None:
            pushed = replace(self.segment.push, pusher=self.segment.push.pusher._replace(adapt=adapt))
            self.segment = replace(self.segment, push=pushed)

    def tick(self, obs: Observation) -> Command:
        """One decision."""
        obs = self._seen = finite(obs, self._seen)
        self.belief, _ = self.belief.update(obs, self._setup.sizes, self._index, kinds=self._setup.kinds)
        self.lean_offset = equilibrium_lean.step(self.lean_offset, obs)
        obs = equilibrium_lean.corrected(self.lean_offset, obs)
        result = self._handlers[self.phase](equilibrium_lean.predicted(obs, self.config.moves.latency))
        self._last_u = np.asarray(result.u, dtype=float)
        return equilibrium_lean.shifted(self.lean_offset, batched(result))

    # Phases. Each returns the command for the next sample and may have changed the phase.

    def _rest(self, obs: Observation) -> Command:
        return hold(ObjectObservation.of(obs, self._index))

    def _choose(self, obs: Observation) -> Command:
        known = self.belief.objects.get(self._index)
        if known is None:
            self._go(obs, Phase.FAILED, f"object {self._index} is not in sight")
            return self._rest(obs)
        looks = known.age < _FRESH or float(obs.time[0]) - self.since > _LONGEST_LOOK
        if looks and np.linalg.norm(obs.object_twist[0, self._index, :2]) < AT_REST:
            self._judge(obs, known)
        offset = known.pose[:2] - obs.robot_pose[0, :2]
        return self._rest(obs)._replace(yaw=np.arctan2(offset[1], offset[0]))

    def _judge(self, obs: Observation, known: KnownObject) -> None:
        """With the object at rest: leave it, or choose the next push."""
        cfg = self.config
        distance = float(np.linalg.norm(known.pose[:2] - self.goal[:2]))
        turned = abs(float(se2.wrap(known.pose[2] - self.goal[2])))
        where = f"{distance:.2f} m and {np.rad2deg(turned):.0f} deg from its goal"
        if distance < cfg.arrived and turned < cfg.arrived_yaw:
            self._go(obs, Phase.DONE, f"the object is {where}")
            return
        if self.pushes >= cfg.max_pushes:
            self._go(obs, Phase.DONE, f"the object is {where} after {self.pushes} pushes")
            return
        routes, everything = Routes(self.belief, self.goal[:2]), self.belief.clearance()
        around, faces = self.belief.clearance(without=self._index), faces_of(known.half_extents)
        ways = [routes.path_to_face(obs.robot_pose[0, :2], self._index, face, everything) for face in faces]
        lengths = [w[0].length if w and i not in known.failed_faces else None for i, w in enumerate(ways)]
        if all(length is None for length in lengths):
            self._go(obs, Phase.FAILED, f"no face can be reached; the object is {where}")
            return
        half, foresight = known.half_extents, contact_foresight(self._pusher, pose_push_config())
        reached = reached_by(foresight, self._adapt, known.kind, half, se2.relative(known.pose, self.goal))
        choice = choose(
            reached,
            known.pose,
            self.goal,
            faces,
            lengths,
            lambda poses: footprints_free(around, poses, half, wall_clearance=_WALL_CLEARANCE),
        )
        if choice is None:
            self._go(obs, Phase.DONE, f"the object is {where}, and another push promises no better")
            return
        chosen = ways[choice.side]
        assert chosen is not None
        begun = approach.init(float(obs.time[0]), *chosen[1:])
        field = local_distance_field(around, known.pose)
        self.segment = _PushSegment(choice.side, faces[choice.side], choice.goal, chosen[0], begun, field)
        self.pushes, self._drive = self.pushes + 1, drive.init()
        final = "" if np.array_equal(choice.goal, self.goal) else " to a place on the way"
        self._go(obs, Phase.APPROACH, f"push {self.pushes} on face {choice.side}{final}; the object is {where}")

    def _approach(self, obs: Observation) -> Command:
        segment, _ = self._current()
        self._drive, lean = drive.follow(self._setup.trajectories, self._drive, obs, segment.way, self.belief.clearance)
        remaining = segment.way.length - project(segment.way, obs.robot_pose[0, :2])
        yaw, object_obs = drive.yaw_ahead(obs, segment.way), ObjectObservation.of(obs, self._index)
        reached, move = approach.step(
            segment.approach, float(obs.time[0]), object_obs, segment.face, lean, yaw, remaining
        )
        self.segment = replace(segment, approach=reached)
        if move.over:
            self.segment = replace(self.segment, contact=contact.init(object_obs, self.segment.approach.lateral))
            self._go(obs, Phase.CONTACT, "at the stand-off pose, arms extended")
        elif move.failed:
            self._go(obs, Phase.CHOOSE, "the stand-off pose was not reached in time")
        return move.command

    def _contact(self, obs: Observation) -> Command:
        segment, known = self._current()
        assert segment.contact is not None
        object_obs = ObjectObservation.of(obs, self._index)
        _, move = contact.step(segment.contact, object_obs, segment.face)
        if move.over:
            self._key, key = jax.random.split(self._key)
            now, half = float(obs.time[0]), known.half_extents
            self.segment = replace(
                segment,
                push=push.init(self._pusher, now, object_obs, segment.face, half, key, self._adapt, known.kind),
            )
            self._go(obs, Phase.PUSH, "contact")
        elif move.failed:
            self._go(obs, Phase.CHOOSE, "drifted off the face while making contact")
        return move.command

    def _push(self, obs: Observation) -> Command:
        segment, known = self._current()
        assert segment.push is not None
        object_obs = ObjectObservation.of(obs, self._index)
        pushed, command = push.step(
            self._pusher,
            segment.push,
            object_obs,
            segment.face,
            self._last_u,
            segment.goal,
            segment.around,
            known.half_extents,
        )
        self._adapt = pushed.pusher.adapt
        coasts, left, let_go = push.lets_go(
            self._pusher.coast(pushed.pusher), segment.coasts, known.pose, segment.face, segment.goal
        )
        self.segment = replace(segment, push=pushed, coasts=coasts)
        if not pushed.ok:
            self._go(obs, Phase.RETREAT, "no roll-out of the model is finite: safe stop")
        elif let_go:
            text = f"let go {left:.2f} m before the goal, to coast {np.median(coasts):.2f} m"
            self._go(obs, Phase.RETREAT, text)
        else:
            self._end_of_push(obs, segment, pushed, known)
        return self._retreat(obs) if self.phase is Phase.RETREAT else command

    def _end_of_push(self, obs: Observation, segment: _PushSegment, pushed: push.PushState, known: KnownObject) -> None:
        """Give up a push that leads no further."""
        count = round(_STALL[1] / DT)
        errors = residual(np.array([pushed.poses[0], pushed.poses[-count:][0], known.pose]), segment.goal)
        if pushed.since_contact > _LOST_AFTER:
            self._go(obs, Phase.RETREAT, f"contact lost for {_LOST_AFTER:g} s")
        elif known.age > UNDETECTED_LIMIT:
            self._go(obs, Phase.RETREAT, f"the object has not been detected for {UNDETECTED_LIMIT:g} s")
        elif len(pushed.poses) >= count and errors[1] - errors[2] < _STALL[0]:
            if errors[0] - errors[2] < 0.1:
                failed = (*known.failed_faces, segment.side)
                self.belief = self.belief.with_object(self._index, failed_faces=failed)
            self._go(obs, Phase.RETREAT, f"hardly nearer to its goal after {_STALL[1]:g} s")
        elif float(obs.time[0]) - pushed.started > _PUSH_LIMIT:
            self._go(obs, Phase.RETREAT, f"pushed for {_PUSH_LIMIT:g} s")

    def _retreat(self, obs: Observation) -> Command:
        segment, _ = self._current()
        now, object_obs = float(obs.time[0]), ObjectObservation.of(obs, self._index)
        folded = bool(np.all(obs.hands[0, :, 0] < TUCKED_REACH + 0.06))
        move = retreat.step(object_obs, segment.face, folded)
        if move.over or now - self.since > _LONGEST_RETREAT:
            self.segment = None
            self._go(obs, Phase.CHOOSE, "backed away")
        return move.command

    def _current(self) -> tuple[_PushSegment, KnownObject]:
        assert self.segment is not None, f"{self.phase} needs a push"
        return self.segment, self.belief.objects[self._index]

    def _go(self, obs: Observation, target: Phase, reason: str) -> None:
        self.since = float(obs.time[0])
        self.events.append(Event(self.since, self.phase, target, reason))
        self.phase = target
