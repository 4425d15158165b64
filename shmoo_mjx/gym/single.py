"""One world in C MuJoCo as a ``gymnasium.Env``."""

from __future__ import annotations

import threading
import time
from typing import Any, ClassVar, NamedTuple

import gymnasium
import numpy as np

from shmoo_mjx.base.processes import check_forked
from shmoo_mjx.errors import ShmooError
from shmoo_mjx.gym.navigate import NavigateTask
from shmoo_mjx.gym.push import PushEnvTask
from shmoo_mjx.gym.task import Judged, Outcome, Part, Start, Task, begun, info_of, judged, seed_of
from shmoo_mjx.plant.render import can_render, frames, has_display
from shmoo_mjx.sensing import SensedEngine, SensedWorld, senses_named
from shmoo_mjx.types import DT, Observation


def space(parts: tuple[Part, ...]) -> gymnasium.spaces.Box:
    """Gymnasium box space of the concatenated ``parts``."""
    low, high = (np.concatenate([np.full(p.size, getattr(p, end)) for p in parts]) for end in ("low", "high"))
    return gymnasium.spaces.Box(low.astype(np.float32), high.astype(np.float32), dtype=np.float32)


def checked(actions: np.ndarray, box: gymnasium.Space[np.ndarray]) -> np.ndarray:
    """Check actions and clip them to the action space.

    Raises:
        ShmooError: the shape is wrong, or a value is not finite.
    """
    assert isinstance(box, gymnasium.spaces.Box)
    numbers = np.asarray(actions, dtype=float)
    if numbers.shape != box.shape or not np.isfinite(numbers).all():
        raise ShmooError(f"the action must be {box.shape} finite numbers, not {actions!r}.")
    return np.clip(numbers, box.low, box.high)


class _Episode(NamedTuple):
    """The current episode."""

    start: Start
    context: Any
    engine: SensedEngine
    world: SensedWorld
    observed: Observation
    outcome: Outcome
    """Outcome of the last finite state; ``world`` and ``observed`` also belong to that state."""


