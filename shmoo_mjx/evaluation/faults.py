"""Fault matrix: each fault in the scenes of the demo, and whether the robot recovers, stops safely or fails.

Faults are injected between the world, the sensing, the navigator and the motors, which get no notice of them. The true
state decides the outcome. A run in which the robot reports a goal that it has not reached is a silent wrong success.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from shmoo_mjx.behavior.state import Mode
from shmoo_mjx.errors import ShmooError
from shmoo_mjx.evaluation.experiment import Experiment, ExperimentConfig, Prepared, Setup
from shmoo_mjx.evaluation.result import ExperimentOptions, ExperimentResult
from shmoo_mjx.evaluation.tables import Section
from shmoo_mjx.evaluation.trials import controller_of
from shmoo_mjx.geometry import se2
from shmoo_mjx.planning.floorplan import demo_scenario
from shmoo_mjx.planning.maps import distance_field
from shmoo_mjx.planning.scenario import ObjectEntry
from shmoo_mjx.plant.observe import DIVERGED
from shmoo_mjx.report.tables import markdown_table
from shmoo_mjx.run.simulation import Simulation
from shmoo_mjx.types import DT, Command, Observation

OUTCOMES = ("recovered", "stopped safely", "failed", "did not occur")
_AWAY = (-50.0, -50.0, 0.0)
"""Pose in {W} of objects that are not in the scene yet or were taken away [m, m, rad]."""
_EXTRA: dict[str, dict[str, Any]] = {
    "door": {"size": [0.5, 0.8, 0.7], "mass": 40.0, "friction": 0.65},
    "person": {"size": [0.45, 0.45, 0.75], "mass": 40.0, "friction": 0.65},
    "box": {"size": [0.5, 0.5, 0.6], "mass": 4.0, "friction": 0.4},
}


@dataclass
class _Trial:
    """A run with one fault."""

    simulation: Simulation
    began: float | None = None
    first: Any = None
    """Observation at the start of the fault."""
    walker: Any = None
    """Pose ``[3]`` in {W} at which a person starts to walk, in the direction of its yaw [m, m, rad]."""
    walked: float = 0.0
    """Distance that the person has walked [m]."""

    @property
    def since(self) -> float:
        return self.simulation.time - (self.began or 0.0)

    @property
    def robot(self) -> np.ndarray:
        return np.asarray(self.simulation.true.robot_pose[0])

    def ahead(self, distance: float) -> Any:
        """Pose ``[3]`` in {W} on free floor at ``distance`` [m] from the robot, as close to straight ahead as possible.

        If there is none, the pose straight ahead.
        """
        clearance = distance_field(self.simulation.grid)
        turns = np.deg2rad([0, 20, -20, 40, -40, 60, -60, 90, -90, 180])
        poses = [se2.compose(self.robot, np.array([distance * np.cos(a), distance * np.sin(a), a])) for a in turns]
        return next((pose for pose in poses if float(clearance.at(pose[:2])) > 0.4), poses[0])


@dataclass(frozen=True)
class Fault:
    """A fault: its effect, its start and its duration."""

    what: str
    on: str = "push"
    """State of the navigator in which the fault starts, or "start" for any. The fault starts after 1 s in this state,
    or after 2 s of "follow path"."""
    lasts: float = np.inf
    """Duration [s]."""
    perceive: Callable[[_Trial, Observation], Observation] | None = None
    """Changes each observation during the fault."""
    once: Callable[[_Trial], None] | None = None
    """Changes the world or the robot at the start of the fault."""
    each: Callable[[_Trial], None] | None = None
    """Changes the world in every sample of the fault."""
    loses_commands: bool = False
    """Whether no command arrives during the fault."""
    extra: str | None = None
    """Additional object of the scene, a key of `_EXTRA`."""


def _blind(trial: _Trial, obs: Observation) -> Observation:
    first, none = trial.first, np.zeros_like(obs.object_twist)
    return obs._replace(
        object_pose=first.object_pose,
        object_twist=none,
        object_age=np.asarray(first.object_age) + trial.since,
        detected=np.zeros_like(obs.detected),
    )


def _swapped(trial: _Trial, obs: Observation) -> Observation:
    names = ("object_pose", "object_twist", "object_age", "detected", "wrench")
    return obs._replace(**{name: np.asarray(getattr(obs, name))[:, [1, 0]] for name in names})


def _ghost(trial: _Trial, obs: Observation) -> Observation:
    """The observation with the last object reported 1 m ahead of the robot."""
    pose, age, detected = (np.array(v) for v in (obs.object_pose, obs.object_age, obs.detected))
    pose[0, -1] = se2.compose(np.asarray(obs.robot_pose[0]), np.array([1.0, 0.0, 0.0]))
    age[0, -1], detected[0, -1] = 0.03, True
    return obs._replace(object_pose=pose, object_age=age, detected=detected)


def _frozen(trial: _Trial, obs: Observation) -> Observation:
    stuck, pose = np.asarray(trial.first.robot_pose), np.asarray(obs.robot_pose)
    relative = se2.relative(pose[:, None], np.asarray(obs.object_pose))
    moved = se2.compose(np.broadcast_to(stuck[:, None], relative.shape), relative)
    return obs._replace(robot_pose=stuck, robot_twist=np.zeros_like(obs.robot_twist), object_pose=moved)


def _felt(change: Callable[[np.ndarray, np.ndarray], np.ndarray]) -> Callable[[_Trial, Observation], Observation]:
    """A ``perceive`` that replaces the wrench by ``change`` of the true wrench and the wrench at the fault's start."""
    return lambda trial, obs: obs._replace(wrench=change(np.asarray(obs.wrench), trial.first.wrench))


