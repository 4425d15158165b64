"""Four-point Coulomb contact model of an object: its acceleration under a push at the height of the hands.

Within one sample an object can stick, slide or stop, and the stick-slip boundary depends on mass and friction. The
model keeps this boundary sharp: each point sticks or slips by Coulomb's law, solved implicitly over the whole sample.
Friction that grows smoothly with speed would let an object creep under a push below its break-away force. A fit of
such a model to data compensates with a mass that is about a hundred times too large.

A push at the height of the hands increases the load on the far points and decreases it on the near ones, which turns
the object. Each point has separate friction coefficients along x and y of {O}: a wheel rolls along x and grips along
y, a locked wheel grips along both, and a caster along neither. A caster rolls in a direction of its own, and resists
motion across it up to the force that turns its swivel. While it turns, its direction approaches that of its motion
(`turned`).
"""

from __future__ import annotations

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.custom_derivatives import SymbolicZero

from shmoo_mjx.arrays import Array, Float, Scalar
from shmoo_mjx.dynamics import features
from shmoo_mjx.geometry import se2
from shmoo_mjx.geometry.hands import HAND_HEIGHT
from shmoo_mjx.types import DT

POINTS = {"front_left": (1.0, 1.0), "front_right": (1.0, -1.0), "rear_left": (-1.0, 1.0), "rear_right": (-1.0, -1.0)}
"""The four points and their positions along x and y of {O}, relative to their midpoint, in half distances."""

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
    **{f"log_swivel_{point}": -5.0 for point in POINTS},
}
"""Parameters of the model with their default values for an unknown object.

``log_mass`` is the logarithm of the mass in kg; it includes the rotary inertia of wheels that turn with the object.
``log_friction_*`` is the logarithm of the friction coefficient of a point along x or y of {O}, ``log_swivel_*`` that of
the force that turns the caster of a point, divided by the point's load. All others are lengths divided by
half the diagonal of the footprint: ``log_gyration`` (radius of gyration), ``centre_*`` (centre of mass),
``log_foot_*`` (half distances of the points) and ``feet_*`` (midpoint of the points)."""

PARAMETERS = tuple(GUESS)
"""Names of the parameters, in order."""

GRAVITY = 9.81
GAUSS_SEIDEL_ITERATIONS = 5
"""Projected Gauss-Seidel iterations over the four points, whose impulses depend on each other. More is more accurate
and slower."""
_TRAIL = 0.045
"""Distance between a caster's swivel axis and its contact point [m], between that of the carts' (0.04) and of the
wheelchairs' casters (0.05)."""
_DIRECTED = 0.01
"""Speed of a point from which on a caster of unknown direction is taken to point along its motion [m/s]."""


def guess() -> Float[Array, "20"]:
    """The values of GUESS as an array."""
    return jnp.array(list(GUESS.values()))


def with_friction(parameters: Float[Array, "*many 20"], shift: float) -> Float[Array, "*many 20"]:
    """The parameters with ``shift`` added to every log friction coefficient."""
    return parameters + shift * np.array([name.startswith("log_friction") for name in PARAMETERS], np.float32)


def loads(parameters: Float[Array, "... 20"]) -> Float[Array, "... 4"]:
    """Loads of the points of an object that is not pushed [N], in the order of POINTS."""
    xp = se2.array_module(parameters)
    named = {name: parameters[..., i] for i, name in enumerate(PARAMETERS)}
    load_x, load_y = (
        xp.clip((named[f"centre_{axis}"] - named[f"feet_{axis}"]) / xp.exp(named[f"log_foot_{axis}"]), -0.98, 0.98)
        for axis in "xy"
    )
    even = GRAVITY * xp.exp(named["log_mass"]) / 4
    return xp.stack([even * (1 + front * load_x) * (1 + left * load_y) for front, left in POINTS.values()], axis=-1)


def resistance(parameters: Float[Array, "... 20"]) -> Float[Array, "... 2"]:
    """Friction force against straight motion along x and y of {O} [N].

    It is the sum over the points of load times friction coefficient. A slow push identifies this product of mass and
    friction, but not the two factors.
    """
    xp = se2.array_module(parameters)
    columns = [[PARAMETERS.index(f"log_friction_{axis}_{point}") for point in POINTS] for axis in "xy"]
    load = loads(parameters)
    return xp.stack([xp.sum(load * xp.exp(parameters[..., np.array(one)]), axis=-1) for one in columns], axis=-1)


def acceleration(
    parameters: Float[Array, "20 ..."],
    inputs: Float[Array, "n ..."],
    shifts: tuple[float, ...] | None = None,
    casters: Float[Array, "4 2 ..."] | None = None,
) -> Float[Array, "3 ..."] | Float[Array, "K 3 ..."]:
    """Mean acceleration of the object over one sample, in {O}, channels first.

    Args:
        parameters: in the order of PARAMETERS; of one object, or one set per input.
        inputs: in the order of OBJECT_INPUTS; the last wrench is optional.
        casters: rolling directions of the casters in {O}, unit vectors in the order of POINTS. Without them, each
            caster is taken to point in the direction in which it moves.
        shifts: K values to add to the log friction coefficients; each gives one prediction.

    Returns:
        Acceleration [m/s^2, m/s^2, rad/s^2], ``[3, ...]``, or ``[K, 3, ...]`` with ``shifts``.
    """
    return _acceleration(shifts, parameters, inputs, casters)


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def _acceleration(shifts: tuple[float, ...] | None, parameters: Array, inputs: Array, casters: Array | None) -> Array:
    return _solved(shifts, parameters, inputs, casters)


