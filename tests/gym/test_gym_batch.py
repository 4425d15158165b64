"""Batched worlds in MJX are what the single environments in C MuJoCo are, and go on by themselves."""

# ruff: noqa: E402 (without the extra the file is skipped before it imports what needs it)
from __future__ import annotations

import copy
import pickle
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

gymnasium = pytest.importorskip("gymnasium", reason="the extra gym (gymnasium) is not installed")

import shmoo_mjx.gym  # noqa: F401  (registers the environments)

LIMIT = 5


@pytest.fixture(scope="module")
def pair() -> Any:
    """Two worlds with a box each, which compile once for this file."""
    batch = gymnasium.make_vec("ShmooPush-v0", num_envs=2, max_episode_steps=LIMIT, senses="perfect")
    yield batch
    batch.close()


def agree(batch: Any, name: str, steps: int, *, senses: str = "perfect", atol: float = 5e-3) -> None:
    """The batch does what single environments of the same seeds do."""
    singles = [gymnasium.make(name, senses=senses) for _ in range(batch.num_envs)]
    seen, _ = batch.reset(seed=5)
    np.testing.assert_allclose(seen, [e.reset(seed=5 + i)[0] for i, e in enumerate(singles)], atol=1e-5)
    rng, high = np.random.default_rng(0), batch.single_action_space.high
    for _ in range(steps):
        actions = (0.5 * high * rng.uniform(0, 1, (len(singles), len(high)))).astype(np.float32)
        seen, reward, terminated, _, info = batch.step(actions)
        alone = [e.step(a) for e, a in zip(singles, actions, strict=True)]
        np.testing.assert_allclose(seen, [a[0] for a in alone], atol=atol)
        np.testing.assert_allclose(reward, [a[1] for a in alone], atol=1e-4)
        assert terminated.tolist() == [a[2] for a in alone]
        assert info["distance"].tolist() == pytest.approx([a[4]["distance"] for a in alone], abs=1e-3)
        assert info["_distance"].all()


@pytest.mark.slow
def test_pushes_agree_and_episodes_follow_each_other_in_the_same_world(pair: Any) -> None:
    agree(pair, "ShmooPush-v0", LIMIT - 2)
    still = np.zeros(pair.action_space.shape, dtype=np.float32)
    for _ in range(2):
        _, _, terminated, truncated, _ = pair.step(still)
    assert truncated.all() and not terminated.any()
    before = pair.starts
    seen, reward, _, truncated, _ = pair.step(still)
    assert not truncated.any() and not reward.any()
    assert seen in pair.observation_space
    for i, (old, new) in enumerate(zip(before, pair.starts, strict=True)):
        assert new.conditions == old.conditions and not np.allclose(new.goal, old.goal)
        assert np.linalg.norm(seen[i, 21:23] - seen[i, 11:13]) == pytest.approx(np.linalg.norm(new.goal[:2]), abs=1e-3)
    assert np.abs(pair.step(still)[1]).max() < 0.01
    # Other objects, the same program.
    pair.reset(seed=11)
    assert all(new.conditions != old.conditions for old, new in zip(before, pair.starts, strict=True))
    pair.step(still)
    assert pair._engine._batched._cache_size() == 1


@pytest.mark.slow
def test_other_objects_move_otherwise(pair: Any) -> None:
    agree(pair, "ShmooPush-v0", 2)
    world, seen = pair._world, pair.step(np.full((2, 4), 0.05, np.float32))[0]
    pair._engine.change(pair._scenes[::-1])
    pair._world = world
    assert np.abs(pair.step(np.full((2, 4), 0.05, np.float32))[0] - seen).max() > 1e-4
    pair.reset(seed=5)


@pytest.mark.slow
def test_one_world_may_begin_anew_while_the_other_goes_on(pair: Any) -> None:
    pair.reset(seed=3)
    forward = np.array([[0.08, 0, 0, 0]] * 2, dtype=np.float32)
    for _ in range(LIMIT - 1):
        seen = pair.step(forward)[0]
    pair._over = np.array([True, False])
    after, reward, *_ = pair.step(forward)
    assert reward[0] == 0.0 and reward[1] != 0.0
    assert pair._steps.tolist() == [0, LIMIT]
    assert np.abs(after[0, 4:7]).max() < 1e-6 and after[1, 4] > 0.01
    np.testing.assert_allclose(after[1], seen[1], atol=0.3)


