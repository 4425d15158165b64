"""Step-by-step simulation of a scenario: the world, the robot's sensing and navigator, and a history.

``run_episode`` runs one to its end. The live page steps one and changes the world between samples.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import mujoco
import numpy as np

from shmoo_mjx.base import custom
from shmoo_mjx.behavior.belief import Status
from shmoo_mjx.behavior.interaction import Machine
from shmoo_mjx.behavior.navigator import Navigator
from shmoo_mjx.behavior.policy import PolicyNavigator
from shmoo_mjx.behavior.push_task import PushTask, PushTaskConfig
from shmoo_mjx.behavior.state import Mode, NavigatorConfig
from shmoo_mjx.control.pushing import PushController
from shmoo_mjx.errors import ShmooError
from shmoo_mjx.geometry import se2
from shmoo_mjx.learning.contact_prior import kind_of
from shmoo_mjx.planning.maps import OccupancyGrid, occupied_rectangles
from shmoo_mjx.planning.scenario import Scenario
from shmoo_mjx.plant.condition import Condition
from shmoo_mjx.plant.scene import PARTS, Scene, build_scene
from shmoo_mjx.sensing import PERFECT, REAL, SensedEngine, SensedWorld, Senses
from shmoo_mjx.types import DT, Command, Observation

Point = Sequence[float]


@dataclass(frozen=True)
class Sample:
    """Ground truth of one sample, and the robot's command and estimate."""

    t: float
    """Time [s]."""
    robot_pose: np.ndarray
    """``[3]`` pose of the robot in {W}."""
    object_pose: np.ndarray
    """``[N, 3]`` poses of the objects in {W}; NaN before an object was added."""
    lean: np.ndarray
    """``[2]`` lean [rad]."""
    u: np.ndarray
    """``[3]`` command [rad]."""
    force: np.ndarray
    """``[2]`` total force of the hands in {R} [N]."""
    learned: dict[str, float] | None
    """Estimate of the pushed object (`online.summary`); None without a push."""
    learned_object: int
    """Index of that object, or -1."""
    state: int
    """Index of the navigator's mode."""


@dataclass
class History:
    """History of a simulation, one row per sample."""

    rows: list[Sample] = field(default_factory=list)
    """Ground truth, command and estimate."""
    qpos: list[np.ndarray] = field(default_factory=list)
    """``[nq]`` configurations, for rendering."""
    observations: list[Observation] = field(default_factory=list)
    """The navigator's inputs."""
    commands: list[Command] = field(default_factory=list)
    """The navigator's outputs."""
    goals: list[np.ndarray] = field(default_factory=list)
    """``[2]`` goal positions in {W} [m]."""
    late: list[dict[str, Any]] = field(default_factory=list)
    """Samples whose computation took longer than a sample time (real time only)."""
    falls: int = 0
    """Number of falls."""
    diverged: bool = False
    """Whether the physics diverged in the last sample. The simulation keeps the state before it."""
    wall_contacts: int = 0
    """Number of contacts of the robot with walls."""
    touching: bool = False
    """Whether the robot touched a wall in the last sample."""
    wall_parts: dict[str, int] = field(default_factory=dict)
    """Number of wall contacts of each part of the robot."""
    touches: list[dict[str, Any]] = field(default_factory=list)
    """Contacts with walls, as events."""

    @property
    def ended(self) -> bool:
        """Whether a fall or a divergence has ended the run."""
        return self.falls > 0 or self.diverged


def conditions_of(scenario: Scenario) -> list[Condition]:
    """The objects' conditions, drawn from family and seed, with the given properties replaced."""
    return [o.condition() for o in scenario.objects]


def scene_of(
    grid: OccupancyGrid,
    scenario: Scenario,
    conditions: list[Condition],
    *,
    senses: Senses = PERFECT,
    alter: Callable[[mujoco.MjSpec], None] = lambda spec: None,
) -> Scene:
    """The MuJoCo world: all walls of the map, the objects and the robot.

    All walls are included because a detour may lead anywhere. ``alter`` modifies the MJCF in place, after the changes
    of the robot's body.
    """
    walls = occupied_rectangles(grid, unknown_borders=True)
    placed = [(c, o.pose) for c, o in zip(conditions, scenario.objects, strict=True)]
    body = senses.adjust(scenario.seed)

    def adjust(spec: mujoco.MjSpec) -> None:
        body(spec)
        alter(spec)

    return build_scene(placed, scenario.start, walls, float(grid.origin[2]), adjust=adjust)


