"""Measure the environments' speed with random actions: one world in C MuJoCo, and many at once in MJX.

    uv run python examples/environment_speed.py --worlds 16 64

Steps per second of processor time, over all cores, hardly depend on what else the machine does.
"""

from __future__ import annotations

import argparse
import time

import gymnasium
import numpy as np

from shmoo_mjx.base.environment import prepare_environment


def measure(env: gymnasium.Env | gymnasium.vector.VectorEnv, worlds: int, seconds: float) -> str:
    """Steps of 0.1 s per second over all worlds, after the first step, which compiles."""
    env.action_space.seed(0)
    env.reset(seed=0)
    began = time.perf_counter()
    env.step(env.action_space.sample())
    first, steps, began, worked = time.perf_counter() - began, 0, time.perf_counter(), time.process_time()
    while time.perf_counter() - began < seconds:
        _, _, terminated, truncated, _ = env.step(env.action_space.sample())
        if worlds == 1 and np.any(terminated | truncated):
            env.reset()  # many worlds begin anew by themselves
        steps += worlds
    wall, worked = time.perf_counter() - began, time.process_time() - worked
    env.close()
    return f"{steps / wall:.0f} steps/s, {steps / worked:.0f} per s of processor time; first step {first:.1f} s"


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--worlds", type=int, nargs="*", default=[16, 64])
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--env", default="ShmooPush-v0")
    parser.add_argument("--senses", nargs="+", default=["real", "perfect"], choices=["real", "perfect"])
    given = parser.parse_args()
    prepare_environment()  # one CPU device per core, as on the command line
    name = f"shmoo_mjx.gym:{given.env}"
    for senses in given.senses:
        alone = measure(gymnasium.make(name, senses=senses), 1, given.seconds)
        print(f"{senses}, one world: {alone}", flush=True)
        for worlds in given.worlds:
            batch = measure(gymnasium.make_vec(name, num_envs=worlds, senses=senses), worlds, given.seconds)
            print(f"{senses}, {worlds} worlds: {batch}", flush=True)
