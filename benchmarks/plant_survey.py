"""Settles and pushes many drawn conditions, or many robots, and counts what goes wrong.

Run: python benchmarks/plant_survey.py --count 10000 (about 10 minutes per family on one core)
     python benchmarks/plant_survey.py --robots 1000
"""

from __future__ import annotations

import argparse
import json
import time
from collections import Counter

import mujoco
import numpy as np
from mujoco.rollout import Rollout

from shmoo_mjx.plant.objects import FAMILIES, draw_condition
from shmoo_mjx.plant.trials import object_alone

_STATE = mujoco.mjtState.mjSTATE_FULLPHYSICS
_SETTLE, _PUSH, _TOTAL = 1.0, 1.0, 10.0
"""Seconds at rest first, under the push, and in all after settling."""


def survey(family: str, count: int, threads: int, seed: int = 0, batch: int = 64) -> dict[str, int | float]:
    """Counts over the conditions (family, 0 .. count - 1), each under one random push of 10 to 60 N."""
    rng = np.random.default_rng(seed)
    found: Counter[str] = Counter()
    started, rollout = time.time(), Rollout(nthread=threads if threads > 1 else 0)
    for first in range(0, count, batch):
        models = [object_alone(draw_condition(family, s)) for s in range(first, min(first + batch, count))]
        for outcome in _outcomes(models, rng, rollout, threads):
            found[outcome] += 1
    rollout.close()
    return {"conditions": count, **dict(sorted(found.items())), "seconds": round(time.time() - started, 1)}


def _outcomes(models: list[mujoco.MjModel], rng: np.random.Generator, rollout: Rollout, threads: int) -> list[str]:
    worlds, dt = len(models), models[0].opt.timestep
    settle, push, total = (round(s / dt) for s in (_SETTLE, _PUSH, _TOTAL))
    outside = np.zeros((worlds, settle + total, models[0].nbody, 6))
    mass = np.array([m.body_subtreemass[m.body("object0/object").id] for m in models])
    angle = rng.uniform(-np.pi, np.pi, worlds)
    # At most 10 m/s^2, or a light box would be shot rather than pushed.
    force = np.minimum(rng.uniform(10, 60, worlds), 10 * mass)
    zero, turn = np.zeros(worlds), np.minimum(rng.uniform(-5, 5, worlds), mass)
    wrench = np.stack([force * np.cos(angle), force * np.sin(angle), zero, zero, zero, turn])
    outside[:, settle : settle + push, models[0].body("object0/object").id] = wrench.T[:, None]
    starts = []
    for model in models:
        data = mujoco.MjData(model)
        row = np.empty(mujoco.mj_stateSize(model, _STATE))
        mujoco.mj_getState(model, data, row, _STATE)
        starts.append(row)
    scratch = [mujoco.MjData(models[0]) for _ in range(threads)]
    states, _ = rollout.rollout(
        models,
        scratch,
        np.array(starts),
        outside.reshape(worlds, settle + total, -1),
        control_spec=int(mujoco.mjtState.mjSTATE_XFRC_APPLIED),
        skip_checks=False,
    )
    nq = models[0].nq
    return [_judge(s[:, 1 : 1 + nq], s[:, 1 + nq : 1 + nq + 6], settle) for s in states]


def _judge(qpos: np.ndarray, qvel: np.ndarray, settle: int) -> str:
    speed = np.linalg.norm(qvel[:, :3], axis=-1)
    tilt = 1 - 2 * (qpos[:, 4] ** 2 + qpos[:, 5] ** 2)
    # Only its sole meets the floor: what happens after an object has toppled is not physics any more.
    upright = slice(0, np.argmax(tilt < 0.8) if (tilt < 0.8).any() else len(tilt))
    if not np.isfinite(qpos[upright]).all() or speed[upright].max() > 20 or np.abs(qpos[upright, 2]).max() > 0.3:
        return "exploded"
    if speed[settle - 1] > 0.02:
        return "did not settle"
    if tilt.min() < 0.8:
        return "toppled under the push"
    return "fine"


def robots(count: int, seed: int = 0) -> dict[str, int | float]:
    """Falls among randomised robots in MJX, each pushed once by up to 20 N x 0.5 s from any side, arms out."""
    import jax

    from shmoo_mjx.hands import HAND_HEIGHT, REACH
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
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--family", choices=FAMILIES)
    parser.add_argument("--robots", type=int, default=0, help="survey this many robots instead")
    args = parser.parse_args()
    if args.robots:
        print(json.dumps(robots(args.robots)))
        return
    for family in [args.family] if args.family else FAMILIES:
        print(json.dumps({"family": family} | survey(family, args.count, args.threads)), flush=True)


if __name__ == "__main__":
    main()
