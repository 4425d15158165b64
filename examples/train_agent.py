"""Train a small agent on ShmooPush-v0 by CMA-ES for some minutes, and draw its curve.

    uv run --with cma python examples/train_agent.py --out agent.png

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
"""Seeds of the episodes that the curve is taken on and that training never sees."""
POPULATION, EPISODES = 14, 3
"""Policies in a generation, and episodes of each."""


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


def train(generations: int, workers: int, seed: int, out: Path) -> None:
    """Search, and after every third generation draw the curve and keep the policy ``[4, 28]``."""
    options = {"seed": seed + 1, "popsize": POPULATION, "verbose": -9}
    search = cma.CMAEvolutionStrategy(np.zeros(4 * (len(SCALE) + 1)), 0.3, options)
    rng, began, curve = np.random.default_rng(seed), time.monotonic(), list[tuple[int, float, float]]()
    with ProcessPoolExecutor(workers) as pool:
        for generation in range(generations + 1):
            if generation % 3 == 0:
                gained, distance = scores(pool, [search.mean], HELD_OUT)[0].tolist()
                curve.append((generation * POPULATION * EPISODES, gained, distance))
                draw(curve, out)
                np.save(out.with_suffix(".npy"), search.mean.reshape(4, -1))
                minutes = (time.monotonic() - began) / 60
                print(
                    f"{minutes:5.1f} min, {curve[-1][0]:4d} episodes: return {gained:+.2f}, "
                    f"final distance {distance:.2f} m",
                    flush=True,
                )
            candidates = search.ask()
            seeds = rng.integers(1000, 100_000, EPISODES).tolist()  # the same for all: what differs is the policy
            search.tell(candidates, (-scores(pool, candidates, seeds)[:, 0]).tolist())


def draw(curve: list[tuple[int, float, float]], file: Path) -> None:
    """Return and final distance over the episodes of training."""
    episodes, returns, distances = np.array(curve).T
    figure = Figure(figsize=(6.0, 3.0), layout="constrained")
    left, right = figure.subplots(1, 2)
    for axes, values, name in ((left, returns, "return"), (right, distances, "final distance from the goal [m]")):
        axes.plot(episodes, values, "o-", color="#0072B2", ms=4)
        axes.set(xlabel="episodes of training", ylabel=name)
        axes.grid(alpha=0.3)
    figure.savefig(file, dpi=110)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--generations", type=int, default=36)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=Path("agent.png"))
    given = parser.parse_args()
    train(given.generations, given.workers, given.seed, given.out)
    print(given.out)
