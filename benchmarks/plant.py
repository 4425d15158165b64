"""Steps per second of the plant with its low-level control: C MuJoCo and MJX, by scene and batch size.

One step is 2 ms and includes its control. On a CPU, MJX distributes the worlds over the devices that JAX sees.
"""

from __future__ import annotations

import functools
import importlib.util
import time
from dataclasses import dataclass
from typing import Any, Literal

import jax
import mujoco
import numpy as np
from mujoco.rollout import Rollout

from shmoo_mjx.geometry.hands import HAND_HEIGHT, REACH
from shmoo_mjx.plant.engine_mjx import MjxEngine
from shmoo_mjx.plant.engine_mujoco import MujocoEngine
from shmoo_mjx.plant.objects import draw_condition
from shmoo_mjx.plant.scene import Scene, build_scene
from shmoo_mjx.plant.trials import command

from .registry import BenchOptions, Measured
from .workers import usable_cores

Row = dict[str, Any]

SCENES = ("robot", "box", "cart", "wheelchair", "room")
WORLDS = 256
"""Worlds per batch of the C engine, enough to keep two threads busy."""


@dataclass(frozen=True)
class PlantSizes:
    """Sizes of the benchmark."""

    scenes: tuple[str, ...] = SCENES
    batches: tuple[int, ...] = (64, 512)
    """Numbers of worlds for MJX."""
    seconds: float = 3.0
    """Minimum time for which each rate is measured [s]."""


FULL = PlantSizes()
QUICK = PlantSizes(scenes=("robot", "box"), batches=(16,), seconds=0.3)
GPU = PlantSizes(scenes=("cart",), batches=(512, 8192))


def run(cfg: PlantSizes, options: BenchOptions) -> Measured:
    """Rates of every scene on both engines. The scenes are fixed, so the seed has no effect."""
    rows: list[Row] = []
    warp = jax.default_backend() == "gpu" and importlib.util.find_spec("warp") is not None
    for done, name in enumerate(cfg.scenes):
        options.progress(f"C MuJoCo, {name}", done / len(cfg.scenes))
        here = c_rows(name, usable_cores(), cfg.seconds)
        rates = {(row["state"], row["threads"]): row["steps_per_s"] for row in here}
        # On a CPU, the time of six objects grows with the number of worlds: 512 worlds take more than ten minutes.
        batches = cfg.batches[:1] if name == "room" and jax.default_backend() == "cpu" else cfg.batches
        for i, batch in enumerate(batches):
            options.progress(f"MJX, {name}, {batch} worlds", (done + (i + 1) / (len(batches) + 1)) / len(cfg.scenes))
            here += mjx_rows(name, batch, cfg.seconds, rates)
            if warp and name != "room":
                here += mjx_rows(name, batch, cfg.seconds, rates, impl="warp")
        rows += here
    metrics = {key: value for row in rows for key, value in _metrics(row).items()}
    return Measured(metrics, rows)


def _metrics(row: Row) -> dict[str, float]:
    state = row["state"].replace(" ", "_")
    if row["engine"] == "C":
        return {f"{row['scene']}_c_{row['threads']}_threads_{state}_steps_per_s": row["steps_per_s"]}
    name = f"{row['scene']}_{row['engine'].lower().replace(' ', '_')}_{row['batch']}_worlds"
    over = row[f"over C {row['state']}, 1 threads"]
    rates = {f"{name}_{state}_steps_per_s": row["steps_per_s"], f"{name}_{state}_over_c_1_thread": over}
    return rates | {f"{name}_compile_s": row["compile_s"]}


def scene_of(name: str, engine: Literal["mujoco", "mjx"]) -> Scene:
    """The scene ``name``: the robot alone, the robot with one object 5 cm in front of its extended hands, or a room
    with six objects."""
    if name == "robot":
        return build_scene(engine=engine)
    if name != "room":
        condition = draw_condition(name, 1)
        return build_scene([(condition, (REACH + 0.09 + condition.half_extents[0], 0.0, 0.0))], engine=engine)
    families = ("box", "cart", "wheelchair") * 2
    objects = [(draw_condition(f, i), (1.2 + 1.5 * (i // 2), 2.0 * (i % 2), 0.0)) for i, f in enumerate(families)]
    return build_scene(objects, walls=[(3.0, -1.5, 4.0, 0.1), (3.0, 3.5, 4.0, 0.1)], engine=engine)


def _best(run: Any, steps: int, seconds: float) -> float:
    """Steps per second of the fastest repetition, because other processes can only slow a repetition down."""
    best, spent, repetitions = np.inf, 0.0, 0
    while spent < seconds or repetitions < 3:
        started = time.perf_counter()
        run()
        once = time.perf_counter() - started
        best, spent, repetitions = min(best, once), spent + once, repetitions + 1
    return steps / best


def _physics(scene: Any, threads: int, seconds: float) -> float:
    """Steps per second of C MuJoCo alone, with constant torques and one call for half a second.

    This is the upper limit for the number of threads.
    """
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
    return command(worlds, (0.05, 0.0), reach=REACH, hand_height=HAND_HEIGHT)


def _pushing(engine: Any, worlds: int) -> Any:
    """The worlds after 1 s of leaning forward, when the hands touch the object as in use."""
    world = engine.init()
    for _ in range(10):
        world, _ = engine.step(world, _wanted(worlds))
    return world


def c_rows(name: str, threads: int, seconds: float) -> list[Row]:
    """Rows of C MuJoCo with one thread and with ``threads``. They take turns, so that a busy machine slows both
    alike."""
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


def mjx_rows(
    name: str,
    batch: int,
    seconds: float,
    c_rates: dict[tuple[str, int], float],
    *,
    impl: Literal["jax", "warp"] = "jax",
) -> list[Row]:
    """Rows of MJX with ``batch`` worlds, standing and pushing.

    Args:
        name: one of `SCENES`.
        batch: number of worlds.
        seconds: minimum time of each measurement [s].
        c_rates: steps per second of C MuJoCo by state and number of threads, for the ratios.
        impl: implementation of MJX.
    """
    engine = MjxEngine([scene_of(name, "mjx")] * batch, impl=impl)
    started = time.perf_counter()
    jax.block_until_ready(engine.step(engine.init(), _wanted(batch)))
    first = time.perf_counter() - started
    devices = jax.devices()[: 1 if batch % len(jax.devices()) else None]
    rows = []
    for what, world in (("standing", engine.init()), ("pushing", _pushing(engine, batch))):
        run = lambda world=world: jax.block_until_ready(engine.step(world, _wanted(batch)))  # noqa: E731
        rate = _best(run, 50 * batch, seconds)
        row: Row = {
            "scene": name,
            "engine": "MJX" if impl == "jax" else "MJX Warp",
            "state": what,
            "device": f"{len(devices)} x {devices[0].device_kind}",
            "batch": batch,
            "compile_s": round(first - 50 * batch / rate, 1),
            "state_bytes_per_world": round(sum(np.asarray(leaf).nbytes for leaf in jax.tree.leaves(world)) / batch),
            "scratch_bytes_per_world": round(engine.scratch_bytes() / batch),
            "steps_per_s": round(rate),
        }
        alike = {(w, n): c for (w, n), c in c_rates.items() if w in ("physics alone", what)}
        over = {f"over C {w}, {n} threads": round(rate / c, 2) for (w, n), c in alike.items()}
        rows.append(row | over)
    return rows