def _jump(trial: _Trial) -> None:
    """Shift the estimate of {D} in {W} by 0.3 m. The localiser has to correct it."""
    world = trial.simulation.world
    sensor_state: Any = world.sensor_state
    frame = np.array(sensor_state.odometry.frame)
    frame[:, :2] += 0.3 * np.array([np.cos(2.0), np.sin(2.0)])
    odometry = sensor_state.odometry._replace(frame=frame)
    trial.simulation.world = world._replace(sensor_state=sensor_state._replace(odometry=odometry))


def _dead_shoulder(trial: _Trial) -> None:
    def cut(spec: mujoco.MjSpec) -> None:
        spec.actuator("robot/left_shoulder_pitch").gear = np.zeros(6)

    trial.simulation.alter(cut)


def _slow(trial: _Trial) -> None:
    simulation = trial.simulation
    senses, setup = simulation.senses, simulation.navigator.setup
    simulation.engine.senses = replace(senses, computing=3 * senses.computing)
    config = replace(setup.config, planning_time=3 * setup.config.planning_time)
    simulation.navigator.setup = setup._replace(config=config)


def _slippery(trial: _Trial) -> None:
    def wet(spec: mujoco.MjSpec) -> None:
        for geom in spec.geoms:
            if geom.name in ("floor", "robot/ball") or any(part in geom.name for part in ("sole", "wheel", "foot")):
                geom.friction = geom.friction * np.array([0.5, 1.0, 1.0])

    trial.simulation.alter(wet)


def _pushed_object(trial: _Trial) -> int:
    segment = trial.simulation.navigator.state.segment
    return 0 if segment is None else segment.object


def _shove(trial: _Trial) -> None:
    """Add 0.8 m/s to the robot's left to the velocity of the pushed object."""
    simulation = trial.simulation
    physics, scene = simulation.world.truth.physics.copy(), simulation.scene
    speed = 1 + scene.model.nq + scene.object_qvel[_pushed_object(trial)]
    yaw = trial.robot[2] + np.pi / 2
    physics[0, speed : speed + 2] += 0.8 * np.array([np.cos(yaw), np.sin(yaw)])
    simulation.world = simulation.world._replace(truth=simulation.world.truth._replace(physics=physics))


def _close(trial: _Trial) -> None:
    """Place the extra object at the robot's latest pose more than 1.2 m away from the current one."""
    driven = [row.robot_pose for row in trial.simulation.history.rows]
    behind: Any = next((p for p in reversed(driven) if np.hypot(*(p[:2] - trial.robot[:2])) > 1.2), None)
    if behind is not None:
        trial.simulation.place(-1, behind.tolist())


def _walk(trial: _Trial) -> None:
    """Move the person by one sample at 0.8 m/s, across the robot's way and 1.2 m ahead of its pose at the start.

    The person stops within 0.7 m of the robot and leaves the scene after 5 m.
    """
    if trial.walker is None:
        trial.walker = se2.compose(trial.robot, np.array([1.2, 2.0, -np.pi / 2]))
    gone = trial.walked + 0.8 * DT
    pose = np.array(_AWAY) if gone > 5.0 else se2.compose(trial.walker, np.array([gone, 0.0, 0.0]))
    if np.hypot(*(pose[:2] - trial.robot[:2])) > 0.7:
        trial.walked = gone
        trial.simulation.place(-1, pose.tolist())


