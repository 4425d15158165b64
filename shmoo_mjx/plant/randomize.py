"""Domain randomisation for MJX (spec 1.7): ``(model, keys) -> (model, in_axes)``, ready for vmap.

Sizes stay as they are; what is drawn needs no new compilation. MuJoCo's derived ``body_invweight0`` and
``dof_invweight0`` keep their nominal values, so the softness of constraints shifts by as much as the masses do (a few
per cent).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from shmoo_mjx.plant.scene import Scene

__all__ = ["Ranges", "randomize"]

Array = Any


@dataclass(frozen=True)
class Ranges:
    """Half widths of uniform draws: relative unless a unit is given."""

    body_mass: float = 0.15
    """Mass and inertia of the torso."""
    body_com: float = 0.015
    """Shift of the torso's CoM along each axis [m]."""
    drive_friction: float = 0.4
    """Coulomb and viscous friction between body and ball."""
    arm_mass: float = 0.15
    torque_gain: float = 0.1
    """Torque of each motor over what is asked of it."""
    object_mass: float = 0.2
    """Mass and inertia of every object's bodies."""
    object_friction: float = 0.2
    """Coulomb and rolling coefficients of what stands on the floor."""
    hand_friction: float = 0.3


def randomize(model: Any, keys: Array, scene: Scene, ranges: Ranges | None = None) -> tuple[Any, Any]:
    """Draw one model per key.

    Args:
        model: ``mjx.Model`` of ``scene``, not batched.
        keys: ``[W]`` PRNG keys.
        scene: names of bodies, joints and geoms.
        ranges: what to vary.

    Returns:
        The model whose randomised arrays have a leading axis W, and the ``in_axes`` tree for vmap.
    """
    chosen = ranges or Ranges()
    drawn = jax.vmap(lambda key: _draw(model, key, scene, chosen))(keys)
    in_axes = jax.tree.map(lambda _: None, model)
    return model.tree_replace(drawn), in_axes.tree_replace(dict.fromkeys(drawn, 0))


def _draw(model: Any, key: Array, scene: Scene, ranges: Ranges) -> dict[str, Array]:
    names = scene.model
    torso, ball = names.body("robot/torso").id, names.joint("robot/ball")
    bodies = [names.body(i).name for i in range(names.nbody)]
    arms = _having(bodies, "robot/", "_arm", "forearm", "_hand")
    objects = _having(bodies, "object", "")
    geoms = [names.geom(i).name for i in range(names.ngeom)]
    hands, floor_side = _having(geoms, "robot/", "_hand"), _having(geoms, "object", "sole", "wheel")
    keys = iter(jax.random.split(key, 8))

    def factor(width: float, shape: tuple[int, ...] = ()) -> Array:
        return jax.random.uniform(next(keys), shape, minval=1 - width, maxval=1 + width)

    # One factor for everything of a kind, except for motors, which differ from each other.
    scale = jnp.ones(names.nbody).at[torso].set(factor(ranges.body_mass))
    scale = scale.at[arms].set(factor(ranges.arm_mass)).at[objects].set(factor(ranges.object_mass))
    dofs = np.arange(ball.dofadr[0], ball.dofadr[0] + 3)
    drive = factor(ranges.drive_friction)
    shift = jax.random.uniform(next(keys), (3,), minval=-ranges.body_com, maxval=ranges.body_com)
    friction = model.geom_friction.at[hands].multiply(factor(ranges.hand_friction))
    return {
        "body_mass": model.body_mass * scale,
        "body_inertia": model.body_inertia * scale[:, None],
        "body_ipos": model.body_ipos.at[torso].add(shift),
        "dof_frictionloss": model.dof_frictionloss.at[dofs].multiply(drive),
        "dof_damping": model.dof_damping.at[dofs].multiply(drive),
        "actuator_gear": model.actuator_gear * factor(ranges.torque_gain, (names.nu,))[:, None],
        "geom_friction": friction.at[floor_side].multiply(factor(ranges.object_friction)),
    }


def _having(names: list[str], prefix: str, *parts: str) -> np.ndarray:
    """Indices of the names that start with ``prefix`` and hold one of ``parts``."""
    found = [i for i, n in enumerate(names) if n.startswith(prefix) and any(p in n for p in parts)]
    return np.array(found, dtype=int)
