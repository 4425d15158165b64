"""Domain randomisation for MJX: ``(model, keys) -> (model, in_axes)``, ready for vmap.

Sizes are not randomised, so a draw needs no recompilation. MuJoCo's derived ``body_invweight0`` and ``dof_invweight0``
keep their nominal values. The softness of constraints therefore changes by as much as the masses do (a few per cent).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from shmoo_mjx.arrays import Array, Float, Key, Scalar, single_precision
from shmoo_mjx.plant.scene import Scene


@dataclass(frozen=True)
class Ranges:
    """Half widths of uniform draws, relative to nominal unless a unit is given.

    Larger values make worlds differ more.
    """

    body_mass: float = 0.15
    """Mass and inertia of the torso."""
    body_com: float = 0.015
    """Shift of the torso's CoM along each axis [m]."""
    drive_friction: float = 0.4
    """Coulomb and viscous friction between body and ball."""
    arm_mass: float = 0.15
    """Mass and inertia of the arms and hands; one factor for all."""
    torque_gain: float = 0.1
    """Torque of each motor divided by the commanded torque; one factor per motor."""
    object_mass: float = 0.2
    """Mass and inertia of all bodies of the objects; one factor for all."""
    object_friction: float = 0.2
    """Coulomb and rolling friction coefficients between the floor and the objects' soles and wheels."""
    hand_friction: float = 0.3
    """Friction coefficients of the hands."""


class Factors(NamedTuple):
    """Difference of one world's model from the nominal one: factors unless a unit is given. See :class:`Ranges`."""

    body_mass: Scalar
    arm_mass: Scalar
    object_mass: Scalar
    drive_friction: Scalar
    body_com: Float[Array, "3"]
    """Shift of the torso's CoM [m]."""
    hand_friction: Scalar
    torque_gain: Scalar | Float[Array, "nu"]
    """One factor per motor, or one for all."""
    object_friction: Scalar


@single_precision
def randomize(model: Any, keys: Key[Array, "W"], scene: Scene, ranges: Ranges | None = None) -> tuple[Any, Any]:
    """Draw one randomised model per key.

    Args:
        model: ``mjx.Model`` of ``scene``, not batched.
        keys: one key per world.
        scene: scene that gives the names of bodies, joints and geoms.
        ranges: half widths of the draws, by default ``Ranges()``.

    Returns:
        The model, whose randomised arrays have a leading axis W, and the ``in_axes`` tree for vmap.
    """
    chosen = ranges or Ranges()
    motors = int(scene.model.nu)
    drawn = jax.vmap(lambda key: perturbed(model, _draw(key, chosen, motors), scene))(keys)
    in_axes = jax.tree.map(lambda _: None, model)
    return model.tree_replace(drawn), in_axes.tree_replace(dict.fromkeys(drawn, 0))


@single_precision
def perturbed(model: Any, factors: Factors, scene: Scene) -> dict[str, Float[Array, "..."]]:
    """New values of the fields of ``mjx.Model`` that ``factors`` change, for one world."""
    names = scene.model
    torso, ball = names.body("robot/torso").id, names.joint("robot/ball")
    bodies = [names.body(i).name for i in range(names.nbody)]
    arms = _having(bodies, "robot/", "_arm", "forearm", "_hand")
    objects = _having(bodies, "object", "")
    geoms = [names.geom(i).name for i in range(names.ngeom)]
    hands, floor_side = _having(geoms, "robot/", "_hand"), _having(geoms, "object", "sole", "wheel")
    scale = jnp.ones(names.nbody).at[torso].set(factors.body_mass)
    scale = scale.at[arms].set(factors.arm_mass).at[objects].set(factors.object_mass)
    dofs = np.arange(ball.dofadr[0], ball.dofadr[0] + 3)
    friction = model.geom_friction.at[hands].multiply(factors.hand_friction)
    return {
        "body_mass": model.body_mass * scale,
        "body_inertia": model.body_inertia * scale[:, None],
        "body_ipos": model.body_ipos.at[torso].add(factors.body_com),
        "dof_frictionloss": model.dof_frictionloss.at[dofs].multiply(factors.drive_friction),
        "dof_damping": model.dof_damping.at[dofs].multiply(factors.drive_friction),
        "actuator_gear": model.actuator_gear * jnp.broadcast_to(factors.torque_gain, (names.nu,))[:, None],
        "geom_friction": friction.at[floor_side].multiply(factors.object_friction),
    }


def _draw(key: Array, ranges: Ranges, motors: int) -> Factors:
    keys = iter(jax.random.split(key, 8))

    def factor(width: float, shape: tuple[int, ...] = ()) -> Array:
        return jax.random.uniform(next(keys), shape, minval=1 - width, maxval=1 + width)

    # All parts of a kind share one factor. Only motors get individual factors.
    return Factors(
        body_mass=factor(ranges.body_mass),
        arm_mass=factor(ranges.arm_mass),
        object_mass=factor(ranges.object_mass),
        drive_friction=factor(ranges.drive_friction),
        body_com=jax.random.uniform(next(keys), (3,), minval=-ranges.body_com, maxval=ranges.body_com),
        hand_friction=factor(ranges.hand_friction),
        torque_gain=factor(ranges.torque_gain, (motors,)),
        object_friction=factor(ranges.object_friction),
    )


def _having(names: list[str], prefix: str, *parts: str) -> np.ndarray:
    """Indices of the names that start with ``prefix`` and contain one of ``parts``."""
    return np.array([i for i, n in enumerate(names) if n.startswith(prefix) and any(p in n for p in parts)], dtype=int)
