"""Experiment `outcomes`: how well are outcomes of pushes predicted?

The pushing controller pushes an unseen object for 5 s of contact with the robot's own sensors. This gives a posterior
of the object's dynamics. Then the quasi-static law of `quasi_static` pushes the object on three faces in the plant.
`planning.reach` predicts these pushes from their starts, with the posterior and with the prior of the object's family.
The experiment compares the object's pose after the same path length, whether it moves that far within the roll-out, and
whether it comes that far along the push. A second robot repeats each push. The difference between the robots cannot be
predicted.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any, NamedTuple

import jax
import numpy as np

from shmoo_mjx.arrays import Float
from shmoo_mjx.behavior.skills import one_push
from shmoo_mjx.behavior.skills.approach import CONTACT_GAP
from shmoo_mjx.control import equilibrium_lean
from shmoo_mjx.control.observation import ObjectObservation
from shmoo_mjx.control.speed import SpeedProfile
from shmoo_mjx.evaluation.experiment import Experiment, ExperimentConfig, Setup
from shmoo_mjx.evaluation.outcomes_measures import (
    STRATA,
    covered,
    draw_figure,
    errors,
    measure,
    median_pose,
    outcomes_tables,
)
from shmoo_mjx.evaluation.pushing_trials import task_of
from shmoo_mjx.evaluation.result import ExperimentResult
from shmoo_mjx.evaluation.tables import Section, measured, number, percent
from shmoo_mjx.evaluation.trials import controller_of
from shmoo_mjx.geometry import se2
from shmoo_mjx.geometry.faces import faces_of, stand_off
from shmoo_mjx.learning.contact_prior import kind_of
from shmoo_mjx.learning.online import LearnerState
from shmoo_mjx.planning.reach import STEPS, foresight_of, goal_ahead, probability_to_come
from shmoo_mjx.plant.condition import Condition
from shmoo_mjx.plant.objects import FAMILIES, draw_condition
from shmoo_mjx.plant.scene import build_scene
from shmoo_mjx.sensing import SensedEngine, Senses, senses_named
from shmoo_mjx.types import DT, Observation

_UNFOLDING = 1.0
"""Duration of extending the arms [s]."""
_TO_CONTACT = 8.0
"""Time without contact after which a push is left out [s]."""
_LONGEST_LEARNING = 40.0
"""Longest duration of learning including the approach [s]."""
_SHOWN = 16
"""Number of predicted ends in a row, for the figure."""
_AT_LEAST = 0.25
"""Least share of samples that move as far for a comparison of poses."""


@dataclass(frozen=True)
class OutcomesConfig(ExperimentConfig):
    """Size of the experiment, SI units."""

    objects: int = 60
    """Families take turns; of carts and wheelchairs every second one has one locked wheel, all other wheels roll."""
    contact_s: float = 5.0
    """Contact of the push that is learned from [s]."""
    longest_s: float = 8.0
    """Longest push that is learned from [s]."""
    pushes: int = 3
    """Of each object, on different faces."""
    bearing: float = 0.5
    """Largest direction of a push's goal beside straight ahead [rad], as the navigator's options have it."""
    distance: float = 0.8
    """Path of the object's centre after which poses are compared [m]."""


class _Push(NamedTuple):
    """One push that is predicted."""

    side: int
    bearing: float
    face: Float[np.ndarray, "4"]
    goal: Float[np.ndarray, "3"]


def draw_object(index: int, first_seed: int) -> Condition:
    """Object ``index``, as drawn but for its brakes: none, or one on every second cart and wheelchair."""
    family, number = FAMILIES[index % len(FAMILIES)], index // len(FAMILIES)
    drawn = draw_condition(family, first_seed + index)
    wheel = None
    if number % 2 and drawn.rolling:
        # A wheelchair's brakes act on its rear wheels.
        wheel = int(np.random.default_rng([first_seed + index, 3]).integers(2 if family == "wheelchair" else 4))
    return draw_condition(family, first_seed + index, {"locked": [i == wheel for i in range(len(drawn.locked))]})


