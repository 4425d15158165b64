"""Four-point Coulomb contact model of an object: its acceleration under a push at the height of the hands.

Dry friction decides within a sample whether an object holds, slides or stops, and that border moves with mass and
friction. Here it is sharp: each point holds or slips by Coulomb's law, solved implicitly over the whole sample.
Friction that sets in gradually with speed would let an object creep that is pushed below its break-away force, and
whoever fits such a model to data makes up for it with a hundredfold mass.

A push at the height of the hands loads the far points and relieves the near ones, which turns the object. Each point
has friction of its own along x and along y of {O}: a wheel rolls along x and grips along y, a locked wheel grips along
both, a free caster along neither.
"""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from shmoo_mjx.arrays import Array, Float
from shmoo_mjx.dynamics import features
from shmoo_mjx.geometry import se2
from shmoo_mjx.geometry.hands import HAND_HEIGHT
from shmoo_mjx.types import DT

POINTS = {"front_left": (1.0, 1.0), "front_right": (1.0, -1.0), "rear_left": (-1.0, 1.0), "rear_right": (-1.0, -1.0)}
"""The four points, and where each lies along x and y of {O} from the middle of them, in half distances."""

GUESS: dict[str, float] = {
    "log_mass": 3.0,
    "log_gyration": -0.7,
    "centre_x": 0.0,
    "centre_y": 0.0,
    "log_foot_x": -0.5,
    "log_foot_y": -0.5,
    "feet_x": 0.0,
    "feet_y": 0.0,
    **{f"log_friction_{axis}_{point}": -2.0 for axis in "xy" for point in POINTS},
}
"""Parameters of the model, each with a value for what nothing is known of.

Mass [log kg]; friction coefficient of each point along x and y of {O} [log]; all else over half the diagonal of the
footprint: radius of gyration [log], centre of mass, half distances of the points [log], and the point in the middle of
them. Wheels that turn with the object's motion count as mass by their rotary inertia."""

PARAMETERS = tuple(GUESS)
"""Names of the parameters, in order."""

GRAVITY = 9.81
GAUSS_SEIDEL_ITERATIONS = 5
"""Projected Gauss-Seidel iterations over the four points: what one holds changes what the others have to hold."""


def guess() -> Float[Array, "16"]:
    """GUESS as an array."""
    return jnp.array(list(GUESS.values()))


def with_friction(parameters: Float[Array, "*many 16"], shift: float) -> Float[Array, "*many 16"]:
    """The parameters with ``shift`` added to the logarithms of its friction."""
    return parameters + shift * np.array([name.startswith("log_friction") for name in PARAMETERS], np.float32)


def resistance(parameters: Float[Array, "... 16"]) -> Float[Array, "... 2"]:
    """Friction against straight motion along x and y of {O} [N]: each point's share of the weight times its friction.

    A slow push tells this product of mass and friction, and neither of the two.
    """
    xp = se2.array_module(parameters)
    named = {name: parameters[..., i] for i, name in enumerate(PARAMETERS)}
    weight = GRAVITY * xp.exp(named["log_mass"])
    load_x, load_y = (
        xp.clip((named[f"centre_{axis}"] - named[f"feet_{axis}"]) / xp.exp(named[f"log_foot_{axis}"]), -0.98, 0.98)
        for axis in "xy"
    )
    return xp.stack(
        [
            sum(
                weight / 4 * (1 + front * load_x) * (1 + left * load_y) * xp.exp(named[f"log_friction_{axis}_{point}"])
                for point, (front, left) in POINTS.items()
            )
            for axis in "xy"
        ],
        axis=-1,
    )


