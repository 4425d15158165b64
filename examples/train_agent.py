"""Train a small agent on ShmooPush-v0 by CMA-ES for some minutes, and draw its curve.

    uv run --with cma python examples/train_agent.py --out agent.png

The policy is linear: 27 observations, 4 actions, 112 numbers. CMA-ES (the package cma) needs no gradients and no GPU;
any other library that takes Gymnasium environments works as well, such as Stable-Baselines3.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import cma
import gymnasium
import numpy as np
from matplotlib.figure import Figure

from shmoo_mjx.base.processes import process_pool

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


def train(
    pool: ProcessPoolExecutor, generations: int, seed: int
) -> Iterator[tuple[tuple[int, float, float], np.ndarray]]:
    """Search; after every third generation give (episodes, return, final distance [m]) and the policy ``[4, 28]``."""
    options = {"seed": seed + 1, "popsize": POPULATION, "verbose": -9}
    search = cma.CMAEvolutionStrategy(np.zeros(4 * (len(SCALE) + 1)), 0.3, options)
    rng = np.random.default_rng(seed)
    for generation in range(generations + 1):
        if generation % 3 == 0:
            gained, distance = scores(pool, [search.mean], HELD_OUT)[0].tolist()
            yield (generation * POPULATION * EPISODES, gained, distance), search.mean.reshape(4, -1)
        candidates = search.ask()
        seeds = rng.integers(1000, 100_000, EPISODES).tolist()  # the same for all: what differs is the policy
        search.tell(candidates, (-scores(pool, candidates, seeds)[:, 0]).tolist())


def draw(curves: Sequence[Sequence[tuple[int, float, float]]], file: Path) -> None:
    """Return and final distance over the episodes of training: each training thin, the mean of whole ones thick."""
    figure = Figure(figsize=(6.0, 3.0), layout="constrained")
    whole = np.array([curve for curve in curves if len(curve) == len(curves[0])])
    for column, name in ((1, "return"), (2, "final distance from the goal [m]")):
        axes = figure.add_subplot(1, 2, column)
        for curve in curves:
            axes.plot(np.array(curve)[:, 0], np.array(curve)[:, column], color="#56B4E9", lw=0.8)
        axes.plot(whole[0, :, 0], whole[:, :, column].mean(axis=0), "o-", color="#0072B2", ms=4)
        axes.set(xlabel="episodes of training", ylabel=name)
        axes.grid(alpha=0.3)
    figure.savefig(file, dpi=110)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--generations", type=int, default=36)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--seeds", type=int, default=1, help="trainings, one after the other")
    parser.add_argument("--out", type=Path, default=Path("agent.png"))
    given = parser.parse_args()
    began, curves = time.monotonic(), list[list[tuple[int, float, float]]]()
    with process_pool(given.workers) as pool:
        for seed in range(given.seeds):
            curves.append([])
            for point, policy in train(pool, given.generations, seed):
                curves[-1].append(point)
                draw(curves, given.out)
                np.save(given.out.with_suffix(".npy"), policy)
                minutes = (time.monotonic() - began) / 60
                told = f"{point[0]:4d} episodes: return {point[1]:+.2f}, final distance {point[2]:.2f} m"
                print(f"{minutes:5.1f} min, seed {seed}, {told}", flush=True)
    print(given.out)
