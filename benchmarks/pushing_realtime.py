"""Does pushing run in real time? 60 s of contact on C MuJoCo with the whole controller, against the clock.

Run: python benchmarks/pushing_realtime.py [--seconds 60] [--json pushing.json]

The goal stays ahead of the object, so that every sample is one of pushing: observation, estimate, MPPI (S = 500,
T = 30), governor, 50 physics steps with the low-level control. Compilation is left out and printed.
"""

from __future__ import annotations

import argparse
import json
import os
import time
from pathlib import Path
from typing import Any

import numpy as np


def measure(seconds: float) -> dict[str, Any]:
    """Push a box for ``seconds`` of simulated time."""
    import jax

    from shmoo_mjx.base.assets import WEIGHTS, asset
    from shmoo_mjx.behavior.push_task import pose_push_config
    from shmoo_mjx.behavior.skills import batched
    from shmoo_mjx.control.observation import ObjectObservation, local_distance_field
    from shmoo_mjx.control.pushing import PushController
    from shmoo_mjx.geometry.faces import faces_of, heading, stand_off
    from shmoo_mjx.geometry.hands import HAND_HEIGHT, REACH, touches
    from shmoo_mjx.learning.weights import load_weights
    from shmoo_mjx.planning.maps import OccupancyGrid, clearance_field
    from shmoo_mjx.plant.engine_mujoco import MujocoEngine
    from shmoo_mjx.plant.objects import draw_condition
    from shmoo_mjx.plant.scene import build_scene
    from shmoo_mjx.types import Command

    thing = draw_condition("box", 2, {"mass": 5.0, "payload": 0.0, "friction": 0.4})
    half, face = np.array(thing.half_extents), faces_of(thing.half_extents)[0]
    engine = MujocoEngine([build_scene([(thing, (0.0, 0.0, 0.0))], stand_off(np.zeros(3), face, 0.05))])
    clearance = clearance_field(OccupancyGrid(np.zeros((100, 600), np.int8), 0.1, (-5.0, -5.0, 0.0)))
    controller = PushController(load_weights(asset(WEIGHTS)), pose_push_config())
    world, seen = engine.step(engine.init(), batched(Command(np.zeros(3), 0.0, REACH, HAND_HEIGHT)), 1.0)
    state = controller.init(ObjectObservation.of(seen, 0), face, half, jax.random.key(0))
    u, spent, touching, begin = np.zeros(3), [], 0, time.perf_counter()
    warm_up = 10
    for i in range(round(seconds * 10) + warm_up):
        if i == warm_up:
            compiled, begin = time.perf_counter() - begin, time.perf_counter()
        pose = seen.object_pose[0, 0]
        if i % 50 == 0:
            around = local_distance_field(clearance, pose)
        start = time.perf_counter()
        now = ObjectObservation.of(seen, 0)
        u, state, _ = controller.step(state, now, u, pose + np.array([1.5, 0.0, -pose[2]]), around, half)
        controller.coast(state)
        spent.append(time.perf_counter() - start)
        world, seen = engine.step(world, batched(Command(u, heading(pose, face), REACH, HAND_HEIGHT)))
        touching += bool(touches(now.wrench))
    wall = time.perf_counter() - begin
    engine.close()
    control = 1000 * np.array(spent[warm_up:])
    return {
        "simulated_s": seconds,
        "wall_s": wall,
        "times_real_time": seconds / wall,
        "controller_ms": float(np.median(control)),
        "controller_p99_ms": float(np.quantile(control, 0.99)),
        "controller_max_ms": float(control.max()),
        "compile_s": compiled,
        "contact_share": touching / (len(spent)),
        "pushed_m": float(seen.object_pose[0, 0, 0]),
        "cores": len(os.sched_getaffinity(0)),
    }


def main() -> None:
    """Measure, print, and write the JSON."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    # As the command line does: the roll-outs are shared out among the cores.
    os.environ.setdefault("JAX_NUM_CPU_DEVICES", str(len(os.sched_getaffinity(0))))
    result = measure(options.seconds)
    for name, value in result.items():
        print(f"{name:20} {value:.3g}")
    if options.json:
        options.json.write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()
