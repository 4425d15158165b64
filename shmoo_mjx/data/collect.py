"""Scripted tele-operators drive every condition and record what the learners need (Sec. III-C).

Each world holds one object; a chunk of conditions of one family, several episodes each, advances as one batch. Chunks
run in separate processes and each condition is written as soon as its chunk ends, so an interrupted run resumes
and keeps whatever was written.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator
from concurrent.futures import as_completed
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from shmoo_mjx.arrays import Array
from shmoo_mjx.base.files import claimed
from shmoo_mjx.base.processes import process_pool
from shmoo_mjx.base.seeds import MAX_SEED, UNSEEN_SEED
from shmoo_mjx.errors import ShmooError
from shmoo_mjx.geometry import se2
from shmoo_mjx.geometry.faces import faces_of, heading, stand_off
from shmoo_mjx.geometry.hands import HAND_HEIGHT, REACH, touches
from shmoo_mjx.plant.condition import Condition
from shmoo_mjx.plant.objects import FAMILIES, draw_condition
from shmoo_mjx.plant.robot import shmoobot
from shmoo_mjx.types import DT, Command, Observation

Row = tuple[str, str, Condition]
"""(name, split, condition) of what becomes one file of a data set."""

SPLIT_SEEDS = {"train": 0, "validation": 100_000, "test": UNSEEN_SEED}
"""First object seed of each split; training can't reach the test seeds."""


@dataclass(frozen=True)
class CollectConfig:
    """What to collect."""

    train: int = 40
    """Training conditions per family."""
    validation: int = 8
    """Validation conditions per family."""
    test: int = 0
    """Test conditions per family."""
    episodes: int = 8
    """Episodes per condition; each starts at a new face and offset."""
    seconds: float = 12.0
    """Length of an episode [s]."""
    seed: int = 0
    """Seed of the operators; the objects' seeds are set by the split."""
    chunk: int = 8
    """Conditions that advance together."""


class Operator(NamedTuple):
    """What each world's operator wants at present."""

    face: np.ndarray
    """``[W, 4]``"""
    speed: np.ndarray
    """``[W]`` along the face's inward normal [m/s]"""
    gain: np.ndarray
    """``[W]`` lean per speed error [rad s/m]"""
    offset: np.ndarray
    """``[W]`` lateral place on the face, to the robot's left [m]"""
    gamma: np.ndarray
    """``[W]`` [rad]"""
    noise: np.ndarray
    """``[W, 3]`` slow noise on u"""
    yaw_error: np.ndarray
    """``[W]`` deliberate heading error [rad]"""
    liveliness: np.ndarray
    """``[W]`` factor on the noise: calm episodes for steady pushing, lively ones like a sampling planner's trials"""


def conditions(config: CollectConfig) -> list[Row]:
    """(name, split, condition) of every condition, in the order they are collected."""
    rows = []
    for split, count in (("train", config.train), ("validation", config.validation), ("test", config.test)):
        for family in FAMILIES:
            for i in range(count):
                seed = SPLIT_SEEDS[split] + i
                rows.append((f"{split}-{family}-{seed}", split, draw_condition(family, seed)))
    return rows


def operators(
    rng: np.random.Generator, worlds: int, half_extents: list[tuple[float, float]]
) -> tuple[Operator, np.ndarray]:
    """Operators and the robots' starting poses ``[W, 3]`` with every object at the origin."""
    faces = np.stack([faces_of(h)[rng.integers(4)] for h in half_extents])
    offset = rng.uniform(-0.6, 0.6, worlds) * faces[:, 3]
    poses = np.stack(
        [stand_off(np.zeros(3), f, rng.uniform(0.03, 0.35), o) for f, o in zip(faces, offset, strict=True)]
    )
    poses[:, 2] += rng.uniform(-0.15, 0.15, worlds)
    zero, liveliness = np.zeros(worlds), np.exp(rng.uniform(np.log(0.4), np.log(5.0), worlds))
    operator = Operator(faces, zero, zero + 0.16, offset, zero, np.zeros((worlds, 3)), zero, liveliness)
    return _reconsider(rng, operator, np.ones(worlds, dtype=bool)), poses


def _reconsider(rng: np.random.Generator, op: Operator, who: np.ndarray) -> Operator:
    """New wishes for the worlds in ``who [W]``: speed, gain, lateral place, steering, heading error."""
    n = len(who)
    retreat, stop = rng.random(n) < 0.06, rng.random(n) < 0.08
    speed = np.where(retreat, rng.uniform(-0.25, -0.1, n), np.where(stop, 0.0, rng.uniform(0.06, 0.45, n)))
    steer = np.where(rng.random(n) < 0.4, 0.0, rng.uniform(-0.45, 0.45, n))
    return op._replace(
        speed=np.where(who, speed, op.speed),
        gain=np.where(who, np.exp(rng.uniform(np.log(0.15), np.log(0.5), n)), op.gain),
        offset=np.where(who, rng.uniform(-0.6, 0.6, n) * op.face[:, 3], op.offset),
        gamma=np.where(who, steer, op.gamma),
        yaw_error=np.where(who & (rng.random(n) < 0.5), rng.normal(0.0, 0.08, n), op.yaw_error),
    )


