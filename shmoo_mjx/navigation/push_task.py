"""Adaptive pushing by itself (spec 7.2): bring one object to a pose, from any start pose of the robot round it.

Choose a face, drive to its stand-off pose, extend the arms, make contact, push with MPPI while a adapts, let go in time
for the object to coast into its goal, back away, and look. If the object is not where it should be, another push
follows, on another face where that helps: what has gone too far is pushed back from the other side.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any, NamedTuple, Protocol

import jax
import numpy as np

from shmoo_mjx import se2
from shmoo_mjx.control import trim
from shmoo_mjx.control.cost import PushCost
from shmoo_mjx.control.mppi import Plan
from shmoo_mjx.control.pushing import LocalField, PushConfig, Sighting, local_field
from shmoo_mjx.faces import faces_of, heading
from shmoo_mjx.hands import HAND_HEIGHT, REACH
from shmoo_mjx.learning.adaptation import AdaptState
from shmoo_mjx.navigation.belief import Belief, KnownObject
from shmoo_mjx.navigation.face_choice import ArcConfig, choose, residual
from shmoo_mjx.navigation.maps import OccupancyGrid
from shmoo_mjx.navigation.moves import Moves, command
from shmoo_mjx.navigation.records import Approach, NavigatorConfig
from shmoo_mjx.navigation.routes import Routes
from shmoo_mjx.types import DT, Command, Observation

__all__ = ["Phase", "PushTask", "PushTaskConfig", "Pusher", "pose_push_config"]

Array = Any


class Phase(StrEnum):
    """States of the task."""

    CHOOSE = "choose"
    APPROACH = "approach"
    CONTACT = "make contact"
    PUSH = "push"
    RETREAT = "retreat"
    DONE = "done"
    FAILED = "failed"


class Pusher(Protocol):
    """What pushes: :class:`~shmoo_mjx.control.pushing.PushController`, or something to compare it with.

    Its state is a NamedTuple of its own with a field ``adapt``: what has been learned of the object.
    """

    def init(self, now: Sighting, face: Array, half_extents: Array, key: Array, adapt: AdaptState | None = None) -> Any:
        """Start a push."""

    def step(
        self, state: Any, now: Sighting, last_u: Array, goal: Array, around: LocalField, half_extents: Array
    ) -> tuple[np.ndarray, Any, Plan | None]:
        """One 10 Hz step."""

    def coast(self, state: Any) -> np.ndarray:
        """Where the object comes to rest if it is let go now."""


def pose_push_config() -> PushConfig:
    """The pushing controller's settings where the object's yaw counts and it has to stop at its goal."""
    from dataclasses import replace

    base = PushConfig()
    cost: PushCost = replace(
        base.cost, yaw_weight=0.6, aim_weight=0.7, lateral_weight=0.8, creep=0.07, slow_down=0.25, speed_limit=0.16,
        haste_weight=3.0, speed_weight=0.3, change=0.03,
    )  # fmt: skip
    # Small, slow noise: a plan that jumps about shakes what rolls off the hands.
    control = replace(
        base.control, sigma=(0.015, 0.012, 0.07), low=(-0.12, -0.06, -0.4), high=(0.12, 0.06, 0.4),
        noise_correlation=0.95,
    )  # fmt: skip
    # Accelerations are differences of noisy twists.
    adapt = replace(base.adapt, noise_scale=2.0)
    # What hardly resists is felt too weakly to teach much, but it coasts.
    return replace(
        base, cost=cost, control=control, adapt=adapt, governor_room=0.04, foresees_governor=True, moving=0.05
    )


@dataclass(frozen=True)
class PushTaskConfig:
    """Settings of the task, SI units."""

    arrived: float = 0.07
    """Distance from the goal at which the object is left where it is."""
    arrived_yaw: float = float(np.deg2rad(10.0))
    """... and the yaw error."""
    gain: float = 0.1
    """Least improvement that another push has to promise [m of error]: about what a short one errs by itself."""
    max_pushes: int = 6
    lead: float = 0.015
    """The object is let go where it is expected to stop this far before its goal: hands relax by about that much."""
    within: float = 0.3
    """... but not from farther than this, since what is let go can't be steered [m]."""
    at_rest: float = 0.03
    """Speed below which the object counts as resting [m/s]."""
    lost_after: float = 2.5
    """Time without contact after which contact counts as lost: longer than the hands need to catch up [s]."""
    stall_distance: float = 0.03
    """An object that moved less than this ..."""
    stall_time: float = 4.0
    """... in this much contact time has stalled."""
    push_limit: float = 40.0
    """Longest push."""
    trim: trim.TrimConfig = trim.TrimConfig()
    arcs: ArcConfig = ArcConfig()
    moves: NavigatorConfig = NavigatorConfig()


