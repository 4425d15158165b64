"""A world of points and rectangles for the navigator, with no physics worth the name, and a stand-in for the pushing
controller that leans forward and rolls out what the toy object would do: enough for the state machine, and fast."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
from toy import toy_scenario

from shmoo_mjx.behavior.belief import Status
from shmoo_mjx.behavior.navigator import Navigator
from shmoo_mjx.behavior.state import Mode, NavigatorConfig
from shmoo_mjx.control.equilibrium_lean import arms_lean
from shmoo_mjx.geometry import se2
from shmoo_mjx.geometry.faces import corners_of, faces_of
from shmoo_mjx.geometry.hands import HAND_RADIUS
from shmoo_mjx.learning import adaptation
from shmoo_mjx.learning.adaptation import AdaptState
from shmoo_mjx.planning.maps import distance_field
from shmoo_mjx.planning.reach import SAMPLES, STEPS, Options, Outcomes
from shmoo_mjx.plant.robot import shmoobot
from shmoo_mjx.types import DT, Command, Observation

HALF = (0.25, 0.275)
FACES = np.array([*faces_of(HALF), *corners_of(HALF)])
"""Sides, then corners ``[n, 4]``."""
NEAR = np.hypot(*HALF) + 0.1
"""Hands farther than this from the rectangle's centre touch neither a side nor a corner [m]."""


class State(NamedTuple):
    """Stands for the pushing controller's memory."""

    adapt: AdaptState
    face: np.ndarray
    pose: np.ndarray
    samples: int = 0
    """How many samples were learned from."""