def _derivative(
    shifts: tuple[float, ...] | None, primals: tuple[Any, ...], tangents: tuple[Any, ...]
) -> tuple[Array, Array]:
    """The derivative of `acceleration`, from the seven columns of its Jacobian that can differ from zero.

    JAX alone would differentiate the solver backwards, with the same result. In a training this takes several times as
    long to run and to compile.
    """
    parameters, inputs, casters = primals
    of_parameters, of_inputs, of_casters = tangents
    value = _solved(shifts, parameters, inputs, casters)
    change = jnp.zeros_like(value)
    if not isinstance(of_inputs, SymbolicZero):
        where = features.slices(features.OBJECT_INPUTS)
        # The solver reads no other inputs.
        rows = np.r_[where["object_twist"], where["wrench"], where["size"]]

        def column(row: Array) -> Array:
            unit = jnp.zeros_like(inputs).at[row].set(1.0)
            return jax.jvp(lambda x: _solved(shifts, parameters, x, casters), (inputs,), (unit,))[1]

        columns = jax.vmap(column)(rows)
        change = change + sum(columns[k] * of_inputs[row] for k, row in enumerate(rows))
    if not isinstance(of_parameters, SymbolicZero):
        change += jax.jvp(lambda x: _solved(shifts, x, inputs, casters), (parameters,), (of_parameters,))[1]
    if not isinstance(of_casters, SymbolicZero | None):
        change += jax.jvp(lambda x: _solved(shifts, parameters, inputs, x), (casters,), (of_casters,))[1]
    return value, change


_acceleration.defjvp(_derivative, symbolic_zeros=True)


def _solved(shifts: tuple[float, ...] | None, parameters: Array, inputs: Array, casters: Array | None) -> Array:
    """`acceleration` by projected Gauss-Seidel."""
    where = features.slices(features.OBJECT_INPUTS)
    vx, vy, spin = inputs[where["object_twist"]]
    fx, fy, torque = inputs[where["wrench"]]
    size = inputs[where["size"]][0]
    named = dict(zip(PARAMETERS, parameters, strict=True))
    mass, gyration = jnp.exp(named["log_mass"]), jnp.exp(named["log_gyration"]) * size
    inverse_mass, inverse_inertia = 1.0 / mass, 1.0 / (mass * gyration**2)
    x, y = named["centre_x"] * size, named["centre_y"] * size
    half_x, half_y = jnp.exp(named["log_foot_x"]) * size, jnp.exp(named["log_foot_y"]) * size
    # Vector from the centre of mass to the midpoint of the points.
    mid_x, mid_y = named["feet_x"] * size - x, named["feet_y"] * size - y
    # Centre of pressure of the floor's reaction, in half distances of the points. The push shifts it, because it acts
    # above the floor and so makes a tipping moment.
    tip = HAND_HEIGHT / (mass * GRAVITY)
    load_x = jnp.clip((tip * fx - mid_x) / half_x, -0.98, 0.98)
    load_y = jnp.clip((tip * fy - mid_y) / half_y, -0.98, 0.98)
    shifted = jnp.zeros(()) if shifts is None else jnp.array(shifts).reshape(-1, *(1,) * vx.ndim)
    points: list[tuple[Any, ...]] = []
    for name, (front, left) in POINTS.items():
        lx, ly = mid_x + front * half_x, mid_y + left * half_y
        weight = DT * mass * GRAVITY / 4 * (1 + front * load_x) * (1 + left * load_y)
        friction_x, friction_y = (jnp.exp(named[f"log_friction_{axis}_{name}"] + shifted) for axis in "xy")
        stiffness = 1.0 / (inverse_mass + (lx**2 + ly**2) * inverse_inertia)
        if casters is None:
            ahead_x, ahead_y = vx - spin * (y + ly), vy + spin * (x + lx)
            per_speed = jax.lax.rsqrt(ahead_x**2 + ahead_y**2 + _DIRECTED**2)
            # Unit vector across the point's motion; shorter where the point is almost at rest.
            across = -ahead_y * per_speed, ahead_x * per_speed
        else:
            along_x, along_y = casters[len(points)]
            across = -along_y, along_x
        hold = weight * jnp.exp(named[f"log_swivel_{name}"])
        turns = (inverse_inertia * lx, inverse_inertia * ly)
        points.append((lx, ly, turns, stiffness, weight, (friction_x, friction_y), across, hold))
    # Twist of the centre of mass after the push alone, before the friction impulses of the points.
    pushed = (
        vx - spin * y + DT * inverse_mass * fx,
        vy + spin * x + DT * inverse_mass * fy,
        spin + DT * inverse_inertia * (torque - x * fy + y * fx),
    )

    def iterate(carry: tuple[Any, Any], _: None) -> tuple[tuple[Any, Any], None]:
        """One Gauss-Seidel sweep: each point gets the impulses that would stop it, clipped to their limits."""
        (ux, uy, turn), impulses = carry
        held = []
        for point, (old_x, old_y, old_hold) in zip(points, impulses, strict=True):
            lx, ly, (turn_x, turn_y), stiffness, weight, friction, (nx, ny), most = point
            slip_x, slip_y = ux - turn * ly, uy + turn * lx
            new_hold = jnp.clip(old_hold - stiffness * (nx * slip_x + ny * slip_y), -most, most)
            change = new_hold - old_hold
            # The floor's grip stops what the swivel has left of the slip.
            grip_x = old_x - stiffness * slip_x - nx * change
            grip_y = old_y - stiffness * slip_y - ny * change
            new_x, new_y = _within_grip(grip_x, grip_y, weight, friction)
            dx, dy = new_x - old_x + nx * change, new_y - old_y + ny * change
            ux, uy = ux + inverse_mass * dx, uy + inverse_mass * dy
            turn = turn + turn_x * dy - turn_y * dx
            held.append((new_x, new_y, new_hold))
        return ((ux, uy, turn), tuple(held)), None

    twist = tuple(jnp.broadcast_arrays(*pushed, shifted)[:3])
    none = jnp.zeros_like(twist[0])
    start = (twist, ((none, none, none),) * len(POINTS))
    ((ux, uy, turn), _), _ = jax.lax.scan(iterate, start, length=GAUSS_SEIDEL_ITERATIONS)
    return jnp.stack([ux + turn * y - vx, uy - turn * x - vy, turn - spin], axis=int(shifts is not None)) / DT


