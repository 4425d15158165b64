"""Methods: named presets of the weights and settings that a robot runs with.

``ours`` is the method that the package ships. ``frozen`` is the same without learning about the object. ``paper`` is
the paper's system: psi as printed, Eq. 8, Eq. 9, the first-goal grid and K (docs/paper_system.md lists the additions
that it needs to run). Commands, experiments and replays take their weights and settings from here.
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
    """Weights and settings of a robot."""

    name: str
    """Name of the method."""
    weights: str
    """Asset name of the trained weights."""
    pushing: PushConfig
    """Settings of the pushing controller during navigation."""
    pose_pushing: PushConfig
    """Settings of the pushing controller for pushing to a pose (`PushTask`)."""
    navigator: NavigatorConfig
    """Settings of the navigator."""

    def load(self, path: Path | None = None) -> Weights:
        """Loads the weights in ``path``, by default the method's own.

        Raises:
            ShmooError: the file can't be read, or the method is "paper" and its psi contains the contact model.
        """
        loaded = load_weights(path or asset(self.weights))
        if self.name == PAPER and loaded.config.object.contact_model:
            raise ShmooError(
                f"{path}: the method 'paper' needs a psi as the paper prints it; train one with "
                "shmoo train object DATA --form paper."
            )
        return loaded

    def controller(self, path: Path | None = None, to_pose: bool = False) -> PushController:
        """Makes the pushing controller with the weights in ``path``, by default the method's own.

        Args:
            path: weights file.
            to_pose: for pushing an object to a pose instead of navigation.
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
        ShmooError: there is no such method.
    """
    if name not in METHODS:
        raise ShmooError(f"there is no method {name!r}; choose from {', '.join(METHODS)}.")
    return METHODS[name]
