"""Methods: the weights and settings that a robot runs with, by name.

``ours`` is what the package ships. ``frozen`` is the same, but learns nothing of an object. ``paper`` is the paper's
system as one preset: psi as printed, Eq. 8, Eq. 9, the first-goal grid and K (docs/paper_system.md lists what was added
so that it runs). Commands, experiments and replays take their weights and settings from here.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

from shmoo_mjx.base.assets import PAPER_WEIGHTS, WEIGHTS, asset
from shmoo_mjx.behavior.state import NavigatorConfig
from shmoo_mjx.control.presets import PushConfig, pose_push_config, printed_push_config
from shmoo_mjx.control.pushing import PushController
from shmoo_mjx.errors import ShmooError
from shmoo_mjx.learning.weights import Weights, load_weights

OURS, FROZEN, PAPER = "ours", "frozen", "paper"


@dataclass(frozen=True)
class Method:
    """What a robot runs with."""

    name: str
    weights: str
    """Asset of the trained weights."""
    pushing: PushConfig
    """Of the pushing controller while navigating."""
    pose_pushing: PushConfig
    """Of the pushing controller where an object is brought to a pose (`PushTask`)."""
    navigator: NavigatorConfig

    def load(self, path: Path | None = None) -> Weights:
        """The weights in ``path``, by default the method's own.

        Raises:
            ShmooError: the file can't be read, or its psi is not one that the method learns by Eq. 8.
        """
        loaded = load_weights(path or asset(self.weights))
        if self.name == PAPER and loaded.config.object.contact_model:
            raise ShmooError(
                f"{path}: the method 'paper' needs a psi as the paper prints it; train one with "
                "shmoo train object DATA --form paper."
            )
        return loaded

    def controller(self, path: Path | None = None, to_pose: bool = False) -> PushController:
        """The pushing controller with the weights in ``path``, by default the method's own.

        Args:
            path: weights file.
            to_pose: for bringing an object to a pose, rather than for navigation.
        """
        return PushController(self.load(path), self.pose_pushing if to_pose else self.pushing)


METHODS = {
    OURS: Method(OURS, WEIGHTS, PushConfig(), pose_push_config(), NavigatorConfig()),
    FROZEN: Method(
        FROZEN,
        WEIGHTS,
        PushConfig(adapts=False),
        replace(pose_push_config(), adapts=False),
        NavigatorConfig(),
    ),
    PAPER: Method(PAPER, PAPER_WEIGHTS, printed_push_config(), printed_push_config(), NavigatorConfig(decides_by="K")),
}


def method_named(name: str) -> Method:
    """The method called ``name``.

    Raises:
        ShmooError: there is none.
    """
    if name not in METHODS:
        raise ShmooError(f"there is no method {name!r}; choose from {', '.join(METHODS)}.")
    return METHODS[name]
