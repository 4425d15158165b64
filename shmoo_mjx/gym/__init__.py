"""Gymnasium environments ``ShmooPush-v0`` and ``ShmooNavigate-v0``: single worlds in C MuJoCo, or batches in MJX.

    gymnasium.make("shmoo_mjx.gym:ShmooPush-v0")
    gymnasium.make_vec("shmoo_mjx.gym:ShmooPush-v0", num_envs=64)

Importing this package registers the environments. docs/gym.md lists all observations and actions. The package needs the
extra ``gym``.
"""

from __future__ import annotations

from shmoo_mjx.errors import ShmooError

try:
    import gymnasium
except ModuleNotFoundError:
    raise ShmooError(
        "shmoo_mjx.gym needs the package gymnasium, which is not installed; in a clone, pip install '.[gym]'."
    ) from None

__all__ = ["EPISODE_STEPS"]

EPISODE_STEPS = {"ShmooPush-v0": 400, "ShmooNavigate-v0": 1800}
"""Number of steps of 0.1 s after which an episode is truncated, by environment: 40 s and 180 s."""

for _name, _steps in EPISODE_STEPS.items():
    _kind = _name.removeprefix("Shmoo").removesuffix("-v0")
    gymnasium.register(
        _name,
        entry_point=f"shmoo_mjx.gym.single:{_kind}Env",
        vector_entry_point=f"shmoo_mjx.gym.batch:{_kind}VectorEnv",
        max_episode_steps=_steps,
    )