def acceleration(
    parameters: Float[Array, "16 ..."], inputs: Float[Array, "n ..."], shifts: tuple[float, ...] | None = None
) -> Float[Array, "3 ..."] | Float[Array, "K 3 ..."]:
    """Mean acceleration in {O} over a sample under the inputs' wrench, channels first.

    Args:
        parameters: as PARAMETERS lists them; of one object, or of as many as there are inputs.
        inputs: as OBJECT_INPUTS lists them; the last wrench may be left out.
        shifts: added to the logarithms of the friction, for one answer each ``[K, 3, ...]``.
    """
    where = features.slices(features.OBJECT_INPUTS)
    vx, vy, spin = inputs[where["object_twist"]]
    fx, fy, torque = inputs[where["wrench"]]
    size = inputs[where["size"]][0]
    named = dict(zip(PARAMETERS, parameters, strict=True))
    mass, gyration = jnp.exp(named["log_mass"]), jnp.exp(named["log_gyration"]) * size
    inverse_mass, inverse_inertia = 1.0 / mass, 1.0 / (mass * gyration**2)
    x, y = named["centre_x"] * size, named["centre_y"] * size
    half_x, half_y = jnp.exp(named["log_foot_x"]) * size, jnp.exp(named["log_foot_y"]) * size
    # From the centre of mass to the middle of the points.
    mid_x, mid_y = named["feet_x"] * size - x, named["feet_y"] * size - y
    # Where the floor's reaction acts, in half distances of the points: weight, and the push's tipping moment.
    tip = HAND_HEIGHT / (mass * GRAVITY)
    load_x = jnp.clip((tip * fx - mid_x) / half_x, -0.98, 0.98)
    load_y = jnp.clip((tip * fy - mid_y) / half_y, -0.98, 0.98)
    shifted = jnp.zeros(()) if shifts is None else jnp.array(shifts).reshape(-1, *(1,) * vx.ndim)
    points = []
    for name, (front, left) in POINTS.items():
        lx, ly = mid_x + front * half_x, mid_y + left * half_y
        weight = DT * mass * GRAVITY / 4 * (1 + front * load_x) * (1 + left * load_y)
        friction_x, friction_y = (jnp.exp(named[f"log_friction_{axis}_{name}"] + shifted) for axis in "xy")
        stiffness = 1.0 / (inverse_mass + (lx**2 + ly**2) * inverse_inertia)
        points.append((lx, ly, inverse_inertia * lx, inverse_inertia * ly, stiffness, weight, (friction_x, friction_y)))
    # Twist of the centre of mass after the push alone; then the points take from it what they hold.
    pushed = (
        vx - spin * y + DT * inverse_mass * fx,
        vy + spin * x + DT * inverse_mass * fy,
        spin + DT * inverse_inertia * (torque - x * fy + y * fx),
    )

    def iterate(carry: tuple[Any, Any], _: None) -> tuple[tuple[Any, Any], None]:
        """Point by point: the impulse that would stop it, cut to what its load allows."""
        (ux, uy, turn), impulses = carry
        held = []
        for (lx, ly, turn_x, turn_y, stiffness, weight, friction), (old_x, old_y) in zip(points, impulses, strict=True):
            new_x, new_y = old_x - stiffness * (ux - turn * ly), old_y - stiffness * (uy + turn * lx)
            new_x, new_y = _within_grip(new_x, new_y, weight, friction)
            dx, dy = new_x - old_x, new_y - old_y
            ux, uy = ux + inverse_mass * dx, uy + inverse_mass * dy
            turn = turn + turn_x * dy - turn_y * dx
            held.append((new_x, new_y))
        return ((ux, uy, turn), tuple(held)), None

    twist = tuple(jnp.broadcast_arrays(*pushed, shifted)[:3])
    none = jnp.zeros_like(twist[0])
    start = (twist, ((none, none),) * len(POINTS))
    ((ux, uy, turn), _), _ = jax.lax.scan(iterate, start, length=GAUSS_SEIDEL_ITERATIONS)
    return jnp.stack([ux + turn * y - vx, uy - turn * x - vy, turn - spin], axis=int(shifts is not None)) / DT


def _within_grip(x: Array, y: Array, weight: Array, frictions: tuple[Array, Array]) -> tuple[Array, Array]:
    """The impulse nearest to ``(x, y)`` that a point can hold: within Coulomb's circle, whose radius is the larger of
    both grips (``weight`` times friction), and within each grip along its axis. A wheel's rolling resistance thus takes
    nothing from its grip across."""
    friction_x, friction_y = frictions
    friction = jnp.maximum(friction_x, friction_y)
    share = jnp.minimum(1.0, weight * friction * jax.lax.rsqrt(jnp.maximum(x**2 + y**2, 1e-12)))

    def along(own: Array, most: Array, across: Array) -> Array:
        # What the circle leaves to this axis where the other one's grip is used up; zero if this one's is the smaller.
        # Not quite, as a root has no derivative at zero. It depends on no state, which keeps roots out of roll-outs.
        rest = jnp.sqrt(jnp.maximum(friction**2 - across**2, 1e-12))
        limit = jnp.minimum(jnp.maximum(jnp.abs(own) * share, weight * rest), weight * most)
        return jnp.clip(own, -limit, limit)

    return along(x, friction_x, friction_y), along(y, friction_y, friction_x)