class Stand(SimpleNamespace):
    """Stands for the pushing controller: leans forward while slow, and foresees what ``world`` would do."""

    def __init__(self, world: World) -> None:
        super().__init__(world=world, rooms=[], foresees=False)

    def init(
        self, now: Any, face: Any, half: Any, key: Any, *, adapt: AdaptState | None = None, kind: Any = None
    ) -> State:
        return State(adapt or adaptation.init(np.zeros(18), np.eye(18), np.eye(3)), face, now.object_pose)

    def step(
        self, state: State, now: Any, *, governor_room: float | None = None, **task: Any
    ) -> tuple[np.ndarray, State, Any]:
        self.rooms.append(governor_room)
        assert np.isfinite(now.object_pose).all() and np.isfinite(now.object_twist).all()
        forward = se2.rotate(now.robot_twist[:2], -now.robot_pose[2])
        lean = 0.1 * np.clip(0.25 - forward[0], -0.3, 0.3), -0.1 * forward[1]
        after = state._replace(pose=now.object_pose, samples=state.samples + bool(now.detected))
        return np.array([*lean, 0.0]), after, SimpleNamespace(ok=True)

    def coast(self, state: State) -> np.ndarray:
        return state.pose

    def _foresees_motion(self) -> bool:
        return bool(self.foresees or (self.world.movable and self.world.foreseen))

    def foresee(self, adapt: Any, kind: Any, pose: Any, half: Any, options: Options, seed: int) -> Outcomes:
        """Before a push everything follows it at walking pace; after it, what the world says."""
        moves = self._foresees_motion() or adapt is None
        ahead = np.asarray(pose)[2] + options.face[:, 2] if len(options.face) else np.zeros(0)
        way = (0.3 if moves else 0.0) * DT * np.arange(1, STEPS + 1)
        places = pose[:2] + way[:, None] * np.stack([np.cos(ahead), np.sin(ahead)], -1)[:, None, None]
        yaw = np.full((*places.shape[:3], 1), pose[2])
        objects = np.broadcast_to(np.concatenate([places, yaw], -1), (len(ahead), SAMPLES, STEPS, 3))
        robot = objects - 0.75 * np.stack([np.cos(ahead), np.sin(ahead), 0 * ahead], -1)[:, None, None]
        return Outcomes(objects, robot)

    def planning_rollouts(
        self, state: State, goal: Any, around: Any, half: Any
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        angle = state.pose[2] + state.face[2]
        reach = np.linspace(0.1, 1.2, 60) if self._foresees_motion() else np.full(60, 0.01)
        along = reach[:, None] * np.array([np.cos(angle), np.sin(angle)])
        ends = np.concatenate([state.pose[:2] + along, np.full((60, 1), state.pose[2])], axis=1)
        paths = np.linspace(state.pose, ends, 6)[1:].swapaxes(0, 1)
        return paths, paths[..., :2], np.linalg.norm(ends[:, :2] - goal[:2], axis=1)


class World:
    """A disc that accelerates as it leans, and a rectangle that it pushes without slip, or that stops it."""

    def __init__(self, start: tuple[float, float, float], box: tuple[float, float, float], movable: bool) -> None:
        self.pose, self.velocity = np.array(start), np.zeros(2)
        self.box, self.box_twist = np.array(box), np.zeros(3)
        self.movable, self.resistance, self.foreseen = movable, 12.0, True
        self.lean, self.lean_rate, self.reach, self.force = np.zeros(2), np.zeros(2), 0.2, np.zeros(2)
        self.time = 0.0

    def observe(self) -> Observation:
        hands = np.array([[[self.reach, 0.1, 0.4], [self.reach, -0.1, 0.4]]])
        twist = np.array([[*self.velocity, 0.0]])
        wrench = np.array([[[*self.force, 0.0]]])
        # The low-level control leans back for the arms, and is commanded without that.
        parts = (self.pose, twist[0], self.lean - arms_lean(hands[0]), self.lean_rate)
        robot = [np.array([p], dtype=float) for p in parts]
        return Observation(
            np.array([self.time]), *robot, hands, self.box[None, None].copy(), self.box_twist[None, None], wrench,
            np.zeros(1), np.zeros((1, 1)), np.array([[True]]),
        )  # fmt: skip

    def step(self, command: Command) -> Observation:
        a, _, c = shmoobot().flatness
        before = self.box.copy()
        self.force = np.zeros(2)
        for _ in range(10):
            rate = (command.u[0, :2] - self.lean) / 0.1
            self.lean, self.lean_rate = self.lean + rate * DT / 10, rate
            turn = se2.wrap(command.yaw[0] - self.pose[2])
            self.pose[2] = se2.wrap(self.pose[2] + np.clip(turn, -0.15, 0.15) / 10)
            self.velocity = self.velocity + c / a * se2.rotate(self.lean, self.pose[2]) * DT / 10
            self.pose[:2] += self.velocity * DT / 10
            self.reach += np.clip(command.reach[0] - self.reach, -0.04, 0.04)
            self._touch()
        self.box_twist = (self.box - before) / DT
        self.time += DT
        return self.observe()

    def _touch(self) -> None:
        """Press the rectangle, or be stopped by it, where the hands are inside one of its faces."""
        ahead = np.array([np.cos(self.pose[2]), np.sin(self.pose[2])])
        tip = self.pose[:2] + (self.reach + HAND_RADIUS) * ahead
        # Most of the time nothing is touched.
        if np.hypot(*(tip - self.box[:2])) > NEAR:
            return
        hand = np.array([*tip, self.pose[2]])
        pressed = _inside(se2.relative(se2.compose(self.box, FACES[:, :3]), hand), FACES[:, 3])
        for face in FACES[pressed]:
            local = se2.relative(se2.compose(self.box, face[:3]), np.array([*tip, self.pose[2]]))
            if _inside(local, face[3]):
                normal = np.array([np.cos(self.box[2] + face[2]), np.sin(self.box[2] + face[2])])
                self.force = (self.resistance if self.movable else 40.0) * normal
                if self.movable:
                    self.box[:2] += local[0] * normal
                else:
                    self.pose[:2] -= local[0] * normal
                    self.velocity = self.velocity - max(self.velocity @ normal, 0.0) * normal


def _inside(local: np.ndarray, half_width: Any) -> Any:
    """Whether a hand at ``local`` in the frame of a face presses it."""
    depth, aside, turned = local[..., 0], np.abs(local[..., 1]), np.abs(local[..., 2])
    return (depth > 0.0) & (depth < 0.2) & (aside < half_width) & (turned < 0.5)


def run(
    doors: int = 2,
    movable: bool = True,
    config: NavigatorConfig | None = None,
    happens: Callable[[World, Navigator], None] = lambda world, navigator: None,
    sees: Callable[[Observation], Observation] = lambda seen: seen,
    first_status: list[Status] | None = None,
    seconds: float = 120.0,
) -> tuple[Navigator, World]:
    """One run in the toy scenario; what happens in the world and what is seen of it may be tampered with."""
    grid, scenario = toy_scenario(doors, movable)
    world = World(scenario.start, scenario.objects[0].pose, movable)
    navigator = Navigator(
        grid, scenario.goal, [HALF], Stand(world), config=config or NavigatorConfig(), first_status=first_status
    )  # type: ignore[arg-type]
    seen, walls = world.observe(), distance_field(grid)
    while not navigator.finished and world.time < seconds:
        command = navigator.tick(sees(seen))
        happens(world, navigator)
        seen = world.step(command)
        assert walls.at(world.pose[:2]) > 0.15, f"the robot hits a wall at {world.time:.1f} s in state {navigator.mode}"
    return navigator, world


@cache
def plain_run(doors: int, movable: bool = True) -> tuple[Navigator, World]:
    """A run in which nothing happens. Tests share it and do not change it."""
    return run(doors, movable)


def visited(navigator: Navigator) -> set[Mode]:
    return {t.target for t in navigator.transitions}


def reasons(navigator: Navigator) -> str:
    return "; ".join(t.reason for t in navigator.transitions)


def said(navigator: Navigator) -> str:
    return "; ".join(note.text for note in navigator.notes)
