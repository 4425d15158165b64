"""Draws and runs the trials of the pushing experiment.

A trial has an unseen object, a goal, start poses of object and robot, a robot with its own parameters, and a change
during the push: extra mass, a brake on one wheel, or none.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from itertools import islice
from typing import Any, cast

import numpy as np

from shmoo_mjx.arrays import Array
from shmoo_mjx.base import custom
from shmoo_mjx.behavior.methods import PAPER, method_named
from shmoo_mjx.behavior.push_task import Pusher, PushTask
from shmoo_mjx.control.presets import PushConfig, pose_push_config
from shmoo_mjx.geometry import se2
from shmoo_mjx.learning.contact_prior import kind_of
from shmoo_mjx.learning.online import LearnerState
from shmoo_mjx.learning.weights import Weights
from shmoo_mjx.planning.maps import OccupancyGrid
from shmoo_mjx.plant.condition import GRAVITY, Condition
from shmoo_mjx.plant.objects import FAMILIES, draw_condition
from shmoo_mjx.plant.observe import DIVERGED, toppled
from shmoo_mjx.plant.scene import Scene, build_scene
from shmoo_mjx.sensing import REAL, SensedEngine, Senses

METHODS = ("ours", "frozen_prior", "contact_model", "oracle_coefficients", "quasi_static", PAPER)
"""Methods in this order: MPPI with online estimation of the contact parameters (ours); the same without adaptation; the
contact model without psi; the posterior from a long recording of the same object; no learned model; and the paper's
system (`shmoo_mjx.behavior.methods`)."""

OWN = "pushing controller"
"""Name of a user's own method in error messages."""

EVERYTHING = "everything"
STRATA = ("movable", "demanding", EVERYTHING)
"""Movable objects have no locked wheel and at most 32 N of resistance. Demanding objects are at the edge of the
training distribution or beyond, and all change during the push. The last stratum has all objects as drawn, and none
changes."""

GOALS = ((1.2, 0.0), (1.3, 0.28), (1.7, -0.42))
"""Positions of the three goals in {W} [m]: straight ahead, to the left, and farther to the right. An object starts near
the origin, with its x axis about along x of {W}. The paper shows its goals only in a figure and calls them dynamically
feasible. The yaw of a goal is therefore the yaw at the end of the arc that starts along x, which is twice the bearing
(24 and -28 deg). Light and heavy objects can follow these arcs (curvature 0.32 and 0.27 per metre)."""

_MOST = {"movable": 40.0, "demanding": 45.0}
"""Maximum resistance before and after the change [N]: about half of the force at the robot's lean limit."""
STRONGEST = 75.0
"""Resistance above which no push moves an object straight on [N]. A steady push at the lean limit
(`manipulable.steady_push`) moves boxes of 70 N but not of 80 N."""
KINDS = {
    "movable": "movable objects (no locked wheel, up to 32 N)",
    "locked": "objects with a locked wheel",
    "heavy": "objects of 32 to 75 N",
    "immovable": "objects of more than 75 N, which no push moves straight on",
}
"""Kinds of objects in the stratum "everything": name to label."""
_LEAST_HEAVY = 25.0
"""Minimum resistance of heavy demanding objects [N]."""
_DEMANDS = {
    "box": ("off_centre", "heavy", "floor"),
    "cart": ("off_centre", "heavy", "floor", "brake"),
    "wheelchair": ("off_centre", "floor", "brake"),
}
"""Demands by family. Successive runs take successive demands."""


@dataclass(frozen=True)
class Trial:
    """One trial. It is the same for every method."""

    family: str
    goal: int
    """Number of the goal, 1 to 3."""
    run: int
    """Number of the run of this family and goal, from 0."""
    condition: Condition
    changed: Condition
    """The object after the change; equal to ``condition`` if nothing changes."""
    change: str
    """Kind of the change: none, mass or brake."""
    change_at: float
    """Fraction of the distance to the goal after which the object changes [1]."""
    object_pose: tuple[float, float, float]
    """Pose of the object in {W} at the start [m, m, rad]."""
    robot_pose: tuple[float, float, float]
    """Pose of the robot in {W} at the start [m, m, rad]."""
    seed: int
    """Seed of the robot's parameters, its sensors and the controller."""
    stratum: str = STRATA[0]
    """One of STRATA."""
    demand: str = ""
    """Demand of a demanding object: off_centre, heavy, floor or brake."""

    @property
    def name(self) -> str:
        """Short name, unique in an experiment."""
        prefix = "" if self.stratum == STRATA[0] else f"{self.stratum}-"
        return f"{prefix}{self.family}-goal{self.goal}-{self.run:02d}"

    @property
    def goal_pose(self) -> np.ndarray:
        """Pose ``[3]`` of the object at the goal in {W} [m, m, rad]."""
        x, y = GOALS[self.goal - 1]
        return np.array([x, y, 2 * np.arctan2(y, x)])