def _trial(setup: Setup[OutcomesConfig], index: int) -> list[dict[str, Any]]:
    """One row for each push of an object that was felt."""
    config, options, origin = setup.config, setup.options, np.zeros(3)
    condition = draw_object(index, options.first_unseen)
    robots = np.random.default_rng([options.seed, index, 1]).integers(2**31, size=2)
    rng, faces, senses = (
        np.random.default_rng([options.seed, index]), faces_of(condition.half_extents), senses_named(options.senses)
    )  # fmt: skip
    controller, kind = controller_of(options.weights_file), kind_of(condition)
    foresight = foresight_of(controller)
    learned = _learned(config, condition, faces[rng.integers(4)], controller, senses=senses, seed=int(robots[0]))
    pushes = []
    for side in rng.permutation(4)[: config.pushes]:
        bearing = float(rng.uniform(-config.bearing, config.bearing))
        pushes.append(_Push(int(side), bearing, faces[side], goal_ahead(origin, faces[side], bearing)))
    seeds = np.repeat(robots, len(pushes)).tolist()
    tracks = _pushed(condition, [*pushes, *pushes], controller.config.speed, senses=senses, seeds=seeds)
    rows = []
    for push, track, other in zip(pushes, tracks, tracks[len(pushes) :], strict=False):
        if track is None:
            continue
        row = {"object": index, "family": condition.family, "description": condition.describe()}
        row |= {"stratum": "locked" if any(condition.locked) else "free", "side": push.side, "bearing": push.bearing}
        row["ahead"] = float(push.face[2])
        row |= {"known": learned is not None, **_true(push, track, other, config.distance)}
        for name, adapt in (("posterior", learned), ("prior", None)):
            predicted = foresight.sampled_poses(
                adapt, kind, track[0], condition.half_extents, face=push.face, goal=push.goal
            )
            compared = _compared(row, predicted, push, track[0], distance=config.distance)
            row |= {f"{name}_{key}": value for key, value in compared.items()}
        rows.append(row)
    return rows


def _learned(
    config: OutcomesConfig, condition: Condition, face: np.ndarray, controller: Any, *, senses: Senses, seed: int
) -> LearnerState | None:
    """What the pushing controller learns of the object at the origin in its first seconds of pushing straight on; None
    if it did not get there."""
    robot = stand_off(np.zeros(3), face, 2 * CONTACT_GAP)
    scene = build_scene([(condition, (0.0, 0.0, 0.0))], robot.tolist(), adjust=senses.adjust(seed))
    task = task_of(condition, goal_ahead(np.zeros(3), face), controller, seed=seed)
    with SensedEngine([scene], senses, seed, poses_known=True) as engine:
        world = engine.init()
        obs = engine.observe(world)
        while not task.finished and (now := float(np.asarray(obs.time)[0])) < _LONGEST_LEARNING:
            push = task.segment.push if task.segment is not None else None
            if push and (push.contact_time >= config.contact_s or now - push.started >= config.longest_s):
                break
            world, obs = engine.step(world, task.tick(obs))
            if engine.fallen(world)[0]:
                break
    return task.adapt