class ShmooEnv(gymnasium.Env[np.ndarray, np.ndarray]):
    """Environment with a task in one world.

    Every reset draws a new world, and with "real" sensing a new robot. The reward of a step is the increase of the
    task's potential plus the task's rewards for success, a fall and wall contact. An episode ends with success, with a
    fall, or if the physics diverges; ``info`` contains the reason. A copy (``copy.deepcopy``, ``pickle``) continues
    from the state of the original.

    Args:
        config: configuration of the task.
        render_mode: "human", "rgb_array" or None.
        senses: sensing, "real" or "perfect".
    """

    # As Gymnasium declares it.
    metadata: dict[str, Any] = {"render_modes": ["human", "rgb_array"], "render_fps": round(1 / DT)}  # noqa: RUF012

    kind: ClassVar[type[PushEnvTask] | type[NavigateTask]]

    def __init__(self, config: Any = None, render_mode: str | None = None, senses: str = "real") -> None:
        if render_mode not in (None, *self.metadata["render_modes"]):
            raise ShmooError(f"render_mode {render_mode!r} is not known; use 'human', 'rgb_array' or none.")
        if render_mode == "human" and not has_display():
            raise ShmooError("render_mode 'human': no window can be opened here; use 'rgb_array', or leave it out.")
        # Check before rendering, because a GL library without a display terminates the process.
        if render_mode == "rgb_array" and (problem := can_render()):
            raise ShmooError(
                f"render_mode {render_mode!r}: MuJoCo can't draw here ({problem}); set MUJOCO_GL=egl before Python "
                "starts, or leave the mode out."
            )
        self.task: Task = self.kind(config)
        self.render_mode, self.senses = render_mode, senses_named(senses)
        self.observation_space, self.action_space = space(self.task.observation), space(self.task.action)
        self._now: _Episode | None = None
        self._window: Any = None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Draw a world and start an episode.

        Args:
            seed: seed of the world and the robot.
            options: must be empty.

        Returns:
            Observation ``[n]`` and info.
        """
        check_forked()
        super().reset(seed=seed_of(seed, options))
        self._stop()
        start = self.task.draw(self.np_random)
        robot = int(self.np_random.integers(2**31))
        scene, context = start.scene("mujoco", self.senses.adjust(robot)), self.task.gather([start])
        engine = SensedEngine([scene], self.senses, robot, poses_known=self.task.poses_known)
        world = engine.init()
        observed = engine.observe(world)
        outcome = self.task.judge(context, engine.true_observation(world))
        self._now = _Episode(start, context, engine, world, observed, outcome)
        self._show()
        return self.task.observe(context, observed)[0], _info(begun(outcome), world.wall_contact)

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Hold ``action`` for 0.1 s.

        Returns:
            Observation ``[n]``, reward, terminated, truncated and info. Truncated is always False here; Gymnasium's
                registered step limit truncates episodes.
        """
        now = self._episode()
        wanted = self.task.command(checked(action, self.action_space)[None], now.observed)
        world, observed = now.engine.step(now.world, wanted)
        fallen, diverged, touching = now.engine.fallen(world), now.engine.diverged(world), world.wall_contact
        after = now.outcome
        if not diverged[0]:
            after = self.task.judge(now.context, now.engine.true_observation(world))
            now = now._replace(world=world, observed=observed)
        step = judged(self.task, now.outcome, after, fallen=fallen, diverged=diverged, touching=touching)
        self._now = now._replace(outcome=step.outcome)
        self._show()
        vector = self.task.observe(now.context, now.observed)[0]
        return vector, float(step.reward[0]), bool(step.terminated[0]), False, _info(step, touching)

    def render(self) -> np.ndarray | None:  # type: ignore[override]
        """Image of the world, seen obliquely from above, uint8 ``[480, 640, 3]``; None unless the mode is rgb_array."""
        if self.render_mode != "rgb_array":
            return None
        now = self._episode()
        scene = now.engine.scenes[0]
        return next(iter(frames(scene, now.world.physics[:, 1 : 1 + scene.model.nq])))

    def _show(self) -> None:
        """In the mode human, show the world in MuJoCo's viewer in real time. A closed window is not opened again."""
        if self.render_mode != "human":
            return
        import mujoco
        import mujoco.viewer

        now = self._episode()
        model = now.engine.scenes[0].model
        if self._window is None:
            data = mujoco.MjData(model)
            others = threading.enumerate()
            viewer = mujoco.viewer.launch_passive(model, data, show_left_ui=False, show_right_ui=False)
            drawing = [thread for thread in threading.enumerate() if thread not in others]
            self._window = (viewer, data, time.monotonic(), drawing)
        viewer, data, last, drawing = self._window
        if viewer.is_running():
            data.qpos[:] = now.world.physics[0, 1 : 1 + model.nq]
            mujoco.mj_forward(model, data)
            viewer.sync()
            time.sleep(max(0.0, last + DT - time.monotonic()))
        self._window = (viewer, data, time.monotonic(), drawing)

    def close(self) -> None:
        """Stop the engine and close the window."""
        self._stop()

    @property
    def start(self) -> Start:
        """Start of the current episode, with object properties that the observation does not contain."""
        return self._episode().start

    def _episode(self) -> _Episode:
        if self._now is None:
            raise gymnasium.error.ResetNeeded("call reset before step or render")
        return self._now

    def __getstate__(self) -> dict[str, Any]:
        return self.__dict__ | {"_window": None}

    def _stop(self) -> None:
        if self._window is not None:
            viewer, _, _, drawing = self._window
            self._window = None
            viewer.close()
            # Wait for the viewer's threads: a process that ends before they do would crash.
            for thread in drawing:
                thread.join(timeout=5.0)
        if self._now is not None:
            self._now.engine.close()
            self._now = None


def _info(step: Judged, touching: np.ndarray) -> dict[str, Any]:
    return {name: values.tolist()[0] for name, values in info_of(step, touching).items()}


class PushEnv(ShmooEnv):
    """``ShmooPush-v0``; its config is a `PushEnvConfig`."""

    kind = PushEnvTask


class NavigateEnv(ShmooEnv):
    """``ShmooNavigate-v0``; its config is a `NavigateConfig`."""

    kind = NavigateTask
