"""Experiment `outcomes`: are outcomes of pushes predicted?

The pushing controller pushes an unseen object for 5 s of contact, with the robot's own senses, which gives a posterior
of the object's dynamics. Then the same object is pushed on three faces by the law of `quasi_static`, in the real plant.
`planning.reach` predicts these pushes from where they begin, with the posterior and with the prior of the object's
kind. Compared are the object's pose after the same length of its path, whether it moves that far within the roll-out,
and whether it comes that far along the push. Another robot makes each push once more: what the two robots differ by
can't be predicted.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from functools import cache, partial
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np

from shmoo_mjx.arrays import Array, Float
from shmoo_mjx.base.assets import WEIGHTS, asset
from shmoo_mjx.base.fingerprints import fingerprint
from shmoo_mjx.base.options import SensesName
from shmoo_mjx.behavior.push_task import PushTask
from shmoo_mjx.behavior.skills import one_push
from shmoo_mjx.behavior.skills.approach import CONTACT_GAP
from shmoo_mjx.control import equilibrium_lean
from shmoo_mjx.control.cost import PushCost
from shmoo_mjx.control.observation import ObjectObservation
from shmoo_mjx.evaluation.outcomes_measures import covered, draw_figure, errors, measure, median_pose
from shmoo_mjx.evaluation.result import ExperimentOptions, ExperimentResult, make_result
from shmoo_mjx.evaluation.trials import controller_of, run_trials
from shmoo_mjx.geometry import se2
from shmoo_mjx.geometry.faces import faces_of, stand_off
from shmoo_mjx.learning.contact_prior import kind_of
from shmoo_mjx.learning.online import Known
from shmoo_mjx.planning.maps import OccupancyGrid
from shmoo_mjx.planning.reach import STEPS, foresight_of, goal_ahead, probability_to_come
from shmoo_mjx.plant.condition import Condition
from shmoo_mjx.plant.objects import FAMILIES, draw_condition
from shmoo_mjx.plant.scene import build_scene
from shmoo_mjx.sensing import SensedEngine, Senses, senses_named
from shmoo_mjx.types import DT, Observation

_UNFOLDING = 1.0
"""Time that the arms take to extend [s]."""
_TO_CONTACT = 8.0
"""Time after which a push that has not felt its object is left out [s]."""
_LONGEST_LEARNING = 40.0
"""Longest time until the controller has learned [s], its approach included."""
_SHOWN = 16
"""Predicted ends that a row keeps for the figure."""
_AT_LEAST = 0.25
"""Share of samples that move as far, from which their poses there are compared with the true one."""


@dataclass(frozen=True)
class OutcomesConfig:
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
    workers: int = 2


class _Push(NamedTuple):
    """One push that is predicted."""

    side: int
    bearing: float
    face: Float[np.ndarray, "4"]
    goal: Float[np.ndarray, "3"]


def run(options: ExperimentOptions) -> ExperimentResult:
    """Push and predict; goes on from ``options.out`` after a stop."""
    config = replace(OutcomesConfig(), objects=5) if options.quick else OutcomesConfig()
    weights, folder = options.weights or asset(WEIGHTS), options.out / "outcomes"
    # The trials of a quick run are the first ones of a full run.
    settings = asdict(replace(config, objects=0)), options.seed, options.first_unseen, options.senses
    store = folder / f"trials-{fingerprint(__name__, settings, weights)}"
    trials = {f"object-{i:03d}": i for i in range(config.objects)}
    work = partial(_trial, config, options.first_unseen, options.seed, weights, options.senses)
    rows = run_trials(trials, work, store, options.progress, config.workers)
    draw_figure(folder / "outcomes.png", rows, config.distance)
    return make_result("outcomes", options, config, measure(rows), {}, rows)


def draw_object(index: int, first_seed: int) -> Condition:
    """Object ``index``, as drawn but for its brakes: none, or one on every second cart and wheelchair."""
    family, number = FAMILIES[index % len(FAMILIES)], index // len(FAMILIES)
    drawn = draw_condition(family, first_seed + index)
    wheel = None
    if number % 2 and drawn.rolling:
        # A wheelchair's brakes act on its rear wheels.
        wheel = int(np.random.default_rng([first_seed + index, 3]).integers(2 if family == "wheelchair" else 4))
    return draw_condition(family, first_seed + index, {"locked": [i == wheel for i in range(len(drawn.locked))]})


def _trial(
    config: OutcomesConfig, first_seed: int, seed: int, weights: Path, senses: SensesName, index: int
) -> list[dict[str, Any]]:
    """One row for each push of an object that was felt."""
    condition, robots = draw_object(index, first_seed), np.random.default_rng([seed, index, 1]).integers(2**31, size=2)
    rng, faces, sensing = np.random.default_rng([seed, index]), faces_of(condition.half_extents), senses_named(senses)
    controller, kind, origin = controller_of(weights), kind_of(condition), np.zeros(3)
    foresight = foresight_of(controller)
    adapt = _learned(config, condition, faces[rng.integers(4)], controller, sensing, int(robots[0]))
    pushes = []
    for side in rng.permutation(4)[: config.pushes]:
        bearing = float(rng.uniform(-config.bearing, config.bearing))
        pushes.append(_Push(int(side), bearing, faces[side], goal_ahead(origin, faces[side], bearing)))
    seeds = np.repeat(robots, len(pushes)).tolist()
    tracks = _pushed(condition, [*pushes, *pushes], controller.config.cost, sensing, seeds)
    rows = []
    for push, track, other in zip(pushes, tracks, tracks[len(pushes) :], strict=False):
        if track is None:
            continue
        row = {"object": index, "family": condition.family, "description": condition.describe()}
        row |= {"stratum": "locked" if any(condition.locked) else "free", "side": push.side, "bearing": push.bearing}
        row["ahead"] = float(push.face[2])
        row |= {"known": adapt is not None, **_true(push, track, other, config.distance)}
        for name, known in (("posterior", adapt), ("prior", None)):
            predicted = foresight.sampled_poses(
                known, kind, track[0], condition.half_extents, face=push.face, goal=push.goal
            )
            row |= {f"{name}_{key}": value for key, value in _compared(row, predicted, push, track[0], config).items()}
        rows.append(row)
    return rows


def _learned(
    config: OutcomesConfig, condition: Condition, face: Array, controller: Any, senses: Senses, seed: int
) -> Known | None:
    """What the pushing controller learns of the object at the origin in its first seconds of pushing straight on; None
    if it did not get there."""
    grid = OccupancyGrid(np.zeros((240, 240), np.int8), 0.05, (-6.0, -6.0, 0.0))
    robot = stand_off(np.zeros(3), face, 2 * CONTACT_GAP)
    scene = build_scene([(condition, (0.0, 0.0, 0.0))], robot.tolist(), adjust=senses.adjust(seed))
    goal, kinds = goal_ahead(np.zeros(3), face), [kind_of(condition)]
    task = PushTask(grid, [condition.half_extents], goal, controller, seed=seed, kinds=kinds)
    with SensedEngine([scene], senses, seed, poses_known=True) as engine:
        world = engine.init()
        seen = engine.observe(world)
        while not task.finished and float(seen.time[0]) < _LONGEST_LEARNING:
            push = task.segment.push if task.segment is not None else None
            if push is not None and (
                push.contact_time >= config.contact_s or float(seen.time[0]) - push.started >= config.longest_s
            ):
                break
            world, seen = engine.step(world, task.tick(seen))
            if engine.fallen(world)[0]:
                break
    return task.adapt


def _pushed(
    condition: Condition, pushes: list[_Push], cost: PushCost, senses: Senses, seeds: list[int]
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
    begin, step = _policy(cost)
    offsets, up = [equilibrium_lean.init()] * count, np.ones(count, bool)
    tracks, phases = [], []
    with SensedEngine(scenes, senses, seeds, poses_known=True) as engine:
        world = engine.init()
        seen, true, state = engine.observe(world), engine.true_observation(world), None
        for sample in range(round(_TO_CONTACT / DT) + STEPS):
            tracks.append(np.where(up[:, None], true.object_pose[:, 0], np.nan))
            each = [jax.tree.map(lambda x, w=w: np.asarray(x)[w : w + 1], seen) for w in range(count)]
            offsets = [equilibrium_lean.step(known, obs) for known, obs in zip(offsets, each, strict=True)]
            obs = _balanced(offsets, each, senses.latency)
            state = begin(obs, task) if state is None else state
            command, state = step(state, obs, task, np.full(count, sample * DT >= _UNFOLDING))
            phases.append(np.asarray(state.phase))
            u = np.array(command.u, float)
            u[:, :2] += [known.lean for known in offsets]
            world, seen = engine.step(world, jax.tree.map(lambda x: np.asarray(x, float), command._replace(u=u)))
            true, up = engine.true_observation(world), up & ~np.asarray(engine.fallen(world))
    poses, pushing = np.array(tracks), np.array(phases) >= one_push.PUSH
    first = np.argmax(pushing, axis=0)
    return [
        poses[at : at + STEPS + 1, w] if felt and at < _TO_CONTACT / DT else None
        for w, (at, felt) in enumerate(zip(first, pushing.any(axis=0), strict=True))
    ]


def _balanced(offsets: list[equilibrium_lean.LeanOffset], each: list[Observation], latency: float) -> ObjectObservation:
    """What W robots perceive of the object, ``[W, ...]``, as `PushTask` gives it to a controller."""
    found = [
        ObjectObservation.of(equilibrium_lean.predicted(equilibrium_lean.corrected(known, obs), latency), 0)
        for known, obs in zip(offsets, each, strict=True)
    ]
    return jax.tree.map(lambda *fields: np.stack(fields).astype(np.asarray(fields[0]).dtype), *found)


@cache
def _policy(cost: PushCost) -> tuple[Any, Any]:
    """The law as compiled functions of W worlds: (obs, task) -> state, (state, obs, task, ready) -> command, state."""
    policy, key = one_push.quasi_static_policy(cost), jax.random.key(0)
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
    turn = se2.wrap(b[..., 2] - a[..., 2])[..., None]
    pose = np.concatenate([a[..., :2] + share * (b - a)[..., :2], se2.wrap(a[..., 2:] + share * turn)], axis=-1)
    return np.where((way >= distance).any(axis=-1)[..., None], pose, np.nan)


def _true(push: _Push, track: np.ndarray, other: np.ndarray | None, distance: float) -> dict[str, Any]:
    """What has happened, and by how much another robot's ends differ."""

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
            apart = errors(se2.relative(track[0], one), se2.relative(other[0], another))
            row |= {f"robots_{prefix}{key}": value for key, value in apart.items()}
    return row


def _compared(
    row: dict[str, Any], poses: np.ndarray, push: _Push, start: np.ndarray, config: OutcomesConfig
) -> dict[str, Any]:
    """Of a prediction: the probabilities to move and to come as far; how far the median end is off the true one where
    the push moves the object that far; and the same of where every push stops, at that path or at the last sample."""
    ends = end_after(poses, start, config.distance)
    moves = np.isfinite(ends[:, 0])
    along = probability_to_come(poses, start, push.face, distance=config.distance)
    found: dict[str, Any] = {"moves": float(moves.mean()), "comes": float(along)}
    stops = np.where(moves[:, None], ends, poses[:, -1])
    compared = {"stop_": (stops[np.isfinite(stops[:, 0])], row["stop"])}
    if row["moves"] and moves.mean() >= _AT_LEAST:
        compared[""] = ends[moves], row["end"]
    for prefix, (predicted, true) in compared.items():
        beside = errors(np.array(true), median_pose(predicted)) | {"covered": covered(predicted, np.array(true))}
        found |= {f"{prefix}{key}": value for key, value in beside.items()}
    found["stops"] = np.round(stops[:_SHOWN], 3).tolist()
    return found