def drive(rng: np.random.Generator, op: Operator, observed: Observation) -> tuple[Operator, Command]:
    """One decision of each operator: velocity loop along the face, lateral loop to its place, smooth noise on u."""
    n = len(op.speed)
    op = _reconsider(rng, op, rng.random(n) < DT / 1.8)
    noise = 0.85 * op.noise + op.liveliness[:, None] * np.array([0.008, 0.005, 0.04]) * rng.normal(size=(n, 3))
    wanted_yaw = heading(observed.object_pose[:, 0], op.face) + op.yaw_error
    in_face = se2.relative(se2.compose(observed.object_pose[:, 0], op.face[:, :3]), observed.robot_pose)
    lateral_speed = np.clip(0.8 * (op.offset - in_face[:, 1]), -0.25, 0.25)
    # The wish is given along the face; the lean acts along the robot's axes.
    relative_yaw = se2.wrap(observed.robot_pose[:, 2] - op.face[:, 2] - observed.object_pose[:, 0, 2])
    wish = se2.rotate(np.stack([op.speed, lateral_speed], axis=-1), -relative_yaw)
    velocity = se2.rotate(observed.robot_twist[:, :2], -observed.robot_pose[:, 2])
    a, b, _ = shmoobot().flatness
    # Velocity of the flat output: the base first moves the wrong way when the lean changes.
    lean = op.gain[:, None] * (wish - velocity - b / a * observed.lean_rate) + noise[:, :2]
    # A robot that has lost its object far away comes back rather than recording empty floor.
    u = np.concatenate([np.clip(lean, -0.2, 0.2), np.clip(op.gamma + noise[:, 2], -0.5, 0.5)[:, None]], axis=-1)
    far = in_face[:, 0] < -(REACH + 0.6)
    op = op._replace(noise=noise, speed=np.where(far, 0.3, op.speed))
    ones = np.ones(n)
    return op, Command(u=u, yaw=wanted_yaw, reach=REACH * ones, hand_height=HAND_HEIGHT * ones)


