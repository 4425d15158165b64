"""The dynamics model: network inputs (features), the networks R and psi, and the transition built from them."""

from shmoo_mjx.dynamics.core import CoreConfig, Params, contact_wrench, init, rollout, step
from shmoo_mjx.dynamics.object_model import ObjectConfig, ObjectParams
from shmoo_mjx.dynamics.robot_model import LeanResponse, RobotConfig, RobotParams

__all__ = [
    "CoreConfig",
    "LeanResponse",
    "ObjectConfig",
    "ObjectParams",
    "Params",
    "RobotConfig",
    "RobotParams",
    "contact_wrench",
    "init",
    "rollout",
    "step",
]