def navigator_of(
    grid: OccupancyGrid,
    scenario: Scenario,
    controller: PushController,
    senses: Senses,
    *,
    config: NavigatorConfig | None = None,
    first_status: Sequence[Status] | None = None,
    policy: str | None = None,
) -> Machine:
    """The controller of the robot in a run.

    It is the navigator, the push task if the scenario has a pose for an object, or the ``policy``
    "package.module:Name". Computing time and latency are those of ``senses``.

    Raises:
        ShmooError: there is a policy, but no goal for the robot.
    """
    config = replace(config or NavigatorConfig(), planning_time=senses.planning, latency=senses.latency)
    conditions = conditions_of(scenario)
    sizes, kinds = [c.half_extents for c in conditions], [kind_of(c) for c in conditions]
    if scenario.push_to is not None:
        if policy is not None:
            raise ShmooError(f"policy {policy}: it drives to a goal, and the scenario has push_to; give it a goal.")
        moves = PushTaskConfig(moves=config)
        return PushTask(
            grid, sizes, scenario.push_to, controller, index=0, seed=scenario.seed, config=moves, kinds=kinds
        )
    if policy is not None:
        maker = custom.named("policy", policy)
        return PolicyNavigator(
            policy, maker, grid, scenario.goal, sizes=sizes, controller=controller, seed=scenario.seed, config=config
        )
    return Navigator(
        grid,
        scenario.goal,
        sizes,
        controller,
        seed=scenario.seed,
        config=config,
        first_status=first_status,
        kinds=kinds,
    )