def record(
    config: CollectConfig,
    chunk: list[Condition],
    seed: int,
    *,
    adjust: Callable[[Any], None] = lambda spec: None,
    engine_of: Callable[[list[Any]], Any] | None = None,
) -> Iterator[dict[str, np.ndarray]]:
    """Drive one chunk of conditions of one family; yields each condition's arrays ``[E, L, ...]`` in order.

    ``adjust`` (as `build_scene` takes it) and ``engine_of`` (scenes -> engine) put another robot in the place of the
    training plant; then the arrays hold what that robot perceives.

    Arrays: robot_pose, robot_twist, lean, lean_rate, object_pose, object_twist at the start of each sample ({W}); u
    held over it; force_robot ({R}) and wrench_object ({O}, about the object's centre), the hands' mean over it in the
    frames of its start; contact; per episode face [4] and size.

    Raises:
        ShmooError: the simulation of an object diverged.
    """
    from shmoo_mjx.plant.engine_mujoco import MujocoEngine
    from shmoo_mjx.plant.observe import DIVERGED
    from shmoo_mjx.plant.scene import build_scene

    rng = np.random.default_rng([config.seed, seed])
    episodes, worlds = config.episodes, len(chunk) * config.episodes
    half_extents = [c.half_extents for c in chunk for _ in range(episodes)]
    operator, poses = operators(rng, worlds, half_extents)
    compiled = [build_scene([(c, (0.0, 0.0, 0.0))], adjust=adjust) for c in chunk]
    scenes = []
    for i, pose in enumerate(poses):
        scene = compiled[i // episodes]
        qpos = scene.qpos0.copy()
        qpos[[0, 1, 3, 4, 5, 6]] = [pose[0], pose[1], np.cos(pose[2] / 2), 0.0, 0.0, np.sin(pose[2] / 2)]
        scenes.append(dataclasses.replace(scene, qpos0=qpos))
    engine = (engine_of or MujocoEngine)(scenes)
    world = engine.init()
    settle = Command(np.zeros((worlds, 3)), poses[:, 2], np.full(worlds, REACH), np.full(worlds, HAND_HEIGHT))
    world, observed = engine.step(world, settle, 1.0)
    rows: list[dict[str, Array]] = []
    for _ in range(round(config.seconds / DT)):
        operator, command = drive(rng, operator, observed)
        before = observed
        world, observed = engine.step(world, command)
        rows.append(sample(before, observed, command.u))
    lost = np.flatnonzero(engine.diverged(world))
    engine.close()
    if len(lost):
        raise ShmooError(f"{chunk[lost[0] // episodes].describe()}: {DIVERGED}; leave this object out.")
    arrays = {k: np.stack([r[k] for r in rows], axis=1).astype(np.float32) for k in rows[0]}
    arrays["face"] = operator.face.astype(np.float32)
    arrays["size"] = np.hypot(*np.array(half_extents).T).astype(np.float32)
    for i in range(len(chunk)):
        yield {k: v[i * episodes : (i + 1) * episodes] for k, v in arrays.items()}


def sample(before: Observation, after: Observation, u: Array) -> dict[str, Array]:
    """The fields of one sample, each ``[W, ...]``: observations before and after it and u ``[W, 3]`` held over it."""
    wrench = after.wrench[:, 0]
    return {
        "robot_pose": before.robot_pose,
        "robot_twist": before.robot_twist,
        "lean": before.lean,
        "lean_rate": before.lean_rate,
        "object_pose": before.object_pose[:, 0],
        "object_twist": before.object_twist[:, 0],
        "u": u,
        "force_robot": se2.rotate(wrench[:, :2], -before.robot_pose[:, 2]),
        "wrench_object": se2.rotate(wrench, -before.object_pose[:, 0, 2]),
        "contact": np.asarray(touches(wrench)),
    }


def _run_chunk(config: CollectConfig, seeds: list[tuple[str, int]], number: int) -> list[dict[str, np.ndarray]]:
    return list(record(config, [draw_condition(family, seed) for family, seed in seeds], number))


def _check(config: CollectConfig) -> None:
    counts = (config.train, config.validation, config.test)
    if min(counts) < 0 or sum(counts) == 0:
        raise ShmooError(
            f"collect: train, validation and test are {counts}; none may be negative, and one must be positive."
        )
    borders = (*SPLIT_SEEDS.values(), MAX_SEED + 1)
    for split, count, first, end in zip(SPLIT_SEEDS, counts, borders, borders[1:], strict=False):
        if count > end - first:
            raise ShmooError(f"collect: {split} is {count}; {end - first} is the most, or its seeds meet others.")
    if config.episodes < 1 or config.seconds < 1:
        raise ShmooError(
            f"collect: {config.episodes} episodes of {config.seconds:g} s; give at least one of at least 1 s."
        )


def collect(
    directory: Path,
    config: CollectConfig,
    workers: int = 2,
    *,
    progress: Callable[[int, int], None] = lambda done, total: None,
    rows: list[Row] | None = None,
) -> None:
    """Fill ``directory`` with one file per condition; conditions already there and whole are kept.

    Args:
        directory: data set to create or to resume.
        config: what to collect; must equal that of a data set that is resumed.
        workers: processes.
        progress: called with (conditions done, conditions in all).
        rows: (name, split, condition) of each condition; by default those that ``config`` counts.
    """
    from shmoo_mjx.data import store

    schema: dict[str, Any] = {"config": dataclasses.asdict(config), "dt": DT}
    if rows is None:
        _check(config)
        rows = conditions(config)
    else:
        schema["names"] = [name for name, _, _ in rows]
    with claimed(directory):
        opened = store.create_or_open(directory, schema)
        entries = {name: condition.to_dict() | {"split": split} for name, split, condition in rows}
        present = {name for name in entries if opened.has(name) or store.adopt(opened, name, entries[name])}
        chunks: list[tuple[int, list[Row]]] = []
        for number, start in enumerate(range(0, len(rows), config.chunk)):
            part = rows[start : start + config.chunk]
            # A chunk holds one family only: split it where the family changes.
            for k, family in enumerate(FAMILIES):
                mine = [r for r in part if r[2].family == family]
                if mine and not all(r[0] in present for r in mine):
                    chunks.append((number * len(FAMILIES) + k, mine))
        done = len(rows) - sum(len(c) for _, c in chunks)
        progress(done, len(rows))
        with process_pool(workers) as pool:
            jobs: dict[Any, list[Row]] = {
                pool.submit(_run_chunk, config, [(c.family, c.seed) for _, _, c in part], number): part
                for number, part in chunks
            }
            for job in as_completed(jobs):
                for (name, _, _), arrays in zip(jobs[job], job.result(), strict=True):
                    # A chunk is driven as a whole; those of it that were recorded before the cut stay as they are.
                    if name not in present:
                        store.write_condition(opened, name, arrays, entries[name])
                    done += 1
                    progress(done, len(rows))