def kind_by_resistance(condition: Condition) -> str:
    """The kind of an object, one of KINDS."""
    if condition.resistance > STRONGEST:
        return "immovable"
    if any(condition.locked):
        return "locked"
    return "movable" if condition.resistance <= 0.8 * _MOST["movable"] else "heavy"


def _movable(family: str, first_seed: int, count: int) -> list[tuple[Condition, str]]:
    """The first ``count`` movable objects without a brake, from ``first_seed`` on."""
    drawn = (draw_condition(family, seed) for seed in range(first_seed, first_seed + 1000))
    good = ((c, "") for c in drawn if kind_by_resistance(c) == "movable")
    return list(islice(good, count))


def _demanding(family: str, first_seed: int, count: int) -> list[tuple[Condition, str]]:
    """``count`` demanding objects with their demands. Objects that cannot meet their demand are drawn again."""
    objects: list[tuple[Condition, str]] = []
    # The offset of 400 keeps these objects apart from those of `_movable` within the same 1,000 seeds.
    for seed in range(first_seed + 400, first_seed + 1000):
        if len(objects) == count:
            break
        demand = _DEMANDS[family][len(objects) % len(_DEMANDS[family])]
        condition = draw_condition(family, seed)
        if any(condition.locked):
            continue
        condition = _demand(np.random.default_rng([seed, 13]), condition, demand)
        least = _LEAST_HEAVY if demand == "heavy" else 0.0
        if least <= condition.resistance <= 0.95 * _MOST["demanding"]:
            objects.append((condition, demand))
    return objects


def _everything(family: str, first_seed: int, count: int) -> list[tuple[Condition, str]]:
    """``count`` objects as drawn, with other seeds than those of `_movable` and `_demanding`."""
    return [(draw_condition(family, first_seed + 200 + i), "") for i in range(count)]


_OBJECTS = dict(zip(STRATA, (_movable, _demanding, _everything), strict=True))


def _demand(rng: np.random.Generator, condition: Condition, demand: str) -> Condition:
    """The object with one demand: its load far off the centre, more resistance, another floor, or a brake."""
    length, width, _ = condition.size
    if demand == "off_centre":
        # A wheelchair tips if its load is behind the rear axle.
        x = rng.uniform(0.25, 0.35) * length * (1 if condition.family == "wheelchair" else rng.choice([-1, 1]))
        y = rng.uniform(0.25, 0.35) * width * rng.choice([-1, 1])
        load = max(condition.payload, 0.7 * condition.mass)
        return replace(condition, payload=round(load, 3), payload_x=round(float(x), 3), payload_y=round(float(y), 3))
    if demand == "heavy":
        wanted = rng.uniform(_LEAST_HEAVY + 1.0, 0.9 * _MOST["demanding"])
        total = wanted * condition.total_mass / condition.resistance
        if total - condition.mass <= 80.0:
            return replace(condition, payload=round(max(float(total) - condition.mass, 0.0), 3))
        return condition
    if demand == "floor":
        # Training draws friction from 0.25 to 0.65 for soles, 0.008 to 0.05 for wheels. It is halved or doubled here.
        factor = float(rng.choice([0.5, 2.0]))
        rolling = tuple(round(factor * r, 5) for r in condition.rolling)
        return replace(condition, friction=round(factor * condition.friction, 4), rolling=rolling)
    return _changed(rng, condition, demand, _MOST["demanding"])


def _changed(rng: np.random.Generator, condition: Condition, kind: str, most: float) -> Condition:
    """The object with extra mass or with a brake on one wheel, with at most ``most`` [N] of resistance."""
    room = most - condition.resistance
    if kind == "mass":
        per_kilogram = condition.resistance / condition.total_mass
        extra = min(float(rng.uniform(0.2, 0.5)) * condition.total_mass, 15.0, room / per_kilogram)
        return replace(condition, payload=round(condition.payload + extra, 3))
    if kind == "brake":
        # A sliding wheel resists with mu times its load. A weaker brake lets the wheel turn against its drag.
        load = condition.total_mass * GRAVITY / 4
        wheel = int(rng.integers(4 if condition.family == "cart" else 2))
        rolling = list(condition.rolling)
        drag = min(float(rng.uniform(8.0, 20.0)), room, condition.friction * load)
        rolling[wheel] = round(rolling[wheel] + drag / load, 4)
        return replace(condition, rolling=tuple(rolling))
    return condition


