"""Steps per second, compile time and memory of the plant with its control: C MuJoCo and MJX, by scene and batch.

Run: python benchmarks/plant_speed.py [--scene robot box cart wheelchair room] [--batch 1 64 512] [--json speed.json]
     python benchmarks/plant_speed.py --scene boxes0 boxes1 boxes2 boxes4 boxes6 --batch 64  (cost by number)
     python benchmarks/plant_speed.py --batch 512 2048 8192 32768  (a GPU, if JAX has one)

One step is 2 ms with its control. On a CPU, MJX parts the worlds over as many devices as there are cores.
"""

from __future__ import annotations

import argparse
import functools
import json
import os
import time
from pathlib import Path
from typing import Any, Literal

import numpy as np

SCENES = ("robot", "box", "cart", "wheelchair", "room")
WORLDS = 256
"""Worlds per batch of the C engine: enough for two threads to part."""


def scene_of(name: str, engine: Literal["mujoco", "mjx"]) -> Any:
    """The robot, 5 cm in front of it one object; a room with six; or ``boxesN``, N boxes in a row."""
    from shmoo_mjx.hands import REACH
    from shmoo_mjx.plant.objects import draw_condition
    from shmoo_mjx.plant.scene import build_scene

    if name == "robot":
        return build_scene(engine=engine)
    if name.startswith("boxes"):
        boxes = [(draw_condition("box", i), (1.0 + 1.2 * i, 0.0, 0.0)) for i in range(int(name[5:]))]
        return build_scene(boxes, engine=engine)
    if name != "room":
        condition = draw_condition(name, 1)
        return build_scene([(condition, (REACH + 0.09 + condition.half_extents[0], 0.0, 0.0))], engine=engine)
    families = ("box", "cart", "wheelchair") * 2
    objects = [(draw_condition(f, i), (1.2 + 1.5 * (i // 2), 2.0 * (i % 2), 0.0)) for i, f in enumerate(families)]
    return build_scene(objects, walls=[(3.0, -1.5, 4.0, 0.1), (3.0, 3.5, 4.0, 0.1)], engine=engine)


def _best(run: Any, steps: int, seconds: float) -> float:
    """Steps per second of the fastest repetition: neighbours only ever slow one down."""
    best, spent, repetitions = np.inf, 0.0, 0
    while spent < seconds or repetitions < 3:
        started = time.perf_counter()
        run()
        once = time.perf_counter() - started
        best, spent, repetitions = min(best, once), spent + once, repetitions + 1
    return steps / best


def _physics(scene: Any, threads: int, seconds: float) -> float:
    """C MuJoCo alone, with constant torques and one call for half a second: the most that threads can reach."""
    import mujoco
    from mujoco.rollout import Rollout

    worlds, steps = 32, 250
    data = mujoco.MjData(scene.model)
    data.qpos[:] = scene.qpos0
    row = np.empty(mujoco.mj_stateSize(scene.model, mujoco.mjtState.mjSTATE_FULLPHYSICS))
    mujoco.mj_getState(scene.model, data, row, mujoco.mjtState.mjSTATE_FULLPHYSICS)
    rollout, scratch = Rollout(nthread=threads), [mujoco.MjData(scene.model) for _ in range(threads)]
    start = np.repeat(row[None], worlds, axis=0)
    rate = _best(lambda: rollout.rollout([scene.model] * worlds, scratch, start, nstep=steps), worlds * steps, seconds)
    rollout.close()
    return rate


def _wanted(worlds: int) -> Any:
    from shmoo_mjx.hands import HAND_HEIGHT, REACH
    from shmoo_mjx.plant.trials import command

    return command(worlds, (0.05, 0.0), reach=REACH, hand_height=HAND_HEIGHT)


def _pushing(engine: Any, worlds: int) -> Any:
    """The worlds after one second: the hands touch, as they do in use."""
    world = engine.init()
    for _ in range(10):
        world, _ = engine.step(world, _wanted(worlds))
    return world


def _c_rows(name: str, threads: int, seconds: float) -> list[dict[str, Any]]:
    """One thread and ``threads``, by turns, so that a busy machine slows both alike."""
    from shmoo_mjx.plant.engine_mujoco import MujocoEngine

    scene = scene_of(name, "mujoco")
    engines = {n: MujocoEngine([scene] * WORLDS, threads=n) for n in sorted({1, threads})}
    starts = {"standing": engines[1].init(), "pushing": _pushing(engines[1], WORLDS)}
    rates = {(what, n): 0.0 for what in ("physics alone", *starts) for n in engines}
    for _ in range(3):
        for n, engine in engines.items():
            rates["physics alone", n] = max(rates["physics alone", n], _physics(scene, n, seconds / 3))
            for what, start in starts.items():
                run = functools.partial(engine.step, start, _wanted(WORLDS))
                rates[what, n] = max(rates[what, n], _best(run, 50 * WORLDS, seconds / 3))
    for engine in engines.values():
        engine.close()
    start = starts["standing"]
    size = 8 * start.physics.shape[1] + sum(np.asarray(leaf).nbytes for leaf in start.control) // WORLDS
    memory = {"state_bytes_per_world": size, "model_bytes": scene.model.nbuffer}
    return [
        {"scene": name, "engine": "C", "state": what, "threads": n, "steps_per_s": round(rate)}
        | {"over_one_thread": round(rate / rates[what, 1], 2)}
        | memory
        for (what, n), rate in rates.items()
    ]


def _mjx_rows(name: str, batch: int, seconds: float, c_rates: dict[tuple[str, int], float]) -> list[dict[str, Any]]:
    import jax

    from shmoo_mjx.plant.engine_mjx import MjxEngine

    engine = MjxEngine([scene_of(name, "mjx")] * batch)
    started = time.perf_counter()
    jax.block_until_ready(engine.step(engine.init(), _wanted(batch)))
    first = time.perf_counter() - started
    devices = jax.devices()[: 1 if batch % len(jax.devices()) else None]
    rows = []
    for what, world in (("standing", engine.init()), ("pushing", _pushing(engine, batch))):
        run = lambda world=world: jax.block_until_ready(engine.step(world, _wanted(batch)))  # noqa: E731
        rate = _best(run, 50 * batch, seconds)
        row = {
            "scene": name,
            "engine": "MJX",
            "state": what,
            "device": f"{len(devices)} x {devices[0].device_kind}",
            "batch": batch,
            "compile_s": round(first - 50 * batch / rate, 1),
            "state_bytes_per_world": round(sum(np.asarray(leaf).nbytes for leaf in jax.tree.leaves(world)) / batch),
            "scratch_bytes_per_world": round(engine.scratch_bytes() / batch),
            "steps_per_s": round(rate),
        }
        over = {f"over C {w}, {n} threads": round(rate / c, 2) for (w, n), c in c_rates.items() if w != _other(what)}
        rows.append(row | over)
    return rows


def _other(state: str) -> str:
    return "pushing" if state == "standing" else "standing"


def main() -> None:
    """Print one JSON line per row, and write them all to a file if asked."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--engine", nargs="+", choices=["c", "mjx"], default=["c", "mjx"])
    parser.add_argument("--scene", nargs="+", default=list(SCENES))
    parser.add_argument("--batch", nargs="+", type=int, default=[1, 64, 512])
    parser.add_argument("--threads", type=int, default=os.cpu_count())
    parser.add_argument("--seconds", type=float, default=3.0)
    parser.add_argument("--json", type=Path)
    args = parser.parse_args()
    cache = Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache")) / "shmoo_mjx" / "jax"
    os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(cache))
    os.environ.setdefault("XLA_FLAGS", f"--xla_force_host_platform_device_count={args.threads}")
    rows: list[dict[str, Any]] = []
    for name in args.scene:
        c_rates: dict[tuple[str, int], float] = {}
        if "c" in args.engine:
            for row in _c_rows(name, args.threads, args.seconds):
                c_rates[row["state"], row["threads"]] = row["steps_per_s"]
                rows.append(row)
                print(json.dumps(row), flush=True)
        for batch in args.batch if "mjx" in args.engine else []:
            for row in _mjx_rows(name, batch, args.seconds, c_rates):
                rows.append(row)
                print(json.dumps(row), flush=True)
    if args.json:
        args.json.write_text(json.dumps(rows, indent=1))


if __name__ == "__main__":
    main()