FAULTS = {
    "none": Fault("nothing, for comparison", "start"),
    "camera_gone": Fault("no object is detected for 5 s", lasts=5.0, perceive=_blind),
    "tags_swapped": Fault("box and wheelchair carry each other's tags", "start", perceive=_swapped),
    "false_detection": Fault("the wheelchair is seen 1 m ahead for 1 s", "follow path", 1.0, perceive=_ghost),
    "odometry_jumps": Fault("the robot's estimated pose jumps by 0.3 m", "follow path", once=_jump),
    "odometry_frozen": Fault("the robot's estimated pose stands still for 2 s", "follow path", 2.0, perceive=_frozen),
    "wrench_stuck": Fault("the hands' force stays what it was", perceive=_felt(lambda wrench, first: first)),
    "wrench_nan": Fault(
        "the hands' force is no number", perceive=_felt(lambda wrench, first: np.full_like(wrench, np.nan))
    ),
    "wrench_sign": Fault("the hands' force has the wrong sign", "start", perceive=_felt(lambda wrench, first: -wrench)),
    "arm_motor_dead": Fault("the left shoulder has no torque", once=_dead_shoulder),
    "command_lost": Fault("no command arrives for 200 ms", lasts=0.2, loses_commands=True),
    "commands_stop": Fault("no command arrives any more", "follow path", loses_commands=True),
    "computing_slow": Fault("computing and planning take three times as long", "start", once=_slow),
    "floor_slippery": Fault("friction of the floor is halved", "start", once=_slippery),
    "object_taken": Fault(
        "the object that is pushed is taken away",
        once=lambda trial: trial.simulation.place(_pushed_object(trial), _AWAY),
    ),
    "object_added": Fault(
        "a box appears 1.2 m ahead",
        "follow path",
        once=lambda trial: trial.simulation.place(-1, trial.ahead(1.2).tolist()),
        extra="box",
    ),
    "object_shoved": Fault("the object that is pushed is shoved aside at 0.8 m/s", once=_shove),
    "door_closes": Fault("something heavy closes the way behind the robot", "follow path", once=_close, extra="door"),
    "person_walks": Fault("a person walks across the way", "follow path", 12.0, each=_walk, extra="person"),
}
"""Faults by name."""


def play(name: str, seed: int, weights: Path) -> dict[str, Any]:
    """The row of one run: the demo of ``seed`` with the fault ``name``."""
    fault = FAULTS[name]
    grid, scenario = demo_scenario(seed)
    if fault.extra is not None:
        extra = ObjectEntry(family="box", pose=_AWAY, properties=_EXTRA[fault.extra])
        scenario = scenario.model_copy(update={"objects": (*scenario.objects, extra)})
    with closing(Simulation(grid, scenario, controller_of(weights))) as simulation:
        trial, since = _Trial(simulation), 0.0
        while not simulation.navigator.finished and simulation.time < scenario.limits.time_s:
            since = since + DT if fault.on in ("start", str(simulation.navigator.mode)) else 0.0
            if trial.began is None and since > (2.0 if fault.on == "follow path" else 1.0):
                trial.began, trial.first = simulation.time, simulation.observation
                if fault.once is not None:
                    fault.once(trial)
            active = trial.began is not None and trial.since < fault.lasts - 1e-6
            if active and fault.each is not None:
                fault.each(trial)
            perceive = partial(fault.perceive, trial) if active and fault.perceive else (lambda obs: obs)
            command: Command | None = simulation.decide(perceive)
            if active and fault.loses_commands:
                command = None
            simulation.advance(command)
            if simulation.history.ended or (active and fault.loses_commands and trial.since > 10.0):
                break
        return {"fault": name, "seed": seed, **_judged(trial, fault)}


def _judged(trial: _Trial, fault: Fault) -> dict[str, Any]:
    simulation = trial.simulation
    navigator, record = simulation.navigator, simulation.history
    distance = float(np.hypot(*(trial.robot[:2] - np.asarray(simulation.scenario.goal))))
    speed = float(np.hypot(*np.asarray(simulation.true.robot_twist)[0, :2]))
    says_done = navigator.mode is Mode.DONE
    silent = says_done and distance > simulation.scenario.limits.goal_tolerance_m
    if trial.began is None:
        outcome, reason = "did not occur", f"the robot was never to {fault.on}"
    elif record.diverged:
        outcome, reason = "failed", DIVERGED
    elif record.falls:
        outcome, reason = "failed", f"fell while it was to {navigator.mode}"
    elif silent:
        outcome, reason = "failed", f"says that it is there and is {distance:.2f} m from the goal"
    elif says_done:
        outcome, reason = "recovered", f"goal reached to {distance:.2f} m"
    elif navigator.mode is Mode.FAILED and speed < 0.1:
        outcome, reason = "stopped safely", navigator.transitions[-1].reason
    elif np.isinf(fault.lasts) and fault.loses_commands and speed < 0.05:
        outcome, reason = "stopped safely", "the watchdog brought it to rest"
    else:
        outcome, reason = "failed", f"no end after {simulation.time:.0f} s, {navigator.mode}, at {speed:.2f} m/s"
    return {
        "outcome": outcome,
        "reason": reason,
        "falls": record.falls,
        "silent": silent,
        "wall_contacts": record.wall_contacts,
        "began_s": trial.began,
        "time_s": round(simulation.time, 1),
        "goal_distance_m": round(distance, 3),
    }