def draw_trials(
    first_unseen: int, seed: int, runs: int, *, goals: tuple[int, ...] = (1, 2, 3), stratum: str = STRATA[0]
) -> list[Trial]:
    """All trials of a stratum: families x goals x runs. Run r of a family has the same object for each goal.

    Args:
        first_unseen: first seed of the objects.
        seed: seed of the poses, changes and robots, together with ``first_unseen``.
        runs: number of objects of each family.
        goals: numbers of the goals, 1 to 3.
        stratum: one of STRATA.
    """
    trials = []
    stream = [at] if (at := STRATA.index(stratum)) else []
    for number, family in enumerate(FAMILIES):
        for run, (condition, demand) in enumerate(_OBJECTS[stratum](family, first_unseen, runs)):
            for goal in goals:
                rng = np.random.default_rng([seed, first_unseen, number, goal, run, *stream])
                kinds: tuple[str, ...] = ("none", "mass") if family == "box" else ("none", "mass", "brake")
                kinds = {"demanding": kinds[1:], EVERYTHING: ("none",)}.get(stratum, kinds)
                kind = str(rng.choice(kinds))
                shift = rng.uniform([-0.1, -0.1, -np.deg2rad(8)], [0.1, 0.1, np.deg2rad(8)])
                angle, far = rng.uniform(-np.pi, np.pi), rng.uniform(1.2, 1.9)
                robot = (float(far * np.cos(angle)), float(far * np.sin(angle)), float(rng.uniform(-np.pi, np.pi)))
                trials.append(
                    Trial(
                        family, goal, run, condition, _changed(rng, condition, kind, _MOST.get(stratum, 0.0)), kind,
                        float(rng.uniform(0.25, 0.6)), tuple(shift.tolist()), robot, int(rng.integers(2**31)),
                        stratum, demand,
                    )
                )  # fmt: skip
    return trials


def scene_of_trial(trial: Trial, condition: Condition, senses: Senses) -> Scene:
    """The scene of a trial with the parameters of the trial's robot."""
    return build_scene([(condition, trial.object_pose)], trial.robot_pose, adjust=senses.adjust(trial.seed))


def task_of(
    condition: Condition, goal: Array, pusher: Pusher, *, seed: int, adapt: LearnerState | None = None
) -> PushTask:
    """The task of pushing an object near the origin of an open floor to the pose ``goal [3]`` in {W}."""
    grid = OccupancyGrid(np.zeros((240, 240), np.int8), 0.05, (-6.0, -6.0, 0.0))
    kinds = [kind_of(condition)]
    return PushTask(grid, [condition.half_extents], goal, pusher, seed=seed, adapt=adapt, kinds=kinds)


def _pusher(method: str, weights: Weights, config: PushConfig) -> Pusher:
    from shmoo_mjx.control.pushing import PushController
    from shmoo_mjx.control.quasi_static import QuasiStaticPusher

    if method == PAPER:
        return method_named(PAPER).controller(to_pose=True)
    if method not in METHODS:
        make = custom.named(OWN, method)
        return cast(Pusher, custom.call(OWN, method, lambda: make(weights, config)))
    if method == "quasi_static":
        return QuasiStaticPusher(config.speed)
    if method == "contact_model":
        weights = weights._replace(
            config=replace(weights.config, object=replace(weights.config.object, residual=False))
        )
    return PushController(weights, replace(config, adapts=method in ("ours", "contact_model")))


def oracle_coefficients(weights: Weights, condition: Condition, seed: int) -> LearnerState:
    """a* of Eq. 5 from recorded pushes of the same object with perfect sensing. It does not change afterwards."""
    import jax.numpy as jnp

    from shmoo_mjx.data.collect import CollectConfig, record
    from shmoo_mjx.data.store import Dataset
    from shmoo_mjx.learning.samples import samples_from_dataset
    from shmoo_mjx.learning.weights import posterior_from_recording

    config = CollectConfig(episodes=8, seconds=10.0)
    arrays = next(iter(record(config, [condition], seed)))
    rows = samples_from_dataset(Dataset(["object"], [condition.to_dict()], [arrays], {}))
    return posterior_from_recording(weights, *(jnp.asarray(a[0]) for a in rows[:3]))


