"""What a step of robot and cart spends in MJX: solver, cones, colliding pairs; and what the motion is without each.

Run: python benchmarks/mjx_profile.py [--family cart] [--batch 64] [--only shipped "4 iterations"]

Processor time per step of 2 ms, over that of the shipped settings, so that a busy machine matters less; and the error
against C MuJoCo after 1 s of pushing: what leaves it as it is can be had for nothing.
"""

from __future__ import annotations

import argparse
import copy
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import jax
import mujoco
import numpy as np

from shmoo_mjx.geometry.hands import HAND_HEIGHT, REACH
from shmoo_mjx.plant.engine_mjx import MjxEngine
from shmoo_mjx.plant.engine_mujoco import MujocoEngine
from shmoo_mjx.plant.objects import draw_condition
from shmoo_mjx.plant.scene import build_scene
from shmoo_mjx.plant.trials import command
from shmoo_mjx.report.tables import markdown_table

Change = Callable[[mujoco.MjModel], None]


def _nothing(model: mujoco.MjModel) -> None:
    pass


def _pyramidal(model: mujoco.MjModel) -> None:
    model.opt.cone = mujoco.mjtCone.mjCONE_PYRAMIDAL


def _no_hands(model: mujoco.MjModel) -> None:
    for i in range(model.ngeom):
        if model.geom(i).name.endswith("hull"):
            model.geom_contype[i] = model.geom_conaffinity[i] = 0


def _sparse(model: mujoco.MjModel) -> None:
    model.opt.jacobian = mujoco.mjtJacobian.mjJAC_SPARSE


def _explicit(model: mujoco.MjModel) -> None:
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_EULER


VARIANTS: dict[str, tuple[Change, dict[str, Any]]] = {
    "shipped": (_nothing, {}),
    "4 iterations": (_nothing, {"iterations": 4}),
    "2 iterations": (_nothing, {"iterations": 2}),
    "1 iteration": (_nothing, {"iterations": 1}),
    "4 line-search steps": (_nothing, {"line_search": 4}),
    "tolerance 1e-4": (_nothing, {"tolerance": 1e-4}),
    "tolerance 1e-3": (_nothing, {"tolerance": 1e-3}),
    "pyramidal cones": (_pyramidal, {}),
    "sparse Jacobian": (_sparse, {}),
    "Euler integration": (_explicit, {}),
    "no pair of hand and object": (_no_hands, {}),
}


def measure(family: str, batch: int, rounds: int, names: list[str]) -> list[dict[str, Any]]:
    """One row per variant; their turns are taken in short rounds."""
    condition = draw_condition(family, 1)
    place = [(condition, (REACH + 0.09 + condition.half_extents[0], 0.0, 0.0))]
    scene = build_scene(place, engine="mjx")
    true = MujocoEngine([build_scene(place)])
    wanted = true.init()
    for _ in range(10):
        wanted, _ = true.step(wanted, _ask(1))
    rows, running = [], []
    for name in names:
        change, solver = VARIANTS[name]
        model = copy.deepcopy(scene.model)
        change(model)
        engine = MjxEngine([replace(scene, model=model)] * batch, **solver)
        world = engine.init()
        for _ in range(10):
            world, _ = engine.step(world, _ask(batch))
        error = np.abs(np.asarray(world.physics[0]) - wanted.physics[0, : world.physics.shape[1]])
        contacts = int(engine._template._impl.contact.dist.shape[0])
        limits = int(engine._template._impl.efc_J.shape[0])
        rows.append({"name": name, "pairs": contacts, "constraints": limits, "error": error[1 : 1 + model.nq].max()})
        running.append((engine, world))
        print(f"compiled: {name}", flush=True)
    spent: list[list[float]] = [[] for _ in rows]
    for _ in range(rounds):
        for (engine, world), mine in zip(running, spent, strict=True):
            began = time.process_time()
            jax.block_until_ready(engine.step(world, _ask(batch)))
            mine.append((time.process_time() - began) / (50 * batch))
    for row, mine in zip(rows, spent, strict=True):
        row |= {"us": 1e6 * float(np.median(mine)), "share": float(np.median(mine) / np.median(spent[0]))}
    return rows


def _ask(worlds: int) -> Any:
    return command(worlds, (0.05, 0.0), reach=REACH, hand_height=HAND_HEIGHT)


def main() -> None:
    """Measure and print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--family", default="cart")
    parser.add_argument("--batch", type=int, default=64)
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--only", nargs="+", choices=list(VARIANTS), default=list(VARIANTS), help="the first is the 1")
    args = parser.parse_args()
    rows = measure(args.family, args.batch, args.rounds, args.only)
    head = ["", "us a step", "share", "contacts", "constraint rows", "error after 1 s [m, rad]"]
    body = [
        [r["name"], f"{r['us']:.0f}", f"{r['share']:.2f}", str(r["pairs"]), str(r["constraints"]), f"{r['error']:.1e}"]
        for r in rows
    ]
    print(markdown_table(head, body))


if __name__ == "__main__":
    main()