@dataclass
class _Leg:
    """One push on one face."""

    side: int
    face: np.ndarray
    goal: np.ndarray
    """``[3]``"""
    approach: Approach
    around: LocalField
    state: Any = None
    """The pusher's, once there is contact."""
    began: float = 0.0
    """When the present phase began [s]."""
    contact_time: float = 0.0
    since_contact: float = 0.0
    start: np.ndarray = field(default_factory=lambda: np.zeros(3))
    coasts: list[float] = field(default_factory=list)
    """How far the object would coast along the push, once a sample [m]."""
    marks: list[tuple[float, np.ndarray]] = field(default_factory=list)
    """(contact time, object pose) once a sample."""


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
        goal: Array,
        pusher: Pusher,
        index: int = 0,
        seed: int = 0,
        config: PushTaskConfig | None = None,
        adapt: AdaptState | None = None,
    ) -> None:
        """Set up the task.

        Args:
            grid: the map.
            sizes: half extents of each object [m].
            goal: ``[3]`` pose in {W} to bring the object to.
            pusher: the pushing controller.
            index: the object.
            seed: of the controller's random numbers.
            config: settings.
            adapt: coefficients to start from; the prior if not given.
        """
        self.config = config or PushTaskConfig()
        self.goal = np.asarray(goal, dtype=float)
        self.belief = Belief(grid, self.config.moves.sensing_range)
        self.phase = Phase.CHOOSE
        self.events: list[Event] = []
        self.pushes = 0
        self.leg: _Leg | None = None
        self._index = index
        self._sizes = sizes
        self._pusher = pusher
        self._adapt = adapt
        self._routes = Routes(self.belief, self.goal[:2], self.config.moves)
        self._moves = Moves(self._routes, self.config.moves)
        self._key = jax.random.key(seed)
        self._last_u = np.zeros(3)
        self.trim = trim.init()
        self._handlers = {
            Phase.CHOOSE: self._choose,
            Phase.APPROACH: self._approach,
            Phase.CONTACT: self._contact,
            Phase.PUSH: self._push,
            Phase.RETREAT: self._retreat,
            Phase.DONE: self._moves.rest,
            Phase.FAILED: self._moves.rest,
        }

    @property
    def finished(self) -> bool:
        """Whether the task has come to its end."""
        return self.phase in (Phase.DONE, Phase.FAILED)

    @property
    def adapt(self) -> AdaptState | None:
        """What has been learned of the object."""
        return self._adapt

    def know(self, adapt: AdaptState) -> None:
        """Take over coefficients from elsewhere, in the middle of a push too."""
        self._adapt = adapt
        if self.leg is not None and self.leg.state is not None:
            self.leg.state = self.leg.state._replace(adapt=adapt)

    def tick(self, seen: Observation) -> Command:
        """One decision."""
        seen = self.belief.update(seen, self._sizes, self._index)
        self.trim = trim.step(self.config.trim, self.trim, seen)
        result = self._handlers[self.phase](trim.with_trim(self.trim, seen))
        self._last_u = np.asarray(result.u)[0]
        return trim.trimmed(self.trim, result)

    # Phases. Each returns the command for the next sample and may have changed the phase.

    def _choose(self, seen: Observation) -> Command:
        known = self.belief.objects.get(self._index)
        if known is None:
            self._go(seen, Phase.FAILED, f"object {self._index} is not in sight")
        elif np.linalg.norm(seen.object_twist[0, self._index, :2]) < self.config.at_rest:
            self._judge(seen, known)
        return self._moves.rest(seen)

    def _judge(self, seen: Observation, known: KnownObject) -> None:
        """With the object at rest: leave it, or choose the next push."""
        cfg, weight = self.config, self.config.arcs.yaw_weight
        distance = float(np.linalg.norm(known.pose[:2] - self.goal[:2]))
        turned = abs(float(se2.wrap(known.pose[2] - self.goal[2])))
        where = f"{distance:.2f} m and {np.rad2deg(turned):.0f} deg from its goal"
        if distance < cfg.arrived and turned < cfg.arrived_yaw:
            self._go(seen, Phase.DONE, f"the object is {where}")
            return
        if self.pushes >= cfg.max_pushes:
            self._go(seen, Phase.DONE, f"the object is {where} after {self.pushes} pushes")
            return
        around = self.belief.clearance(without=self._index)
        faces = faces_of(known.half_extents)
        paths = [self._routes.way_to(seen.robot_pose[0, :2], self._index, face) for face in faces]
        ways = [p.length if p and i not in known.failed_faces else None for i, p in enumerate(paths)]
        choice = choose(known.pose, self.goal, faces, ways, around, known.half_extents, cfg.arcs)
        if choice is None:
            self._go(seen, Phase.FAILED, f"no face can be reached; the object is {where}")
            return
        if choice.expected > float(residual(known.pose, self.goal, weight)) - cfg.gain:
            self._go(seen, Phase.DONE, f"the object is {where}, and another push promises no better")
            return
        path = paths[choice.side]
        assert path is not None
        now = float(seen.time[0])
        self.leg = _Leg(choice.side, faces[choice.side], choice.goal, Approach(path, now),
                        local_field(around, known.pose), start=known.pose)  # fmt: skip
        self.pushes += 1
        final = "" if np.array_equal(choice.goal, self.goal) else " to a place on the way"
        self._go(seen, Phase.APPROACH, f"push {self.pushes} on face {choice.side}{final}; the object is {where}")

    def _approach(self, seen: Observation) -> Command:
        leg, known = self._current()
        move = self._moves.approach(seen, known.pose, leg.face, leg.approach)
        if move.over:
            self._go(seen, Phase.CONTACT, "at the stand-off pose, arms extended")
        elif move.failed:
            self._go(seen, Phase.CHOOSE, move.failed)
        return move.command

    def _contact(self, seen: Observation) -> Command:
        leg, known = self._current()
        move = self._moves.contact(seen, self._index, known.pose, leg.face, leg.approach)
        if move.over:
            self._key, key = jax.random.split(self._key)
            sighting = Sighting.of(seen, self._index)
            leg.state = self._pusher.init(sighting, leg.face, np.array(known.half_extents), key, self._adapt)
            self._go(seen, Phase.PUSH, "contact")
            return self._push(seen)
        if move.failed:
            self._go(seen, Phase.CHOOSE, move.failed)
        return move.command

    def _push(self, seen: Observation) -> Command:
        leg, known = self._current()
        assert leg.state is not None
        sighting = Sighting.of(seen, self._index)
        before = leg.state.adapt
        u, leg.state, plan = self._pusher.step(
            leg.state, sighting, self._last_u, leg.goal, leg.around, np.array(known.half_extents)
        )
        if known.blind > 0.0:
            leg.state = leg.state._replace(adapt=before)
        self._adapt = leg.state.adapt
        touching = np.hypot(*sighting.wrench[:2]) > self.config.moves.contact_force / 2
        leg.contact_time += DT if touching else 0.0
        leg.since_contact = 0.0 if touching else leg.since_contact + DT
        leg.marks.append((leg.contact_time, known.pose.copy()))
        if plan is not None and not bool(plan.ok):
            self._go(seen, Phase.RETREAT, "no roll-out of the model is finite: safe stop")
        else:
            self._end_of_push(seen, leg, known)
        if self.phase is Phase.RETREAT:
            return self._retreat(seen)
        return command(u[:2], u[2], heading(known.pose, leg.face), REACH, HAND_HEIGHT)

    def _end_of_push(self, seen: Observation, leg: _Leg, known: KnownObject) -> None:
        """Let go, or give up, if it is time to."""
        assert leg.state is not None
        cfg, now = self.config, float(seen.time[0])
        ahead = heading(known.pose, leg.face)
        normal = np.array([np.cos(ahead), np.sin(ahead)])
        left = float((leg.goal[:2] - known.pose[:2]) @ normal)
        leg.coasts.append(float((self._pusher.coast(leg.state)[:2] - known.pose[:2]) @ normal))
        coasts = float(np.median(leg.coasts[-5:]))  # a single twist is noisy
        moved = float(np.linalg.norm(known.pose[:2] - leg.start[:2]))
        if left - coasts < cfg.lead and left < cfg.within:
            self._go(seen, Phase.RETREAT, f"let go {left:.2f} m before the goal, to coast {coasts:.2f} m")
        elif leg.since_contact > cfg.lost_after:
            self._go(seen, Phase.RETREAT, f"contact lost for {cfg.lost_after:g} s")
        elif self._stalled(leg):
            if moved < 0.1:
                known.failed_faces.add(leg.side)
            self._go(seen, Phase.RETREAT, f"moved less than {cfg.stall_distance:g} m in {cfg.stall_time:g} s")
        elif now - leg.began > cfg.push_limit:
            self._go(seen, Phase.RETREAT, f"pushed for {cfg.push_limit:g} s")

    def _stalled(self, leg: _Leg) -> bool:
        if leg.contact_time < self.config.stall_time:
            return False
        recent = np.array([p[:2] for t, p in leg.marks if t > leg.contact_time - self.config.stall_time])
        return float(np.linalg.norm(np.ptp(recent, axis=0))) < self.config.stall_distance

    def _retreat(self, seen: Observation) -> Command:
        leg, known = self._current()
        move = self._moves.retreat(seen, known.pose, leg.face, leg.began)
        if move.over:
            self.leg = None
            self._go(seen, Phase.CHOOSE, "backed away")
        return move.command

    def _current(self) -> tuple[_Leg, KnownObject]:
        assert self.leg is not None, f"{self.phase} needs a push"
        return self.leg, self.belief.objects[self._index]

    def _go(self, seen: Observation, target: Phase, reason: str) -> None:
        self.events.append(Event(float(seen.time[0]), self.phase, target, reason))
        self.phase = target
        if self.leg is not None:
            self.leg.began = float(seen.time[0])