class Simulation:
    """Step-by-step simulation of one scenario. Arguments: see `run_episode`.

    Close it at the end (``contextlib.closing``).
    """

    def __init__(
        self,
        grid: OccupancyGrid,
        scenario: Scenario,
        controller: PushController,
        *,
        config: NavigatorConfig | None = None,
        first_status: Sequence[Status] | None = None,
        senses: Senses = REAL,
        policy: str | None = None,
    ) -> None:
        self.grid, self.scenario, self.senses, self.policy = grid, scenario, senses, policy
        self.conditions = conditions_of(scenario)
        self.scene = scene_of(grid, scenario, self.conditions, senses=senses)
        self.navigator = navigator_of(
            grid, scenario, controller, senses, config=config, first_status=first_status, policy=policy
        )
        self.history = History()
        # The task includes the initial pose of an object that is pushed to a pose.
        self.engine = SensedEngine([self.scene], senses, scenario.seed, poses_known=scenario.push_to is not None)
        self.world: SensedWorld = self.engine.init()
        self.observation = self.engine.observe(self.world)
        self.true = self.engine.true_observation(self.world)

    def close(self) -> None:
        """Stops the engine's threads."""
        self.engine.close()

    @property
    def time(self) -> float:
        """Simulated time [s]."""
        return float(self.true.time[0])

    @property
    def qpos(self) -> np.ndarray:
        """``[nq]`` configuration of the world, for rendering."""
        return np.array(self.world.physics[0, 1 : 1 + self.scene.model.nq])

    def decide(self, perceive: Callable[[Observation], Observation] = lambda obs: obs) -> Command:
        """The robot's next command, from the current observation. ``perceive`` may add a fault to the observation."""
        perceived = perceive(self.observation)
        command = self.navigator.tick(perceived)
        self._note(perceived, command)
        return command

    def advance(self, command: Command | None, spent: float | None = None) -> None:
        """Advances the world by one sample, or by as many as the computation really took.

        Args:
            command: the robot's command; None if the command is lost.
            spent: computing time on the wall clock [s], if it elapses in the simulated world too.
        """
        world, obs = self.engine.step(self.world, command, computing=spent)
        if spent is not None and spent > DT:
            late = {"t": round(float(obs.time[0]), 1), "state": str(self.navigator.mode)}
            self.history.late.append(late | {"ms": round(1e3 * spent)})
            for _ in range(int(spent / DT)):
                world, obs = self.engine.step(world, command, computing=0.0)
            # The controller assumes samples that are DT apart, so a longer step must not be used for learning.
            obs = obs._replace(detected=np.zeros_like(obs.detected))
        if self.engine.diverged(world)[0]:
            self.history.diverged = True
            return
        self.world, self.observation = world, obs
        self.true = self.engine.true_observation(self.world)
        self._count_contacts()
        self.history.falls += int(self.engine.fallen(self.world)[0])

    def change(self, scenario: Scenario) -> None:
        """Adds objects at the end of the list, or changes properties of existing objects.

        New objects appear at rest at their poses. All other objects stay where they are.

        Args:
            scenario: its objects begin with those of the current scenario, each of the same family.
        """
        before = self.scene
        # Everything that may fail comes first, so that a rejected change has no effect.
        conditions = conditions_of(scenario)
        scene = scene_of(self.grid, scenario, conditions, senses=self.senses)
        engine = SensedEngine([scene], self.senses, scenario.seed)
        world = engine.resume(self.world, before)
        self.engine.close()
        self.scenario, self.conditions, self.scene = scenario, conditions, scene
        self.engine, self.world = engine, world
        self.navigator.expect([c.half_extents for c in conditions], [kind_of(c) for c in conditions])
        self.observation = self.engine.observe(self.world)
        self.true = self.engine.true_observation(self.world)
        added = len(self.conditions) - len(before.conditions)
        if added:
            self._widen(added)

    def alter(self, change: Callable[[mujoco.MjSpec], None]) -> None:
        """Continues from the same state with an MJCF that ``change`` modifies in place, for example a floor's friction.

        The objects, the map and the robot's sensing stay the same.
        """
        self.scene = scene_of(self.grid, self.scenario, self.conditions, senses=self.senses, alter=change)
        self.engine.change([self.scene])

    def place(self, index: int, pose: Point) -> None:
        """Moves object ``index`` to the pose (x, y, yaw) in {W}, at rest."""
        physics, scene = self.world.truth.physics.copy(), self.scene
        poses = [*self.true.object_pose[0]]
        poses[index] = np.asarray(pose, dtype=float)
        q, v = 1 + scene.object_qpos[index], 1 + scene.model.nq + scene.object_qvel[index]
        physics[0, q : q + 7] = scene.placed(self.true.robot_pose[0], poses)[q - 1 : q + 6]
        ends = [*scene.object_qvel[index + 1 :], scene.model.nv]
        physics[0, v : 1 + scene.model.nq + ends[0]] = 0.0
        self.world = self.world._replace(truth=self.world.truth._replace(physics=physics))
        self.true = self.engine.true_observation(self.world)

    def shove(self, index: int, impulse: Point) -> None:
        """Applies the impulse (x, y) in {W} [N s] at the centre of mass of object ``index``."""
        physics, model = self.world.truth.physics.copy(), self.scene.model
        v = 1 + model.nq + self.scene.object_qvel[index]
        mass = model.body_subtreemass[model.body(f"object{index}/object").id]
        physics[0, v : v + 2] += np.asarray(impulse, dtype=float) / mass
        self.world = self.world._replace(truth=self.world.truth._replace(physics=physics))
        self.true = self.engine.true_observation(self.world)

    def _note(self, obs: Observation, command: Command) -> None:
        learned, true, history = self.navigator.learned, self.true, self.history
        index = -1 if learned is None else learned[0]
        wrench = true.wrench[0, :, :2].sum(axis=0)
        history.qpos.append(self.qpos)
        history.observations.append(obs)
        history.commands.append(command)
        history.goals.append(self.navigator.state.goal)
        history.rows.append(
            Sample(
                t=float(true.time[0]),
                robot_pose=np.asarray(true.robot_pose[0]),
                object_pose=np.asarray(true.object_pose[0]),
                lean=np.asarray(true.lean[0]),
                u=np.asarray(command.u[0]),
                force=np.asarray(se2.rotate(wrench, -true.robot_pose[0, 2])),
                learned=None if learned is None else learned[1],
                learned_object=index,
                state=list(Mode).index(self.navigator.mode),
            )
        )

    def _count_contacts(self) -> None:
        """Counts each contact with a wall once, regardless of its duration."""
        history, touching = self.history, bool(self.world.wall_contact[0])
        if touching and not history.touching:
            history.wall_contacts += 1
            parts = [PARTS[i] for i in np.flatnonzero(self.world.wall_parts[0])]
            for part in parts:
                history.wall_parts[part] = history.wall_parts.get(part, 0) + 1
            text = f"touches a wall with {' and '.join(parts)} in state {self.navigator.mode}"
            history.touches.append({"t": round(self.time, 2), "what": text})
        history.touching = touching

    def _widen(self, added: int) -> None:
        """Extends the history for new objects: NaN poses in the past, and their initial pose in ``qpos``."""
        rows, now = self.history.rows, self.qpos
        nowhere = np.full((added, 3), np.nan)
        for i, row in enumerate(rows):
            rows[i] = replace(row, object_pose=np.concatenate([row.object_pose, nowhere]))
        self.history.qpos = [np.concatenate([q, now[len(q) :]]) for q in self.history.qpos]
