"""Batches of worlds in MJX as a ``gymnasium.vector.VectorEnv``."""

from __future__ import annotations

from typing import Any, ClassVar

import gymnasium
import jax
import jax.numpy as jnp
import numpy as np
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from shmoo_mjx.base.processes import check_forked
from shmoo_mjx.errors import ShmooError
from shmoo_mjx.gym import EPISODE_STEPS
from shmoo_mjx.gym.navigate import NavigateTask
from shmoo_mjx.gym.push import PushEnvTask
from shmoo_mjx.gym.single import checked, space
from shmoo_mjx.gym.task import Judged, Outcome, Start, Task, begun, info_of, judged, seed_of
from shmoo_mjx.plant.engine_mjx import MjxEngine, MjxWorld
from shmoo_mjx.sensing import SensedEngine, SensedWorld, senses_named
from shmoo_mjx.types import Observation


class ShmooVectorEnv(VectorEnv[np.ndarray, np.ndarray, np.ndarray]):
    """Vector environment that steps a task in ``num_envs`` worlds together.

    World i equals a single environment with seed ``seed + i``, including noise. Its objects and walls stay the same
    until the next ``reset(seed=...)``. After an episode ends, the next one starts in the same world, with a new start
    and goal if the task draws these separately. It starts in the step after the end (NEXT_STEP). In that step the
    world's action has no effect and its reward is 0.

    The result for a world depends only on its seed and its actions: one world with ``seed + i`` repeats any episode of
    world i.

    Args:
        num_envs: number of worlds W.
        max_episode_steps: number of steps after which an episode is truncated, by default that of the environment.
        config: configuration of the task.
        senses: sensing, "real" or "perfect".
        render_mode: not supported, must be None.
    """

    metadata: dict[str, Any] = {"autoreset_mode": AutoresetMode.NEXT_STEP}  # noqa: RUF012 (as Gymnasium declares it)

    kind: ClassVar[type[PushEnvTask] | type[NavigateTask]]
    steps: ClassVar[int]
    """Default number of steps after which an episode is truncated."""

    def __init__(
        self,
        num_envs: int = 1,
        max_episode_steps: int | None = None,
        *,
        config: Any = None,
        senses: str = "real",
        render_mode: str | None = None,
    ) -> None:
        if render_mode is not None:
            raise ShmooError(
                f"render_mode {render_mode!r}: many worlds in one program are not drawn; leave it out, or make single "
                "environments with vectorization_mode='sync'."
            )
        self.render_mode = render_mode
        self.senses = senses_named(senses)
        self.task: Task = self.kind(config)
        self.num_envs, self.limit = num_envs, max_episode_steps or self.steps
        self.single_observation_space, self.single_action_space = space(self.task.observation), space(self.task.action)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._engine: MjxEngine | None = None
        self._sensed: SensedEngine
        self._world: SensedWorld
        self._observed: Observation
        self._outcome: Outcome
        self._starts: list[Start]
        self._over = np.zeros(num_envs, dtype=bool)
        self._steps = np.zeros(num_envs, dtype=int)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Start an episode in every world. With a seed, and at the first call, new worlds are drawn.

        Args:
            seed: seed of the first world; world i gets ``seed + i``.
            options: must be empty.

        Returns:
            Observations ``[W, n]`` and info.
        """
        check_forked()
        seed = seed_of(seed, options)
        super().reset(seed=seed)
        if self._engine is None or seed is not None:
            first = int(self.np_random.integers(2**31)) if seed is None else seed
            self._rngs = [seeding.np_random(first + i)[0] for i in range(self.num_envs)]
            self._starts = [self.task.draw(rng) for rng in self._rngs]
            self._build(self._starts, [int(rng.integers(2**31)) for rng in self._rngs])
            self._begin(np.ones(self.num_envs, dtype=bool), drawn=True)
        else:
            self._begin(np.ones(self.num_envs, dtype=bool))
        self._outcome = self._judged()
        return self.task.observe(self._context, self._observed), self._infos(begun(self._outcome))

    def step(self, actions: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Hold ``actions [W, m]`` for 0.1 s.

        Returns:
            Observations ``[W, n]``, rewards, terminated, truncated (``[W]`` each), and info.
        """
        if self._engine is None:
            raise gymnasium.error.ResetNeeded("call reset before step")
        resetting = self._over
        wanted = self.task.command(checked(actions, self.action_space), self._observed)
        self._world, observed = self._sensed.step(self._world, wanted)
        diverged = self._sensed.diverged(self._world)
        # A diverged world keeps its last finite observation.
        self._observed = jax.tree.map(lambda new, old: _chosen(np, diverged, old, new), observed, self._observed)
        self._steps += 1
        if resetting.any():
            self._begin(resetting)
        fallen, touching = self._sensed.fallen(self._world), self._world.wall_contact
        fresh = begun(self._judged())
        step = judged(self.task, self._outcome, fresh.outcome, fallen=fallen, diverged=diverged, touching=touching)
        step = jax.tree.map(lambda new, old: np.where(resetting, new, old), fresh, step)
        self._outcome = step.outcome
        truncated = (self._steps >= self.limit) & ~step.terminated
        self._over = step.terminated | truncated
        vectors = self.task.observe(self._context, self._observed)
        return vectors, step.reward, step.terminated, truncated, self._infos(step)

    @property
    def starts(self) -> tuple[Start, ...]:
        """Start of each world's current episode, with object properties that the observation does not contain."""
        return tuple(self._starts)

    def _build(self, starts: list[Start], robots: list[int]) -> None:
        pairs = zip(starts, robots, strict=True)
        self._scenes = [start.scene("mjx", self.senses.adjust(robot)) for start, robot in pairs]
        if self._engine is None:
            self._engine = MjxEngine(self._scenes)
        else:
            self._engine.change(self._scenes)
        self._sensed = SensedEngine(
            self._scenes, self.senses, robots, poses_known=self.task.poses_known, backend=self._engine
        )

    def _begin(self, which: np.ndarray, drawn: bool = False) -> None:
        """Start episodes in the worlds ``which [W]``; ``drawn`` says whether their starts have been drawn already."""
        assert self._engine is not None
        if not drawn:
            for i in np.flatnonzero(which):
                self._starts[i] = self.task.draw(self._rngs[i], self._starts[i])
        self._context = self.task.gather(self._starts)
        fresh, whole = self._fresh(), which.all()
        if whole:
            self._world = self._sensed.begin(fresh)
        else:
            self._world = self._sensed.restart(self._world, _merged(which, fresh, self._world.truth), which)
        still = self._sensed.observe(self._world)
        self._observed = (
            still if whole else jax.tree.map(lambda new, old: _chosen(np, which, new, old), still, self._observed)
        )
        self._steps = np.where(which, 0, self._steps)
        self._over = self._over & ~which

    def _fresh(self) -> MjxWorld:
        assert self._engine is not None
        world = self._engine.init()
        qpos = [c.placed(s.robot_pose, s.object_poses) for c, s in zip(self._scenes, self._starts, strict=True)]
        physics = np.array(world.physics)
        physics[:, 1 : 1 + len(qpos[0])] = np.stack(qpos)
        return world._replace(physics=jax.device_put(jnp.asarray(physics), world.physics.sharding))

    def _judged(self) -> Outcome:
        return self.task.judge(self._context, self._sensed.true_observation(self._world))

    def _infos(self, step: Judged) -> dict[str, Any]:
        info = info_of(step, self._world.wall_contact)
        return info | {f"_{name}": np.ones(self.num_envs, dtype=bool) for name in info}


def _chosen(xp: Any, which: np.ndarray, new: Any, old: Any) -> Any:
    return xp.where(which.reshape(-1, *(1,) * (new.ndim - 1)), new, old)


def _merged(which: np.ndarray, new: MjxWorld, old: MjxWorld) -> MjxWorld:
    """Replace the worlds ``which`` by ``new``. The device layout is kept, because another one would recompile."""
    merged: MjxWorld = jax.tree.map(lambda a, b: jax.device_put(_chosen(jnp, which, a, b), b.sharding), new, old)
    return merged


class PushVectorEnv(ShmooVectorEnv):
    """Batched ``ShmooPush-v0``; its config is a `PushEnvConfig`."""

    kind, steps = PushEnvTask, EPISODE_STEPS["ShmooPush-v0"]


class NavigateVectorEnv(ShmooVectorEnv):
    """Batched ``ShmooNavigate-v0``; its config is a `NavigateConfig`."""

    kind, steps = NavigateTask, EPISODE_STEPS["ShmooNavigate-v0"]