def summary(result: ExperimentResult) -> str:
    """Markdown table of faults and outcomes, with the numbers of falls and of wrongly reported goals."""
    lines = []
    for name, what in result.config["faults"].items():
        mine = [r for r in result.rows if r["fault"] == name]
        counts = [str(sum(r["outcome"] == outcome for r in mine)) for outcome in OUTCOMES]
        reasons = dict.fromkeys(r["reason"] for r in mine if r["outcome"] != "recovered")
        touched = sum(r["wall_contacts"] > 0 for r in mine)
        lines.append([what, *counts, str(touched), "; ".join(reasons)])
    table = markdown_table(["fault", *OUTCOMES, "touched a wall", "reasons"], lines)
    falls, silent = (result.metrics[name] for name in ("falls", "silent_wrong_successes"))
    told = f"{len(result.rows)} runs: {falls:g} falls, {silent:g} times a goal reported but not reached."
    return f"{table}\n\n{told}"


@dataclass(frozen=True)
class FaultTrials(ExperimentConfig):
    """Settings of the experiment. Each fault runs in the demos ``seed``, ``seed + 1``, ..."""

    runs: int = 20
    """Runs of each fault."""
    only: tuple[str, ...] = ()
    """Names of the faults to run; all if empty."""


def _prepare(options: ExperimentOptions, config: FaultTrials, folder: Path) -> Prepared:
    """The names of the faults to run.

    Raises:
        ShmooError: a name is unknown.
    """
    unknown = next((name for name in config.only if name not in FAULTS), None)
    if unknown is not None:
        raise ShmooError(f"--only {unknown}: there is no such fault; choose from {', '.join(FAULTS)}.")
    return Prepared(config.only or tuple(FAULTS), files=(options.weights_file,))


def _trials(setup: Setup[FaultTrials]) -> dict[str, tuple[str, int]]:
    seeds = range(setup.options.seed, setup.options.seed + setup.config.runs)
    return {f"{name}-{seed}": (name, seed) for seed in seeds for name in setup.data}


def _trial(setup: Setup[FaultTrials], trial: tuple[str, int]) -> list[dict[str, Any]]:
    return [play(*trial, setup.options.weights_file)]


def _metrics(setup: Setup[FaultTrials], rows: list[dict[str, Any]]) -> dict[str, int]:
    metrics = {"falls": sum(r["falls"] for r in rows), "silent_wrong_successes": sum(r["silent"] for r in rows)}
    counts = Counter((r["fault"], r["outcome"]) for r in rows)
    return metrics | {f"{f}_{o.replace(' ', '_')}": counts[f, o] for f in setup.data for o in OUTCOMES}


def _totals(result: ExperimentResult) -> str:
    rows = [row for row in result.rows if row["fault"] != "none"]
    counts = Counter(row["outcome"] for row in rows)
    falls, silent = (f"{result.metrics[name]:g}" for name in ("falls", "silent_wrong_successes"))
    head = ("faults", "runs", *OUTCOMES, "falls", "goal reported but not reached")
    row = [
        str(len({row["fault"] for row in rows})),
        str(len(rows)),
        *(str(counts[outcome]) for outcome in OUTCOMES),
        falls,
        silent,
    ]
    return markdown_table(head, [row])


def _shows(result: ExperimentResult) -> str:
    faulty, scene = ([row["outcome"] for row in result.rows if (row["fault"] == "none") == n] for n in (False, True))
    recovered = f"The robot reaches its goal in {faulty.count('recovered')} of {len(faulty)} runs with a fault."
    if not scene:
        return recovered
    reached = scene.count("recovered")
    return (
        f"{recovered} Without a fault it reaches it in {reached} of {len(scene)} runs. These take place in scenes like "
        "that of the paper's Fig. 1, with a box in a doorway and a wheelchair that can't be moved."
    )


EXPERIMENT = Experiment(
    Section(
        "Faults",
        "Does the robot recover or stop safely when something fails?",
        (_totals, summary),
        _shows,
        arguments=lambda config: f"--runs {config.get('runs')}",
        draws_conditions=False,
    ),
    FaultTrials(),
    quick=FaultTrials(runs=1),
    trials=_trials,
    trial=_trial,
    metrics=_metrics,
    prepare=_prepare,
    neutral=("runs", "only"),
    first_seed=900,
    printed=summary,
    about=lambda setup: {"faults": {name: FAULTS[name].what for name in setup.data}, "extra": _EXTRA},
)