def _pushed(
    condition: Condition, pushes: list[_Push], speed: SpeedProfile, *, senses: Senses, seeds: list[int]
) -> list[np.ndarray | None]:
    """True poses ``[1 + T, 3]`` of the object at the origin from the first touch on, for each push by the robot of that
    seed. NaN after a fall; None where the object was not felt in time."""
    count, half = len(pushes), np.array(condition.half_extents)
    robots = [stand_off(np.zeros(3), push.face, CONTACT_GAP) for push in pushes]
    scenes = [
        build_scene([(condition, (0.0, 0.0, 0.0))], robot.tolist(), adjust=senses.adjust(seed))
        for robot, seed in zip(robots, seeds, strict=True)
    ]
    faces, goals = (np.array([getattr(p, name) for p in pushes], np.float32) for name in ("face", "goal"))
    task = one_push.WorldGoal(faces, np.tile(np.float32(half), (count, 1)), goals)
    begin, step = _policy(speed)
    offsets, up = [equilibrium_lean.init()] * count, np.ones(count, bool)
    tracks, phases = [], []
    with SensedEngine(scenes, senses, seeds, poses_known=True) as engine:
        world = engine.init()
        obs, true, state = engine.observe(world), engine.true_observation(world), None
        for sample in range(round(_TO_CONTACT / DT) + STEPS):
            tracks.append(np.where(up[:, None], true.object_pose[:, 0], np.nan))
            each = [jax.tree.map(lambda x, w=w: np.asarray(x)[w : w + 1], obs) for w in range(count)]
            offsets = [equilibrium_lean.step(offset, one) for offset, one in zip(offsets, each, strict=True)]
            balanced = _balanced(offsets, each, senses.latency)
            state = begin(balanced, task) if state is None else state
            command, state = step(state, balanced, task, np.full(count, sample * DT >= _UNFOLDING))
            phases.append(np.asarray(state.phase))
            u = np.array(command.u, float)
            u[:, :2] += [offset.lean for offset in offsets]
            world, obs = engine.step(world, jax.tree.map(lambda x: np.asarray(x, float), command._replace(u=u)))
            true, up = engine.true_observation(world), up & ~np.asarray(engine.fallen(world))
    poses, pushing = np.array(tracks), np.array(phases) >= one_push.PUSH
    first = np.argmax(pushing, axis=0)
    return [
        poses[at : at + STEPS + 1, w] if felt and at < _TO_CONTACT / DT else None
        for w, (at, felt) in enumerate(zip(first, pushing.any(axis=0), strict=True))
    ]


def _balanced(offsets: list[equilibrium_lean.LeanOffset], each: list[Observation], latency: float) -> ObjectObservation:
    """What W robots perceive of the object, ``[W, ...]``, as `PushTask` gives it to a controller."""
    perceived = [
        ObjectObservation.of(equilibrium_lean.predicted(equilibrium_lean.corrected(offset, obs), latency), 0)
        for offset, obs in zip(offsets, each, strict=True)
    ]
    return jax.tree.map(lambda *fields: np.stack(fields).astype(np.asarray(fields[0]).dtype), *perceived)


@cache
def _policy(speed: SpeedProfile) -> tuple[Any, Any]:
    """The quasi-static law as compiled functions of W worlds: (obs, task) -> state, (state, obs, task, ready) ->
    command, state."""
    policy, key = one_push.quasi_static_policy(speed), jax.random.key(0)
    begin = jax.vmap(lambda obs, task: one_push.init(policy, obs, task, key))
    step = jax.vmap(lambda state, obs, task, ready: one_push.step(policy, state, obs, task, key=key, ready=ready))
    return jax.jit(begin), jax.jit(step)


def end_after(
    poses: Float[np.ndarray, "*n T 3"], start: Float[np.ndarray, "3"], distance: float
) -> Float[np.ndarray, "*n 3"]:
    """Pose at which an object's centre has come ``distance`` [m] along its own path from ``start``; NaN where it never
    does."""
    before = np.concatenate([np.broadcast_to(start, poses[..., :1, :].shape), poses[..., :-1, :]], axis=-2)
    steps = np.hypot(*np.moveaxis((poses - before)[..., :2], -1, 0))
    way = np.cumsum(steps, axis=-1)
    k = np.argmax(way >= distance, axis=-1)[..., None]
    a, b = (np.take_along_axis(p, k[..., None], axis=-2)[..., 0, :] for p in (before, poses))
    too_far, step = (np.take_along_axis(x, k, axis=-1) for x in (way - distance, steps))
    share = 1.0 - too_far / np.maximum(step, 1e-9)
    turn = np.asarray(se2.wrap(b[..., 2] - a[..., 2]))[..., None]
    pose = np.concatenate([a[..., :2] + share * (b - a)[..., :2], se2.wrap(a[..., 2:] + share * turn)], axis=-1)
    return np.where((way >= distance).any(axis=-1)[..., None], pose, np.nan)