@pytest.mark.slow
def test_real_senses_in_a_batch() -> None:
    batch = gymnasium.make_vec("ShmooPush-v0", num_envs=2, max_episode_steps=LIMIT)
    first, _ = batch.reset(seed=5)
    assert first in batch.observation_space
    forward = np.array([[0.08, 0, 0, 0]] * 2, dtype=np.float32)
    once = [batch.step(forward)[0] for _ in range(3)]
    true = batch._sensed.true_observation(batch._world)
    assert 1e-5 < np.abs(once[-1][:, :2] - true.lean).max() < 0.02
    assert len({float(s.model.body("robot/torso").mass[0]) for s in batch._scenes}) == 2
    batch.reset(seed=5)
    for seen in once:
        np.testing.assert_array_equal(batch.step(forward)[0], seen)
    batch._over = np.array([True, False])
    after, reward, *_ = batch.step(forward)
    assert reward[0] == 0.0 and np.isfinite(after).all()
    lost(batch)
    batch.close()


@pytest.mark.slow
@pytest.mark.parametrize("worlds", [2, 3])
def test_with_real_senses_each_world_is_the_single_environment_of_its_seed(worlds: int) -> None:
    batch = gymnasium.make_vec("ShmooPush-v0", num_envs=worlds, max_episode_steps=LIMIT)
    # Errors of the camera are centimetres, and the robots' bodies differ by 15 %.
    agree(batch, "ShmooPush-v0", LIMIT, senses="real", atol=1e-3)
    batch.close()


@pytest.mark.slow
def test_any_episode_of_a_world_is_repeated_by_its_seed_alone() -> None:
    batch, alone = (gymnasium.make_vec("ShmooPush-v0", num_envs=n, max_episode_steps=LIMIT) for n in (3, 1))
    seen, same = batch.reset(seed=np.int64(5))[0], alone.reset(seed=7)[0]
    np.testing.assert_allclose(seen[2:], same, atol=1e-5)
    rng, ends = np.random.default_rng(0), 0
    for _ in range(2 * LIMIT + 3):
        actions = rng.uniform(0.0, 0.07, (3, 4)).astype(np.float32)
        (seen, reward, *_), (same, also, _, truncated, _) = batch.step(actions), alone.step(actions[2:])
        np.testing.assert_allclose(seen[2:], same, atol=1e-3)
        np.testing.assert_allclose(reward[2:], also, atol=1e-4)
        ends += int(truncated[0])
    assert ends == 2
    batch.close()
    alone.close()


def lost(batch: Any) -> None:
    """World 0 of two diverges: it ends with a reason, nothing is NaN, and world 1 does not notice."""
    forward = np.array([[0.05, 0, 0, 0]] * 2, dtype=np.float32)
    batch.reset(seed=5)
    batch.step(forward)
    seen, reward, *_ = copy.deepcopy(batch).step(forward)
    sound = batch._world.truth
    batch._world = batch._world._replace(truth=sound._replace(physics=sound.physics.at[0, 3].set(np.nan)))
    after, paid, terminated, truncated, info = batch.step(forward)
    np.testing.assert_array_equal(after[1], seen[1])
    assert paid.tolist() == [batch.task.fall, reward[1]]
    assert terminated.tolist() == [True, False] and not truncated.any()
    assert info["reason"].tolist() == ["diverged", ""] and not info["fallen"].any()
    assert after in batch.observation_space and np.isfinite(info["distance"]).all()
    after, paid, terminated, _, info = batch.step(forward)
    assert paid[0] == 0.0 and not terminated.any() and info["reason"].tolist() == ["", ""]
    after, paid, terminated, *_ = batch.step(forward)
    assert np.isfinite(after).all() and np.isfinite(paid).all() and not terminated.any()


@pytest.mark.slow
def test_a_world_that_diverges_ends_and_touches_no_other(pair: Any) -> None:
    lost(pair)


@pytest.mark.slow
@pytest.mark.parametrize("copied", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))])
def test_a_copy_goes_on_where_the_original_stands(pair: Any, copied: Callable[[Any], Any]) -> None:
    copied(gymnasium.make_vec("ShmooPush-v0", num_envs=2)).close()
    forward = np.array([[0.05, 0, 0, 0]] * 2, dtype=np.float32)
    pair.reset(seed=2)
    pair.step(forward)
    other = copied(pair)
    for _ in range(2 * LIMIT):
        (seen, reward, *_), (same, also, *_) = pair.step(forward), other.step(forward)
        np.testing.assert_array_equal(seen, same)
        np.testing.assert_array_equal(reward, also)
    other.close()


@pytest.mark.slow
def test_rooms_agree() -> None:
    batch = gymnasium.make_vec("ShmooNavigate-v0", num_envs=2, senses="perfect")
    agree(batch, "ShmooNavigate-v0", 4)
    batch.close()
