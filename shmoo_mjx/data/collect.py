"""Collects training data: scripted tele-operators push every condition (Sec. III-C).

Each world contains one object. A chunk of conditions of one family, with several episodes each, advances as one batch.
Chunks run in separate processes. Each condition is written as soon as its chunk ends, so an interrupted collection
keeps the written conditions and can resume.
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
"""(name, split, condition) of one file of a data set."""

SPLIT_SEEDS = {"train": 0, "validation": 100_000, "test": UNSEEN_SEED}
"""First object seed of each split. Training can't use the test seeds."""


@dataclass(frozen=True)
class CollectConfig:
    """Settings of a data collection."""

    train: int = 40
    """Training conditions per family."""
    validation: int = 8
    """Validation conditions per family."""
    test: int = 0
    """Test conditions per family."""
    episodes: int = 8
    """Episodes per condition. Each starts at a random face and offset."""
    seconds: float = 12.0
    """Length of an episode [s]."""
    seed: int = 0
    """Seed of the operators. The objects' seeds depend on the split."""
    chunk: int = 8
    """Number of conditions that advance as one batch."""


class Operator(NamedTuple):
    """Current targets of the operators of W worlds."""

    face: np.ndarray
    """Pushed face in {O}, ``[W, 4]``, in the format of `faces_of`."""
    speed: np.ndarray
    """Desired speed along the face's inward normal [m/s], ``[W]``."""
    gain: np.ndarray
    """Lean per speed error [rad s/m], ``[W]``."""
    offset: np.ndarray
    """Desired lateral position on the face, to the robot's left [m], ``[W]``."""
    gamma: np.ndarray
    """Steering angle [rad], ``[W]``."""
    noise: np.ndarray
    """Slowly varying noise on u [rad], ``[W, 3]``."""
    yaw_error: np.ndarray
    """Deliberate heading error [rad], ``[W]``."""
    liveliness: np.ndarray
    """Factor on the noise, ``[W]``. Small values give steady pushing, large ones resemble a sampling planner's
    roll-outs."""


def conditions(config: CollectConfig) -> list[Row]:
    """All conditions of a collection, in the order of collection."""
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
    """Draw operators and the robots' initial poses in {W} ``[W, 3]``; every object is at the origin.

    Args:
        rng: random generator.
        worlds: number of worlds W.
        half_extents: half length and half width of each world's object [m].
    """
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
    """Draw new targets for the worlds ``who [W]``: speed, gain, lateral position, steering angle, heading error."""
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
    """One decision of each operator.

    The lean comes from a velocity loop along the face and a lateral position loop. Smooth noise is added to u.

    Returns:
        The operators with updated targets and noise, and the command.
    """
    n = len(op.speed)
    op = _reconsider(rng, op, rng.random(n) < DT / 1.8)
    noise = 0.85 * op.noise + op.liveliness[:, None] * np.array([0.008, 0.005, 0.04]) * rng.normal(size=(n, 3))
    wanted_yaw = heading(observed.object_pose[:, 0], op.face) + op.yaw_error
    in_face = se2.relative(se2.compose(observed.object_pose[:, 0], op.face[:, :3]), observed.robot_pose)
    lateral_speed = np.clip(0.8 * (op.offset - in_face[:, 1]), -0.25, 0.25)
    # Rotate the desired velocity from the face's axes to the robot's axes, along which the lean acts.
    relative_yaw = se2.wrap(observed.robot_pose[:, 2] - op.face[:, 2] - observed.object_pose[:, 0, 2])
    wish = se2.rotate(np.stack([op.speed, lateral_speed], axis=-1), -relative_yaw)
    velocity = se2.rotate(observed.robot_twist[:, :2], -observed.robot_pose[:, 2])
    a, b, _ = shmoobot().flatness
    # Regulate the velocity of the flat output, because the base first moves the wrong way when the lean changes.
    lean = op.gain[:, None] * (wish - velocity - b / a * observed.lean_rate) + noise[:, :2]
    # A robot that is far behind its object returns to it, since samples without an object nearby are useless.
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
    """Simulate and record one chunk of conditions of one family.

    Args:
        config: settings of the collection.
        chunk: conditions of one family.
        seed: seed of this chunk's operators.
        adjust: change of the robot's MJCF, as for `build_scene`. Together with ``engine_of`` it replaces the training
            plant by another robot. The arrays then contain that robot's sensed observations.
        engine_of: function from scenes to an engine, by default C MuJoCo.

    Yields:
        The arrays of each condition, in order, with E episodes of L samples: the fields of `store.FIELDS`
            ``[E, L, ...]``, face ``[E, 4]`` and size ``[E]``.

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
    """Fields of one sample, each ``[W, ...]``; see `store.FIELDS`.

    Args:
        before: observation at the start of the sample.
        after: observation at the end of the sample.
        u: command held over the sample, ``[W, 3]``.
    """
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
    """Collect a data set with one file per condition. Complete files that exist already are kept.

    Args:
        directory: data set to create or to resume.
        config: settings; must equal those of a data set that is resumed.
        workers: number of worker processes.
        progress: function called with (conditions done, total conditions).
        rows: conditions to collect, by default those of ``config``.

    Raises:
        ShmooError: the settings are invalid, differ from those of the existing data set, or a simulation diverged.
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
            # A batch can contain only one family, so split the chunk by family.
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
                    # An interrupted chunk is simulated again as a whole. Keep the conditions that it already wrote.
                    if name not in present:
                        store.write_condition(opened, name, arrays, entries[name])
                    done += 1
                    progress(done, len(rows))
