"""Settles and pushes many random objects or robots, and counts failures. A stopped run continues where it was.

Run: python -m benchmarks.plant_survey --count 10000 (about 25 minutes on one idle core)
     python -m benchmarks.plant_survey --robots 1000
"""

from __future__ import annotations

import argparse
import json
from collections import Counter
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from mujoco.rollout import Rollout

from shmoo_mjx.evaluation.trials import run_trials
from shmoo_mjx.plant.objects import FAMILIES, draw_condition
from shmoo_mjx.plant.trials import object_alone

_STATE = mujoco.mjtState.mjSTATE_FULLPHYSICS
_SETTLE, _PUSH, _TOTAL = 1.0, 1.0, 10.0
"""Durations of settling, of the push, and of the whole run after settling [s]."""
_SEGMENT = 1.0
"""Length of a segment [s]. After the push, worlds at rest at the end of a segment are not stepped further."""
_CHUNK = 100
"""Number of conditions of a family in one trial and its file."""


def outcomes(trial: tuple[str, int]) -> list[dict[str, Any]]:
    """The rows of a chunk of conditions of a family: the outcome of each under one random push of 10 to 60 N."""
    family, first = trial
    models = [object_alone(draw_condition(family, seed)) for seed in range(first, first + _CHUNK)]
    verdicts = _outcomes(models, np.random.default_rng([0, FAMILIES.index(family), first]))
    return [{"family": family, "seed": seed, "outcome": outcome} for seed, outcome in enumerate(verdicts, start=first)]


def survey(count: int, workers: int, out: Path) -> None:
    """Print a line of JSON for each family: the count of each outcome, and the seeds that failed."""
    report = lambda what, done: print(f"{what}, {done:.0%}", flush=True)  # noqa: E731
    for family in FAMILIES:
        chunks = {f"{family}-0-{first:05d}": (family, first) for first in range(0, count, _CHUNK)}
        rows = run_trials(chunks, outcomes, out, report, workers=workers)
        failed = [row["seed"] for row in rows if row["outcome"] in ("exploded", "did not settle")]
        counts = dict(sorted(Counter(row["outcome"] for row in rows).items()))
        print(json.dumps({"family": family, "conditions": len(rows), **counts, "seeds that failed": failed}))


def _wrenches(models: list[mujoco.MjModel], rng: np.random.Generator) -> np.ndarray:
    """Random wrenches ``[W, 6]`` at the objects' centres of mass [N, N m]."""
    worlds = len(models)
    mass = np.array([m.body_subtreemass[m.body("object0/object").id] for m in models])
    angle = rng.uniform(-np.pi, np.pi, worlds)
    # Limit the acceleration to 10 m/s^2, because a light box would fly off otherwise.
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
    # Only the sole of an object collides with the floor, so its motion after toppling is not physical.
    upright = slice(0, np.argmax(tilt < 0.8) if (tilt < 0.8).any() else len(tilt))
    finite = np.isfinite(qpos[upright]).all() and np.isfinite(qvel[upright]).all()
    if not finite or speed[upright].max(initial=0) > 20 or np.abs(qpos[upright, 2]).max(initial=0) > 0.3:
        return "exploded"
    if settling and speed[-1] > 0.02:
        return "did not settle"
    if not tilt.min() >= 0.8:
        return "toppled under the push"
    return "fine"


def robots(count: int) -> None:
    """Print the falls among ``count`` randomised robots in MJX.

    Each robot has its arms out and is pushed with up to 20 N for 0.5 s from any side.
    """
    import jax

    from shmoo_mjx.geometry.hands import HAND_HEIGHT, REACH
    from shmoo_mjx.plant.engine_mjx import MjxEngine
    from shmoo_mjx.plant.randomize import randomize
    from shmoo_mjx.plant.scene import build_scene
    from shmoo_mjx.plant.trials import drive

    rng, scene = np.random.default_rng(0), build_scene(engine="mjx")
    engine = MjxEngine([scene] * count)
    engine = engine.with_model(*randomize(engine.model, jax.random.split(jax.random.key(0), count), scene))
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
    excursion = {"largest excursion [m]": float(away.max()), "median excursion [m]": float(np.median(away))}
    print(json.dumps({"robots": count, "falls": int(fallen.sum()), **excursion}))


def main() -> None:
    """Survey the objects, or the robots."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=10_000, help="objects of each family, in hundreds")
    parser.add_argument("--workers", type=int, default=2, help="processes")
    parser.add_argument("--out", type=Path, default=Path("runs/plant_survey"))
    parser.add_argument("--robots", type=int, default=0, help="survey so many robots instead")
    options = parser.parse_args()
    if options.robots:
        robots(options.robots)
    else:
        survey(options.count, options.workers, options.out)


if __name__ == "__main__":
    main()
