"""Interactive navigation (Sec. IV): follow the path, push what is in the way, go round what can't be pushed.

An explicit state machine at 10 Hz; every transition is logged with its reason. It sees poses and sizes of objects in
sight and the force on its hands; what it knows of an object's dynamics it has learned by touching it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import jax
import numpy as np

from shmoo_mjx.control.pushing import PushController, Sighting, local_field
from shmoo_mjx.faces import faces_of, heading
from shmoo_mjx.hands import HAND_HEIGHT, REACH, TUCKED_HEIGHT, TUCKED_REACH
from shmoo_mjx.navigation import drive
from shmoo_mjx.navigation.belief import Belief, KnownObject, Status
from shmoo_mjx.navigation.maps import OccupancyGrid
from shmoo_mjx.navigation.moves import Moves, command
from shmoo_mjx.navigation.object_planner import initial_goal, planning_stage
from shmoo_mjx.navigation.paths import Path, path_blocked_by, project
from shmoo_mjx.navigation.records import Approach, Decision, Mode, NavigatorConfig, Push, Transition
from shmoo_mjx.navigation.routes import Routes
from shmoo_mjx.types import DT, Command, Observation

__all__ = ["Navigator"]

Array = Any


class Navigator:
    """The state machine. ``tick`` takes an observation and gives the command for the next sample."""

    def __init__(
        self,
        grid: OccupancyGrid,
        goal: Array,
        sizes: list[tuple[float, float]],
        controller: PushController,
        seed: int = 0,
        config: NavigatorConfig | None = None,
        first_status: Sequence[Status] | None = None,
    ) -> None:
        self.config = config or NavigatorConfig()
        self.goal = np.asarray(goal, dtype=float)[:2]
        self.belief = Belief(grid, self.config.sensing_range, first_status)
        self._routes = Routes(self.belief, self.goal, self.config)
        self.mode = Mode.REPLAN
        self.path: Path | None = None
        self._round: set[int] = set()  # objects that the path has been led round since the last plan
        self.transitions: list[Transition] = []
        self.decisions: list[Decision] = []
        self.plans: list[tuple[float, np.ndarray]] = []
        self.push: Push | None = None
        self._sizes = sizes
        self._controller = controller
        self._key = jax.random.key(seed)
        self._moves = Moves(self._routes, self.config)
        self._drive = drive.init()
        self._last_u = np.zeros(3)
        self._handlers: dict[Mode, Callable[[Observation], Command]] = {
            Mode.FOLLOW: self._follow,
            Mode.APPROACH: self._approach,
            Mode.CONTACT: self._contact,
            Mode.PROBE: self._push_step,
            Mode.PUSH: self._push_step,
            Mode.RETREAT: self._retreat,
            Mode.REPLAN: self._replan,
            Mode.DONE: self._moves.rest,
            Mode.FAILED: self._moves.rest,
        }

    @property
    def finished(self) -> bool:
        """Whether the run has come to its end."""
        return self.mode in (Mode.DONE, Mode.FAILED)

    @property
    def coefficients(self) -> tuple[int, np.ndarray] | None:
        """(object, a ``[n]``) that adapts at present."""
        if self.push is None or self.push.state is None:
            return None
        return self.push.object, np.asarray(self.push.state.adapt.mean)

    def tick(self, seen: Observation) -> Command:
        """One decision from one observation of a single world."""
        seen = self.belief.update(seen, self._sizes, None if self.push is None else self.push.object)
        result = self._handlers[self.mode](seen)
        self._last_u = np.asarray(result.u)[0]
        return result

    # States. Each returns the command for the next sample and may have changed the mode.

    def _replan(self, seen: Observation) -> Command:
        if self.push is not None:
            self.belief.objects[self.push.object].registered = self.belief.objects[self.push.object].pose
            self.push = None
        self._take_up_again(seen)
        path = self._routes.plan(seen.robot_pose[0, :2], self.belief.polygons((Status.PARKED, Status.FIXED)))
        if path is None and self._second_chance(seen):
            path = self._routes.plan(seen.robot_pose[0, :2], self.belief.polygons((Status.PARKED, Status.FIXED)))
        if path is None:
            self._go(seen, Mode.FAILED, "every route to the goal is blocked by walls and objects that can't be moved")
            return self._moves.rest(seen)
        self._round.clear()
        self._set_path(seen, path)
        self._go(seen, Mode.FOLLOW, f"path of {path.length:.2f} m found")
        return self._follow(seen)

    def _take_up_again(self, seen: Observation) -> None:
        """A parked object that still costs a long way round may be pushed again, unless it has been too often."""
        position, cfg = seen.robot_pose[0, :2], self.config
        around = self._routes.plan(position, self.belief.polygons((Status.PARKED, Status.FIXED)))
        through = self._routes.plan(position, self.belief.polygons((Status.FIXED,)))
        if through is None or (around is not None and around.length < through.length + cfg.detour):
            return
        for known in self.belief.objects.values():
            again = known.status is Status.PARKED and known.pushes < cfg.max_pushes
            if again and path_blocked_by(through, known.polygon, cfg.robot_radius)[0]:
                known.status = Status.UNKNOWN

    def _second_chance(self, seen: Observation) -> bool:
        """With every route blocked, each registered object is tried once more, as if it had never been touched."""
        if not self.config.second_chance:
            return False
        again = {i: o for i, o in self.belief.objects.items() if o.status is Status.FIXED and not o.retried}
        through = self._routes.plan(
            seen.robot_pose[0, :2], [o.polygon for i, o in self.belief.objects.items() if i not in again]
        )
        for index, known in again.items():
            if through is not None and path_blocked_by(through, known.polygon, self.config.robot_radius)[0]:
                known.status, known.retried, known.adapt = Status.UNKNOWN, True, None
                known.pushes = min(known.pushes, self.config.max_pushes - 1)
                text = f"every route is blocked: object {index}, registered as an obstacle, is tried once more"
                self.belief.events.append((float(seen.time[0]), text))
                return True
        return False

    def _follow(self, seen: Observation) -> Command:
        assert self.path is not None
        position = seen.robot_pose[0, :2]
        speed = float(np.linalg.norm(seen.robot_twist[0, :2]))
        if np.linalg.norm(position - self.goal) < self.config.goal_tolerance and speed < 0.1:
            self._go(seen, Mode.DONE, f"goal reached to {np.linalg.norm(position - self.goal):.2f} m")
            return self._moves.rest(seen)
        blocked = self._first_block(seen)
        if blocked is not None and self._deal_with(seen, *blocked):
            return self._handlers[self.mode](seen)
        self._drive, lean = self._moves.follow(seen, self._drive, self.path)
        since = self._drive.failed_since
        if since is not None and float(seen.time[0]) - since > 3.0:
            self._go(seen, Mode.REPLAN, f"no local trajectory for 3 s: {self._drive.reason}")
            self._drive = drive.init()
        return command(lean, 0.0, drive.yaw_ahead(self.config.drive, seen, self.path), TUCKED_REACH, TUCKED_HEIGHT)

    def _first_block(self, seen: Observation) -> tuple[int, float] | None:
        """The known object that blocks the path first, and how far along the path [m]."""
        assert self.path is not None
        here = project(self.path, seen.robot_pose[0, :2])
        found = []
        for index, known in self.belief.objects.items():
            blocked, s = path_blocked_by(self.path, known.polygon, self.config.robot_radius - 0.03, here)
            if blocked and s is not None and s - here < self.config.act_within:
                found.append((s - here, index))
        return (min(found)[1], min(found)[0]) if found else None

    def _deal_with(self, seen: Observation, index: int, distance: float) -> bool:
        """Decide about an object in the way; True if the mode has changed."""
        assert self.path is not None
        known = self.belief.objects[index]
        if known.status is not Status.UNKNOWN:
            self._go(seen, Mode.REPLAN, f"object {index} ({known.status}) is in the way")
            return True
        position = seen.robot_pose[0, :2]
        remaining = self.path.length - project(self.path, position)
        # Not through another one that this path goes round already: it would turn from one to the other for ever.
        gone_round = [self.belief.objects[i].polygon for i in self._round | {index}]
        detour = self._routes.plan(position, [*self.belief.polygons((Status.PARKED, Status.FIXED)), *gone_round])
        if self.config.goes_round and detour is not None and detour.length < remaining + self.config.detour:
            self._round.add(index)
            self._set_path(seen, detour)
            self._go(
                seen,
                Mode.FOLLOW,
                f"object {index} is in the way; going round it costs {detour.length - remaining:+.2f} m",
            )
            return False
        cost = (
            "there is no way round" if detour is None else f"the way round is {detour.length - remaining:.2f} m longer"
        )
        # Walking to a face is worth while only if that and the rest of the path are shorter than the way round.
        longest_way = np.inf
        if detour is not None and self.config.goes_round:
            longest_way = detour.length - (remaining - distance)
        return self._start_push(
            seen, index, f"object {index} blocks the path {distance:.2f} m ahead and {cost}", longest_way
        )

    def _start_push(self, seen: Observation, index: int, why: str, longest_way: float) -> bool:
        """Choose goal, face and way to the stand-off pose; True (the mode changes in any case)."""
        known = self.belief.objects[index]
        if known.pushes >= self.config.max_pushes:
            return self._give_up(
                seen, index, f"object {index} has been pushed {known.pushes} times without clearing the path"
            )
        around = self.belief.clearance(without=index)
        faces = faces_of(known.half_extents)
        ways = [self._routes.way_to(seen.robot_pose[0, :2], index, face) for face in faces]
        usable = [i for i, way in enumerate(ways) if way is not None and way.length < longest_way]
        usable = [i for i in usable if i not in known.failed_faces] or usable
        if not usable:
            return self._give_up(seen, index, f"no face of object {index} can be reached on a way worth taking")
        directions = [heading(known.pose, faces[i]) for i in usable]
        position = seen.robot_pose[0, :2]
        free = self._routes.collision_free(position, known, around, self._routes.free_path(position, known))
        first = initial_goal(known.pose, free, np.array(directions), self.config.planner)
        if first.goal is None:
            # In a corridor the next place where it is out of the way may be farther.
            farther = replace(self.config.planner, area=self.config.far_area)
            first = initial_goal(known.pose, free, np.array(directions), farther)
        if first.goal is None or first.direction is None:
            return self._give_up(seen, index, f"object {index} can be put nowhere: {first.reason}")
        face, way = faces[usable[first.direction]], ways[usable[first.direction]]
        assert way is not None
        known.pushes, known.registered = known.pushes + 1, known.pose
        approach = Approach(way, float(seen.time[0]))
        self.push = Push(index, usable[first.direction], face, first.goal, approach, local_field(around, known.pose))
        self._go(seen, Mode.APPROACH, f"{why}; first goal: {first.reason}")
        return True

    def _give_up(self, seen: Observation, index: int, why: str) -> bool:
        if not self.config.goes_round:
            self._go(seen, Mode.FAILED, f"{why}, and going round is not allowed")
            return True
        known = self.belief.objects[index]
        known.status, known.registered = Status.FIXED, known.pose
        self._go(seen, Mode.REPLAN, f"{why}; registered as an obstacle")
        return True

    def _approach(self, seen: Observation) -> Command:
        push = self._pushed()
        known = self.belief.objects[push.object]
        move = self._moves.approach(seen, known.pose, push.face, push.approach)
        if move.over:
            self._go(seen, Mode.CONTACT, "at the stand-off pose, arms extended")
        elif move.failed:
            self._go(seen, Mode.REPLAN, move.failed)
        elif self._moved_away(known):
            known.pushes -= 1
            self._go(seen, Mode.REPLAN, f"object {push.object} was moved while it was being approached")
        return move.command

    def _moved_away(self, known: KnownObject) -> bool:
        assert known.registered is not None
        return float(np.linalg.norm(known.pose[:2] - known.registered[:2])) > self.belief.displaced

    def _contact(self, seen: Observation) -> Command:
        push = self._pushed()
        known = self.belief.objects[push.object]
        move = self._moves.contact(seen, push.object, known.pose, push.face, push.approach)
        if move.over:
            sighting = Sighting.of(seen, push.object)
            push.state = self._controller.init(sighting, push.face, known.half_extents, self._next_key(), known.adapt)
            push.started = float(seen.time[0])
            self._go(seen, Mode.PROBE, f"contact with object {push.object}")
            return self._push_step(seen)
        if move.failed:
            self._go(seen, Mode.REPLAN, move.failed)
        return move.command

    def _push_step(self, seen: Observation) -> Command:
        push = self._pushed()
        known = self.belief.objects[push.object]
        sighting = Sighting.of(seen, push.object)
        assert push.state is not None
        before = push.state.adapt
        firm = self.config.probe_room if self.mode is Mode.PROBE and not self._rolled(push, known) else None
        u, push.state, plan = self._controller.step(
            push.state, sighting, self._last_u, push.goal, push.around, np.array(known.half_extents), firm
        )
        if known.blind > 0.0 or push.blind:
            # A pose that was guessed, now or a sample ago, says nothing about the object.
            push.state = push.state._replace(adapt=before)
        push.blind = known.blind > 0.0
        known.adapt = push.state.adapt
        touching = np.hypot(*sighting.wrench[:2]) > self._controller.config.contact_force
        push.contact_time += DT if touching else 0.0
        push.since_contact = 0.0 if touching else push.since_contact + DT
        push.marks.append((push.contact_time, known.pose.copy()))
        self._judge(seen, push, known, bool(plan.ok))
        return command(u[:2], u[2], heading(known.pose, push.face), REACH, HAND_HEIGHT)

    def _judge(self, seen: Observation, push: Push, known: KnownObject, ok: bool) -> None:
        """Leave the push if it is over, hopeless or lost."""
        index, cfg = push.object, self.config
        if not ok:
            self._go(seen, Mode.RETREAT, "no roll-out of the model is finite: safe stop")
        elif known.blind > cfg.blind_limit:
            self._go(seen, Mode.RETREAT, f"object {index} has not been detected for {cfg.blind_limit:g} s")
        elif self.mode is Mode.PUSH and self._path_clear(seen, known):
            known.status = Status.PARKED
            self._go(seen, Mode.RETREAT, f"object {index} no longer blocks the path")
        elif self.mode is Mode.PUSH and np.linalg.norm(known.pose[:2] - push.goal[:2]) < cfg.at_goal:
            known.status = Status.PARKED
            self._go(seen, Mode.RETREAT, f"object {index} is at its goal")
        elif self.mode is Mode.PUSH and self._passed(push, known):
            self._go(seen, Mode.RETREAT, f"object {index} has gone past its goal, and can't be pulled")
        elif push.since_contact > cfg.lost_after and not self._rolls_ahead(float(seen.time[0]), push, known):
            self._go(seen, Mode.RETREAT, f"contact with object {index} lost for {cfg.lost_after:g} s")
        elif self._stalled(push):
            text = f"object {index} moved less than {cfg.stall_distance:g} m in {cfg.stall_time:g} s of contact"
            self._stuck(seen, push, known, text)
        elif float(seen.time[0]) - push.started > cfg.push_limit:
            self._go(seen, Mode.RETREAT, f"object {index} has been pushed for {cfg.push_limit:g} s")
        elif self._review_due(float(seen.time[0]), push, known):
            self._review(seen, push, known)

    def _review_due(self, now: float, push: Push, known: KnownObject) -> bool:
        if self.mode is Mode.PUSH:
            return push.contact_time >= push.reviewed_at + self.config.review_every
        late = now - push.started >= self.config.probe_limit and self._rolled(push, known)
        again = push.reviewed_at + self.config.doubt_every if push.reviewed_at else 0.0
        return push.contact_time >= max(self.config.probe_time, again) or late

    def _rolls_ahead(self, now: float, push: Push, known: KnownObject) -> bool:
        """Whether a probe still waits for what rolls ahead of the hands to be looked at."""
        waits = now - push.started < self.config.probe_limit + self.config.lost_after
        return self.mode is Mode.PROBE and waits and self._rolled(push, known)

    def _rolled(self, push: Push, known: KnownObject) -> bool:
        """A cart that rolls ahead of the hands gives little contact, but its motion tells as much."""
        return bool(push.marks) and float(np.linalg.norm(known.pose[:2] - push.marks[0][1][:2])) > self.config.rolled

    def _review(self, seen: Observation, push: Push, known: KnownObject) -> None:
        """The planning stage of Algorithm 1 on the roll-outs of the adapted model."""
        assert push.state is not None
        push.reviewed_at = push.contact_time
        half = np.array(known.half_extents)
        # K asks how far the object can be moved. A goal that is nearly reached, or already behind the object, would say
        # nothing about that, so a place ahead takes its part.
        far, reach = push.goal, self.config.planner.min_displacement
        ahead = heading(known.pose, push.face)
        direction = np.array([np.cos(ahead), np.sin(ahead)])
        if (push.goal[:2] - known.pose[:2]) @ direction < reach:
            far = np.array([*(known.pose[:2] + reach * direction), push.goal[2]])
        poses, _, costs = self._controller.planning_rollouts(push.state, far, push.around, half)
        around, position = self.belief.clearance(without=push.object), seen.robot_pose[0, :2]
        path = self._routes.free_path(position, known)
        if path is not None and self.mode is Mode.PROBE:
            self.plans.append((float(seen.time[0]), path.points))
        check = self._routes.collision_free(position, known, around, path)
        result = planning_stage(poses[:, -1], costs, known.pose, check, self.config.planner)
        best = np.argsort(costs)[:40]
        self.decisions.append(
            Decision(
                float(seen.time[0]), push.object, result.K, result.G, result.manipulable, result.goal, result.reason,
                poses[best][:, :, :2], result.candidates, far,
            )
        )  # fmt: skip
        if self.mode is Mode.PROBE and self._in_doubt(push, known, result.manipulable):
            return
        if self.mode is Mode.PUSH and not result.manipulable and self._gives_way(push, known):
            # What moves can be moved. K is small here because walls leave the roll-outs no way on.
            return
        known.manipulable = result.manipulable
        if not result.manipulable:
            self._stuck(seen, push, known, f"object {push.object} is not manipulable: {result.reason}")
            return
        if result.goal is not None:
            push.goal = result.goal
        if self.mode is Mode.PROBE:
            self._go(seen, Mode.PUSH, f"object {push.object} is manipulable: {result.reason}")

    def _in_doubt(self, push: Push, known: KnownObject, manipulable: bool) -> bool:
        """Whether the verdict of a planning stage of the probe has to wait for more contact."""
        cfg = self.config
        if manipulable:
            # What has hardly moved so far may hold against a firmer push as well, whatever the roll-outs expect of it.
            return not self._rolled(push, known) and push.contact_time < cfg.doubt_time
        return push.contact_time < (cfg.doubt_limit if self._gives_way(push, known) else cfg.doubt_time)

    def _gives_way(self, push: Push, known: KnownObject) -> bool:
        """Whether the object has moved or turned in the last second of contact."""
        recent = np.array([pose for t, pose in push.marks if t > push.contact_time - 1.0])
        recent[:, 2] = np.unwrap(recent[:, 2])
        x, y, yaw = np.ptp(recent, axis=0)
        return bool(np.hypot(x, y) + np.hypot(*known.half_extents) * yaw > self.config.gives_way)

    def _stuck(self, seen: Observation, push: Push, known: KnownObject, why: str) -> None:
        """End a push that leads no further. Only an object that this push has not moved counts as immovable."""
        moved = float(np.linalg.norm(known.pose[:2] - push.marks[0][1][:2]))
        if moved < self.config.moved and not self.config.goes_round:
            self._go(seen, Mode.RETREAT, f"{why}; tried again, since going round is not allowed")
        elif moved < self.config.moved:
            known.status, known.registered = Status.FIXED, known.pose
            known.failed_faces.add(push.side)
            self._go(seen, Mode.RETREAT, f"{why}; registered as an obstacle")
        else:
            known.status = Status.PARKED
            self._go(seen, Mode.RETREAT, f"{why}; but it has been moved {moved:.2f} m, and is left where it is")

    def _retreat(self, seen: Observation) -> Command:
        push = self._pushed()
        move = self._moves.retreat(seen, self.belief.objects[push.object].pose, push.face, self.transitions[-1].t)
        if move.over:
            self._go(seen, Mode.REPLAN, f"backed away from object {push.object}")
        return move.command

    # Questions and small steps.

    def _pushed(self) -> Push:
        assert self.push is not None, f"{self.mode} needs an object"
        return self.push

    def _path_clear(self, seen: Observation, known: KnownObject) -> bool:
        """Asked twice a second only: it plans two paths."""
        due = round(float(seen.time[0]) / DT) % 5 == 0
        return due and self._routes.path_clear(seen.robot_pose[0, :2], known)

    @staticmethod
    def _passed(push: Push, known: KnownObject) -> bool:
        ahead = heading(known.pose, push.face)
        offset = push.goal[:2] - known.pose[:2]
        return float(offset[0] * np.cos(ahead) + offset[1] * np.sin(ahead)) < -0.08

    def _stalled(self, push: Push) -> bool:
        recent = [p[:2] for t, p in push.marks if t > push.contact_time - self.config.stall_time]
        if push.contact_time < self.config.stall_time:
            return False
        return float(np.linalg.norm(np.ptp(np.array(recent), axis=0))) < self.config.stall_distance

    def _set_path(self, seen: Observation, path: Path) -> None:
        self.path = path
        self.plans.append((float(seen.time[0]), path.points))
        self._drive = drive.init()

    def _go(self, seen: Observation, target: Mode, reason: str) -> None:
        self.transitions.append(Transition(float(seen.time[0]), self.mode, target, reason))
        self.mode = target

    def _next_key(self) -> Array:
        self._key, key = jax.random.split(self._key)
        return key