def _true(push: _Push, track: np.ndarray, other: np.ndarray | None, distance: float) -> dict[str, Any]:
    """The true outcome, and the difference from the outcome with another robot."""

    def come(poses: np.ndarray) -> tuple[np.ndarray, np.ndarray, dict[str, float]]:
        end = end_after(poses[1:], poses[0], distance)
        share = probability_to_come(poses[None, 1:], poses[0], push.face, distance=distance)
        moves = bool(np.isfinite(end[0]))
        stop = end if moves else poses[np.isfinite(poses[:, 0])][-1]
        return end, stop, {"moves": float(moves), "comes": float(share)}

    end, stop, true = come(track)
    row: dict[str, Any] = true | {"start": track[0].tolist(), "end": end.tolist() if true["moves"] else None}
    row["stop"] = stop.tolist()
    if other is not None:
        there, where, their = come(other)
        row |= {f"robots_{key}": value for key, value in their.items()}
        beside = {"stop_": (stop, where)} | ({"": (end, there)} if true["moves"] and their["moves"] else {})
        for prefix, (one, another) in beside.items():
            ends = (np.asarray(se2.relative(poses[0], last)) for poses, last in ((track, one), (other, another)))
            apart = errors(*ends)
            row |= {f"robots_{prefix}{key}": value for key, value in apart.items()}
    return row


def _compared(
    row: dict[str, Any], poses: np.ndarray, push: _Push, start: np.ndarray, *, distance: float
) -> dict[str, Any]:
    """Score a prediction: probabilities to move and to come as far, and errors of the median end.

    Ends are compared at the given path length if the push moves the object that far. For all pushes they are also
    compared at that path length or at the last sample.
    """
    ends = end_after(poses, start, distance)
    moves = np.isfinite(ends[:, 0])
    along = probability_to_come(poses, start, push.face, distance=distance)
    measures: dict[str, Any] = {"moves": float(moves.mean()), "comes": float(along)}
    stops = np.where(moves[:, None], ends, poses[:, -1])
    compared = {"stop_": (stops[np.isfinite(stops[:, 0])], row["stop"])}
    if row["moves"] and moves.mean() >= _AT_LEAST:
        compared[""] = ends[moves], row["end"]
    for prefix, (predicted, true) in compared.items():
        beside = errors(np.array(true), median_pose(predicted)) | {"covered": covered(predicted, np.array(true))}
        measures |= {f"{prefix}{key}": value for key, value in beside.items()}
    measures["stops"] = np.round(stops[:_SHOWN], 3).tolist()
    return measures


def _shows(result: ExperimentResult) -> str:
    free, locked = (
        (number(measured(result, f"position_m_{s}_posterior")), number(measured(result, f"yaw_deg_{s}_posterior")))
        for s in STRATA
    )
    sure = percent(measured(result, "stop_covered_locked_posterior"))
    counts = [round(measured(result, f"compared_{s}_posterior")) for s in STRATA]
    return (
        f"After 0.8 m of pushed path, half of the ends lie within {free[0]} m and {free[1]} deg of the prediction for "
        f"free objects ({counts[0]} pushes), and within {locked[0]} m and {locked[1]} deg for objects with a locked "
        f"wheel ({counts[1]} pushes). The 80 % region of all pushes of "
        f"objects with a locked wheel holds {sure} of the ends, where 80 % would be right."
    )


EXPERIMENT = Experiment(
    Section(
        "Prediction of where a push leads",
        "After 5 s of contact, how well does the robot predict the outcome of another push of the same object?",
        outcomes_tables(),
        _shows,
        {"outcomes.png": "Predicted and true ends of pushes; predicted and observed frequency of moving 0.8 m"},
    ),
    OutcomesConfig(),
    quick=OutcomesConfig(objects=5),
    trials=lambda setup: {f"object-{i:03d}": i for i in range(setup.config.objects)},
    trial=_trial,
    metrics=lambda setup, rows: measure(rows),
    draw=lambda setup, rows: draw_figure(setup.folder / "outcomes.png", rows, setup.config.distance),
    neutral=("objects",),
)
