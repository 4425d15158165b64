"""Train a small agent on ShmooPush-v0 by CMA-ES for some minutes, and draw its curve.

    uv run --with cma python examples/train_agent.py

The policy is linear: 27 observations, 4 actions, 112 numbers. CMA-ES (the package cma) needs no gradients and no GPU;
any other library that takes Gymnasium environments works as well, such as Stable-Baselines3.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import cma
import gymnasium
import numpy as np
from matplotlib.figure import Figure

STEPS = 120  # 12 s of each episode
SCALE = np.repeat([0.1, 0.5, 0.5, 0.5, 1.0, 0.5, 50.0, 1.0, 0.5], [2, 2, 3, 4, 4, 3, 3, 4, 2])  # of the observations
HELD_OUT = range(900, 912)


def episode(weights: np.ndarray, seed: int) -> tuple[float, float]:
    """Return and final distance of the object from its goal [m] of one episode."""
    env = gymnasium.make("shmoo_mjx.gym:ShmooPush-v0", senses="perfect", max_episode_steps=STEPS)
    policy, limit = weights.reshape(4, -1), env.action_space.high
    seen, _ = env.reset(seed=seed)
    total, over = 0.0, False
    while not over:
        action = (limit * np.tanh(policy @ np.append(seen / SCALE, 1.0))).astype(np.float32)
        seen, reward, terminated, truncated, info = env.step(action)
        total, over = total + float(reward), terminated or truncated
    env.close()
    return total, info["distance"]


def scores(pool: ProcessPoolExecutor, candidates: Sequence[np.ndarray], seeds: Sequence[int]) -> np.ndarray:
    """Mean return and final distance ``[N, 2]`` of each candidate over the seeds."""
    pairs = [(weights, seed) for weights in candidates for seed in seeds]
    found = np.array(list(pool.map(episode, *zip(*pairs, strict=True), chunksize=2)))
    return found.reshape(len(candidates), len(seeds), 2).mean(axis=1)


def train(minutes: float, out: Path, workers: int, seed: int) -> list[tuple[float, float, float]]:
    """Rows of the curve: minutes, return and final distance on episodes that training never sees."""
    search = cma.CMAEvolutionStrategy(
        np.zeros(4 * (len(SCALE) + 1)), 0.3, {"seed": seed + 1, "popsize": 14, "verbose": -9}
    )
    rng, began, curve = np.random.default_rng(seed), time.monotonic(), []
    with ProcessPoolExecutor(workers) as pool:
        while not curve or curve[-1][0] < minutes:
            mean = scores(pool, [search.mean], HELD_OUT)[0]
            curve.append(((time.monotonic() - began) / 60, *mean.tolist()))
            print(f"{curve[-1][0]:5.1f} min  return {mean[0]:+.2f}  final distance {mean[1]:.2f} m", flush=True)
            for _ in range(3):
                candidates = search.ask()
                seeds = rng.integers(1000, 100_000, 3).tolist()  # the same for all: what differs is the policy
                search.tell(candidates, (-scores(pool, candidates, seeds)[:, 0]).tolist())
    np.save(out.with_suffix(".npy"), search.mean.reshape(4, -1))
    return curve


def draw(curve: list[tuple[float, float, float]], file: Path) -> None:
    """The curve as a picture."""
    minutes, returns, distances = np.array(curve).T
    figure = Figure(figsize=(6.0, 3.0), layout="constrained")
    left, right = figure.subplots(1, 2)
    for axes, values, name in ((left, returns, "return"), (right, distances, "final distance from the goal [m]")):
        axes.plot(minutes, values, "o-", color="#0072B2", ms=4)
        axes.set(xlabel="time [min]", ylabel=name)
        axes.grid(alpha=0.3)
    figure.savefig(file, dpi=110)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--minutes", type=float, default=6.0)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=Path("agent.png"))
    given = parser.parse_args()
    draw(train(given.minutes, given.out, given.workers, given.seed), given.out)
    print(given.out)
