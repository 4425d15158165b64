"""Steps per second of the plant with its control: C MuJoCo and MJX, by scene and batch (docs/plant.md has a table).

Run: python benchmarks/plant_speed.py [--engine c|mjx] [--scene robot box cart wheelchair room] [--batch 1 64 512]
"""

from __future__ import annotations

import argparse
import json
import os
import time
from pathlib import Path
from typing import Any, Literal

import numpy as np

from shmoo_mjx.hands import HAND_HEIGHT, REACH
from shmoo_mjx.plant.objects import draw_condition
from shmoo_mjx.plant.scene import Scene, build_scene
from shmoo_mjx.plant.trials import command

SCENES = ("robot", "box", "cart", "wheelchair", "room")


def scene_of(name: str, engine: Literal["mujoco", "mjx"]) -> Scene:
    """The robot, 5 cm in front of it one object; or a room with six."""
    if name == "robot":
        return build_scene(engine=engine)
    if name != "room":
        condition = draw_condition(name, 1)
        return build_scene([(condition, (REACH + 0.09 + condition.half_extents[0], 0.0, 0.0))], engine=engine)
    families = ("box", "cart", "wheelchair") * 2
    objects = [(draw_condition(f, i), (1.2 + 1.5 * (i // 2), 2.0 * (i % 2), 0.0)) for i, f in enumerate(families)]
    return build_scene(objects, walls=[(3.0, -1.5, 4.0, 0.1), (3.0, 3.5, 4.0, 0.1)], engine=engine)


def _timed(engine: Any, worlds: int, seconds: float) -> tuple[float, float]:
    """(seconds of the first step with its compilation, steps per second after it)."""
    import jax

    world = engine.init()
    wanted = command(worlds, (0.05, 0.0), reach=REACH, hand_height=HAND_HEIGHT)
    started = time.perf_counter()
    for _ in range(2):
        world, seen = engine.step(world, wanted)
    jax.block_until_ready(seen)
    first = time.perf_counter() - started
    best, spent = np.inf, 0.0
    while spent < seconds:
        started = time.perf_counter()
        world, seen = engine.step(world, wanted)
        jax.block_until_ready(seen)
        once = time.perf_counter() - started
        best, spent = min(best, once), spent + once
    return first, 50 * worlds / best


def _physics_only(scene: Scene, threads: int, seconds: float) -> float:
    """Steps per second of C MuJoCo with constant torques: what the threads can reach."""
    import mujoco
    from mujoco.rollout import Rollout

    worlds, steps = 16, 250
    data = mujoco.MjData(scene.model)
    data.qpos[:] = scene.qpos0
    row = np.empty(mujoco.mj_stateSize(scene.model, mujoco.mjtState.mjSTATE_FULLPHYSICS))
    mujoco.mj_getState(scene.model, data, row, mujoco.mjtState.mjSTATE_FULLPHYSICS)
    rollout = Rollout(nthread=threads if threads > 1 else 0)
    scratch = [mujoco.MjData(scene.model) for _ in range(threads)]
    best, spent = np.inf, 0.0
    while spent < seconds:
        started = time.perf_counter()
        rollout.rollout([scene.model] * worlds, scratch, np.repeat(row[None], worlds, axis=0), nstep=steps)
        once = time.perf_counter() - started
        best, spent = min(best, once), spent + once
    rollout.close()
    return worlds * steps / best


def main() -> None:
    """Print one JSON line per row; the fastest of the repetitions, since neighbours only ever slow one down."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--engine", nargs="+", default=["physics", "c", "mjx"])
    parser.add_argument("--scene", nargs="+", default=list(SCENES))
    parser.add_argument("--batch", nargs="+", type=int, default=[1, 64, 512])
    parser.add_argument("--seconds", type=float, default=2.0)
    args = parser.parse_args()
    cache = Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache")) / "shmoo_mjx" / "jax"
    os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(cache))
    from shmoo_mjx.plant.engine_mjx import MjxEngine
    from shmoo_mjx.plant.engine_mujoco import MujocoEngine

    for name in args.scene:
        for threads in (1, 2):
            row: dict[str, Any] = {"scene": name, "threads": threads}
            if "physics" in args.engine:
                rate = _physics_only(scene_of(name, "mujoco"), threads, args.seconds)
                print(json.dumps(row | {"engine": "C physics", "steps_per_s": round(rate)}), flush=True)
            if "c" in args.engine:
                engine = MujocoEngine([scene_of(name, "mujoco")] * 64, threads=threads)
                _, rate = _timed(engine, 64, args.seconds)
                engine.close()
                print(json.dumps(row | {"engine": "C with control, 64 worlds", "steps_per_s": round(rate)}), flush=True)
        for batch in args.batch if "mjx" in args.engine else []:
            engine_mjx = MjxEngine([scene_of(name, "mjx")] * batch)
            first, rate = _timed(engine_mjx, batch, args.seconds)
            state = sum(np.asarray(leaf).nbytes for leaf in _leaves(engine_mjx.init())) / batch
            row = {
                "scene": name,
                "engine": "MJX",
                "batch": batch,
                "first_s": round(first, 1),
                "state_bytes": int(state),
            }
            print(json.dumps(row | {"steps_per_s": round(rate)}), flush=True)


def _leaves(tree: Any) -> list[Any]:
    import jax

    return jax.tree.leaves(tree)


if __name__ == "__main__":
    main()