class Runner:
    """Runs trials of all methods in one process and compiles the controller of each method once."""

    def __init__(
        self, weights: Weights, time_limit: float, senses: Senses = REAL, config: PushConfig | None = None
    ) -> None:
        self.weights, self.time_limit, self.senses = weights, time_limit, senses
        self.config = config or pose_push_config()
        self._pushers: dict[str, Pusher] = {}

    def run(self, trial: Trial, method: str) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
        """Run one trial with one of METHODS or a user's own method.

        Returns:
            The row of the trial, and its track: t, object_pose, robot_pose (true poses), phase, qpos, lean.
        """
        if method not in self._pushers:
            self._pushers[method] = _pusher(method, self.weights, self.config)
        scene = scene_of_trial(trial, trial.condition, self.senses)
        # The robot knows the pose of the object, because detection is not part of the task.
        engine = SensedEngine([scene], self.senses, trial.seed, poses_known=True)
        adapt, adapt_after = None, None
        if method == "oracle_coefficients":
            adapt = oracle_coefficients(self.weights, trial.condition, trial.seed % 10_000)
            adapt_after = oracle_coefficients(self.weights, trial.changed, trial.seed % 10_000)
        pusher = self._pushers[method]
        task = task_of(trial.condition, trial.goal_pose, pusher, seed=trial.seed, adapt=adapt)
        start = np.array(trial.object_pose[:2])
        way = float(np.linalg.norm(trial.goal_pose[:2] - start))
        rows: list[tuple[Any, ...]] = []
        with engine:
            world = engine.init()
            obs, true = engine.observe(world), engine.true_observation(world)
            changed_at: float | None = None
            fell, lost = False, False
            while (
                not task.finished and (now := float(np.asarray(obs.time)[0])) < self.time_limit and not (fell or lost)
            ):
                gone = float(np.linalg.norm(true.object_pose[0, 0, :2] - start)) / way
                if changed_at is None and trial.change != "none" and gone > trial.change_at:
                    changed_at = now
                    engine.change([scene_of_trial(trial, trial.changed, self.senses)])
                    if adapt_after is not None:
                        task.know(adapt_after)
                tick = partial(task.tick, obs)
                command = tick() if method in METHODS else custom.call(OWN, method, tick)
                after = engine.step(world, command)
                lost = bool(engine.diverged(after[0])[0])
                if not lost:  # a diverged state is dropped
                    world, obs = after
                    true, fell = engine.true_observation(world), bool(engine.fallen(world)[0])
                poses = float(np.asarray(true.time)[0]), true.object_pose[0, 0], true.robot_pose[0], str(task.mode)
                rows.append((*poses, world.physics[0, 1 : 1 + scene.model.nq].copy(), float(np.hypot(*true.lean[0]))))
        names = ("t", "object_pose", "robot_pose", "phase", "qpos", "lean")
        track = {name: np.array(column) for name, column in zip(names, zip(*rows, strict=True), strict=True)}
        row = _row(trial, method, task, track, scene=scene, changed_at=changed_at, fell=fell)
        if lost:
            row |= {"success": False, "ended": "diverged", "reason": DIVERGED}
        return row, track | {"qpos": track["qpos"].astype(np.float32)}


def _row(
    trial: Trial,
    method: str,
    task: PushTask,
    track: dict[str, np.ndarray],
    *,
    scene: Scene,
    changed_at: float | None,
    fell: bool,
) -> dict[str, Any]:
    final, goal = track["object_pose"][-1], trial.goal_pose
    offset = float(np.linalg.norm(final[:2] - goal[:2]))
    turned = float(np.rad2deg(abs(float(se2.wrap(final[2] - goal[2])))))
    over = bool(toppled(scene, track["qpos"]).any())
    return {
        "trial": trial.name,
        "method": method,
        **{name: getattr(trial, name) for name in ("family", "goal", "run", "stratum", "demand", "change")},
        "object_seed": trial.condition.seed,
        "kind": kind_by_resistance(trial.condition) if trial.stratum == EVERYTHING else "",
        "object": trial.condition.describe(),
        "changed_at_s": changed_at,
        "offset_m": offset,
        "yaw_error_deg": turned,
        "success": offset <= 0.25 and turned <= 20.0 and not fell and not over,
        "fell": fell,
        "toppled": over,
        "time_s": float(track["t"][-1]),
        "pushes": task.pushes,
        "worst_lean_rad": float(track["lean"].max()),
        "arm_margin_rad": _arm_margin(scene, track["qpos"]),
        "final_x": float(final[0]),
        "final_y": float(final[1]),
        "ended": str(task.mode) if task.finished else "time is up",
        "reason": task.transitions[-1].reason if task.transitions else "",
        "events": [[round(e.t, 1), str(e.target), e.reason] for e in task.transitions],
    }


def _arm_margin(scene: Scene, qpos: np.ndarray) -> float:
    """Minimum distance of the arms' joints from their limits over ``qpos [T, nq]`` [rad]."""
    names = [
        f"robot/{side}_{part}" for side in ("left", "right") for part in ("shoulder_yaw", "shoulder_pitch", "elbow")
    ]
    joints = [scene.model.joint(name) for name in names]
    arm, (low, high) = qpos[:, [j.qposadr[0] for j in joints]], np.array([j.range for j in joints]).T
    return float(np.minimum(arm - low, high - arm).min())
