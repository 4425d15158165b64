"""Settles and pushes many drawn conditions, or many robots, and counts what goes wrong.

Run: python benchmarks/plant_survey.py --count 10000 (about 25 minutes on one idle core; goes on where it was stopped)
     python benchmarks/plant_survey.py --robots 1000
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import time
from collections import Counter
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path

import mujoco
import numpy as np
from mujoco.rollout import Rollout

from shmoo_mjx.plant.objects import FAMILIES, draw_condition
from shmoo_mjx.plant.trials import object_alone

_STATE = mujoco.mjtState.mjSTATE_FULLPHYSICS
_SETTLE, _PUSH, _TOTAL = 1.0, 1.0, 10.0
"""Seconds at rest first, under the push, and in all after settling."""
_SEGMENT = 1.0
"""Worlds that stand still at the end of a segment are not stepped further: nothing acts on them any more [s]."""
_CHUNK = 100
"""Conditions per job and per file."""


def survey(family: str, count: int, workers: int, out: Path, seed: int = 0) -> dict[str, int | str | list[int]]:
    """Counts over the conditions (family, 0 .. count - 1), each under one random push of 10 to 60 N.

    Each chunk of conditions leaves a file in ``out``; chunks that have one are not run again.
    """
    out.mkdir(parents=True, exist_ok=True)
    files = {first: out / f"{family}-{seed}-{first:05d}.json" for first in range(0, count, _CHUNK)}
    missing = [first for first, path in files.items() if not path.exists()]
    started, done = time.time(), 0
    with ProcessPoolExecutor(workers, mp_context=multiprocessing.get_context("spawn")) as pool:
        jobs = [pool.submit(_chunk, family, first, min(_CHUNK, count - first), seed, files[first]) for first in missing]
        for job in as_completed(jobs):
            job.result()
            done += 1
            left = (time.time() - started) / done * (len(missing) - done)
            print(f"{family}: {done} of {len(missing)} chunks, {left / 60:.1f} min left", flush=True)
    found: Counter[str] = Counter()
    odd: list[int] = []
    for first, path in files.items():
        outcomes = json.loads(path.read_text())
        found.update(outcomes)
        odd += [first + i for i, outcome in enumerate(outcomes) if outcome in ("exploded", "did not settle")]
    return {"family": family, "conditions": count, **dict(sorted(found.items())), "seeds that failed": odd}


def _chunk(family: str, first: int, count: int, seed: int, path: Path) -> None:
    models = [object_alone(draw_condition(family, s)) for s in range(first, first + count)]
    outcomes = _outcomes(models, np.random.default_rng([seed, FAMILIES.index(family), first]))
    written = path.with_suffix(".part")
    written.write_text(json.dumps(outcomes))
    os.replace(written, path)


def _wrenches(models: list[mujoco.MjModel], rng: np.random.Generator) -> np.ndarray:
    """Random pushes ``[W, 6]`` at the objects' centres of mass."""
    worlds = len(models)
    mass = np.array([m.body_subtreemass[m.body("object0/object").id] for m in models])
    angle = rng.uniform(-np.pi, np.pi, worlds)
    # At most 10 m/s^2, or a light box would be shot rather than pushed.
    force = np.minimum(rng.uniform(10, 60, worlds), 10 * mass)
    zero, turn = np.zeros(worlds), np.minimum(rng.uniform(-5, 5, worlds), mass)
    return np.stack([force * np.cos(angle), force * np.sin(angle), zero, zero, zero, turn], axis=-1)