def turned(
    casters: Float[Array, "4 2 ..."], parameters: Float[Array, "20 ..."], twist: Float[Array, "3 ..."], size: Scalar
) -> Float[Array, "4 2 ..."]:
    """Rolling directions of the casters after one sample with this ``twist``, in {O}, channels first.

    A wheel on a trail does not slip sideways, so it turns towards the motion of its swivel by
    -speed / trail * sin(angle between them).

    Args:
        casters: rolling directions before, unit vectors.
        parameters: in the order of PARAMETERS.
        twist: [m/s, m/s, rad/s] in {O}.
        size: half the diagonal of the footprint [m].
    """
    named = dict(zip(PARAMETERS, parameters, strict=True))
    vx, vy, spin = twist
    after = []
    for (cos, sin), (front, left) in zip(casters, POINTS.values(), strict=True):
        x = (named["feet_x"] + front * jnp.exp(named["log_foot_x"])) * size
        y = (named["feet_y"] + left * jnp.exp(named["log_foot_y"])) * size
        ahead_x, ahead_y = vx - spin * y, vy + spin * x
        along, aside = ahead_x * cos + ahead_y * sin, ahead_x * sin - ahead_y * cos
        speed = jnp.sqrt(ahead_x**2 + ahead_y**2 + 1e-12)
        # Tangent of half the angle from the motion to the caster. It decays by exp(-distance / trail).
        half = aside / (speed + along + 1e-6)
        shrunk = half * jnp.exp(-speed * DT / _TRAIL)
        # Tangent of half the angle by which the caster turns, with that of the object itself.
        turn = (shrunk - half) / (1.0 + shrunk * half) - 0.5 * spin * DT
        c, s = (1.0 - turn**2) / (1.0 + turn**2), 2.0 * turn / (1.0 + turn**2)
        after.append(jnp.stack([c * cos - s * sin, s * cos + c * sin]))
    return jnp.stack(after)


def _within_grip(x: Array, y: Array, weight: Array, frictions: tuple[Array, Array]) -> tuple[Array, Array]:
    """Clip the friction impulse ``(x, y)`` of a point to its limits.

    The impulse stays within ``weight`` times friction along each axis, and within a Coulomb circle whose radius is the
    larger of these two limits. The rolling resistance of a wheel therefore does not reduce its lateral grip.
    """
    friction_x, friction_y = frictions
    friction = jnp.maximum(friction_x, friction_y)
    share = jnp.minimum(1.0, weight * friction * jax.lax.rsqrt(jnp.maximum(x**2 + y**2, 1e-12)))

    def along(own: Array, most: Array, across: Array) -> Array:
        # The limit that the circle leaves to this axis when the other axis is at its own limit. It is zero if this
        # axis has the smaller friction; the floor of 1e-12 keeps the derivative of the root finite there. The root
        # depends on no state, so it is not recomputed in a roll-out.
        rest = jnp.sqrt(jnp.maximum(friction**2 - across**2, 1e-12))
        limit = jnp.minimum(jnp.maximum(jnp.abs(own) * share, weight * rest), weight * most)
        return jnp.clip(own, -limit, limit)

    return along(x, friction_x, friction_y), along(y, friction_y, friction_x)
