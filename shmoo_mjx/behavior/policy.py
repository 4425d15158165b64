"""Interface for custom navigation policies, with the same observations and commands as the navigator."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Protocol

import numpy as np

from shmoo_mjx.arrays import Array, Float, Numbers
from shmoo_mjx.base import custom
from shmoo_mjx.behavior.navigator import Navigator
from shmoo_mjx.behavior.skills.push import Pusher
from shmoo_mjx.behavior.state import Mode, NavigatorConfig, Transition
from shmoo_mjx.errors import ShmooError
from shmoo_mjx.planning.maps import OccupancyGrid
from shmoo_mjx.types import Command, Observation


class Policy(Protocol):
    """A navigation policy."""

    finished: bool
    """Whether the policy has finished. A run succeeds if the robot is then at the goal."""

    def tick(self, obs: Observation) -> Command:
        """The command for the next 0.1 s, given the observation. Both are batches of one world."""


PolicyMaker = Callable[
    [OccupancyGrid, Float[np.ndarray, "2"], Sequence[tuple[float, float]], Pusher, NavigatorConfig], Policy
]
"""Makes a policy. Takes the map, the goal in {W} [m], half extents of each object [m], a
:class:`~shmoo_mjx.control.pushing.PushController` that the policy may use, and settings that include the latency."""


class PolicyNavigator(Navigator):
    """A navigator that runs a custom policy. It tracks object poses; the policy estimates everything else.

    Args:
        name: name of the policy, for error messages.
        maker: makes the policy.
        grid: the map.
        goal: goal position in {W} [m].
        sizes: half extents of each object [m].
        controller: passed to the policy.
        seed: seed of the run.
        config: passed to the policy.
    """

    def __init__(
        self,
        name: str,
        maker: PolicyMaker,
        grid: OccupancyGrid,
        goal: Numbers | Float[Array, "2"],
        *,
        sizes: Sequence[tuple[float, float]],
        controller: Pusher,
        seed: int = 0,
        config: NavigatorConfig | None = None,
    ) -> None:
        super().__init__(grid, goal, sizes, controller, seed=seed, config=config)
        self._name = name
        self._make = lambda: maker(grid, self.state.goal, self.setup.sizes, controller, self.setup.config)
        self._policy = custom.call("policy", self._name, self._make)

    def tick(self, obs: Observation) -> Command:
        """Runs the policy for one step."""
        now = float(obs.time[0])
        belief, _ = self.state.belief.update(obs, self.setup.sizes)
        self.state = replace(self.state, belief=belief)
        command = custom.call("policy", self._name, lambda: self._policy.tick(obs))
        if not isinstance(command, Command) or np.shape(command.u) != (1, 3):
            raise ShmooError(f"policy {self._name}: tick must give a Command whose u is [1, 3]; it gave {command!r}.")
        if not all(np.isfinite(np.asarray(value, dtype=float)).all() for value in command):
            raise ShmooError(f"policy {self._name}: its command at {now:.1f} s is not finite: {command!r}.")
        if self._policy.finished:
            self._go(now, Mode.DONE, "the policy has finished")
        elif self.mode is not Mode.FOLLOW:
            self._go(now, Mode.FOLLOW, f"{self._name} drives")
        return command

    def head_for(self, goal: Numbers | Float[Array, "2"], now: float) -> None:
        """Restarts the policy with another goal in {W} [m]."""
        super().head_for(goal, now)
        self._policy = custom.call("policy", self._name, self._make)

    def _go(self, now: float, target: Mode, reason: str) -> None:
        self.events.append(Transition(now, self.mode, target, reason))
        self.state = replace(self.state, mode=target, since=now)