def _outcomes(models: list[mujoco.MjModel], rng: np.random.Generator) -> list[str]:
    first, steps = models[0], round(_SEGMENT / models[0].opt.timestep)
    body, outside = first.body("object0/object").id, _wrenches(models, rng)
    state = np.empty((len(models), mujoco.mj_stateSize(first, _STATE)))
    for model, row in zip(models, state, strict=True):
        mujoco.mj_getState(model, mujoco.MjData(model), row, _STATE)
    outcomes = ["fine"] * len(models)
    running, scratch, rollout = np.arange(len(models)), [mujoco.MjData(first)], Rollout(nthread=0)
    for segment in range(round((_SETTLE + _TOTAL) / _SEGMENT)):
        since_settled = segment * _SEGMENT - _SETTLE
        pushed = 0 <= since_settled < _PUSH
        applied = np.zeros((len(running), steps, first.nbody, 6))
        applied[:, :, body] = pushed * outside[running, None]
        tracks, _ = rollout.rollout(
            [models[i] for i in running],
            scratch,
            state[running],
            applied.reshape(len(running), steps, -1),
            control_spec=int(mujoco.mjtState.mjSTATE_XFRC_APPLIED),
        )
        state[running] = tracks[:, -1]
        for i, track in zip(running, tracks, strict=True):
            outcomes[i] = _judge(track[:, 1 : 1 + first.nq], track[:, 1 + first.nq :], since_settled < 0)
        still = np.abs(state[:, 1 + first.nq :]).max(axis=-1) < 1e-3
        may_end = since_settled >= _PUSH
        running = np.array([i for i in running if outcomes[i] == "fine" and not (may_end and still[i])], dtype=int)
        if not len(running):
            break
    rollout.close()
    return outcomes


def _judge(qpos: np.ndarray, qvel: np.ndarray, settling: bool) -> str:
    speed = np.linalg.norm(qvel[:, :3], axis=-1)
    tilt = 1 - 2 * (qpos[:, 4] ** 2 + qpos[:, 5] ** 2)
    # Only its sole meets the floor: what happens after an object has toppled is not physics any more.
    upright = slice(0, np.argmax(tilt < 0.8) if (tilt < 0.8).any() else len(tilt))
    finite = np.isfinite(qpos[upright]).all() and np.isfinite(qvel[upright]).all()
    if not finite or speed[upright].max(initial=0) > 20 or np.abs(qpos[upright, 2]).max(initial=0) > 0.3:
        return "exploded"
    if settling and speed[-1] > 0.02:
        return "did not settle"
    if not tilt.min() >= 0.8:
        return "toppled under the push"
    return "fine"


def robots(count: int, seed: int = 0) -> dict[str, int | float]:
    """Falls among randomised robots in MJX, each pushed once by up to 20 N x 0.5 s from any side, arms out."""
    import jax

    from shmoo_mjx.geometry.hands import HAND_HEIGHT, REACH
    from shmoo_mjx.plant.engine_mjx import MjxEngine
    from shmoo_mjx.plant.randomize import randomize
    from shmoo_mjx.plant.scene import build_scene
    from shmoo_mjx.plant.trials import drive

    started, rng, scene = time.time(), np.random.default_rng(seed), build_scene(engine="mjx")
    engine = MjxEngine([scene] * count)
    engine = engine.with_model(*randomize(engine.model, jax.random.split(jax.random.key(seed), count), scene))
    push, angle, force = np.zeros((count, 6)), rng.uniform(-np.pi, np.pi, count), rng.uniform(0, 20, count)
    push[:, 0], push[:, 1] = force * np.cos(angle), force * np.sin(angle)
    track, fallen = drive(
        engine,
        5.0,
        station=0.8,
        push=lambda now: push if 1.95 < now < 2.45 else None,
        arms=lambda now: (REACH, HAND_HEIGHT),
    )
    away = np.linalg.norm(track.robot_pose[..., :2], axis=-1).max(axis=0)
    return {
        "robots": count,
        "falls": int(fallen.sum()),
        "largest excursion [m]": round(float(away.max()), 3),
        "median excursion [m]": round(float(np.median(away)), 3),
        "seconds": round(time.time() - started, 1),
    }


def main() -> None:
    """Print one JSON line per family, or one for the robots."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=10000)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--family", nargs="+", choices=FAMILIES, default=list(FAMILIES))
    parser.add_argument("--out", type=Path, default=Path("runs/plant_survey"))
    parser.add_argument("--robots", type=int, default=0, help="survey this many robots instead")
    args = parser.parse_args()
    if args.robots:
        print(json.dumps(robots(args.robots)))
        return
    for family in args.family:
        print(json.dumps(survey(family, args.count, args.workers, args.out)), flush=True)


if __name__ == "__main__":
    main()
