"""Ground-truth contact parameters of a condition's object, and the prior: the parameters of many such objects."""

from __future__ import annotations

import mujoco
import numpy as np

from shmoo_mjx.arrays import Array, Float
from shmoo_mjx.dynamics.contact_model import PARAMETERS, POINTS, loads, resistance
from shmoo_mjx.errors import ShmooError
from shmoo_mjx.geometry import se2
from shmoo_mjx.plant.condition import Condition, is_custom
from shmoo_mjx.plant.objects import FAMILIES, draw_condition, object_spec

FIRST_SEED = 50_000
"""Seed of the first condition in the prior. It lies between the seeds of training and of validation."""

COUNT = 1026
"""Number of objects in the prior: equally many of each family, half of them mirror images."""

_SCRUB = 0.0005
"""Torque with which the floor resists the turning of a caster, divided by the caster's load [m]. It is fitted to pushes
of carts, and lower than the simulator's torsional friction, which acts on a wheel that does not roll."""
_NO_SWIVEL = 1e-4
"""Swivel coefficient of a point that is no caster [1]."""


def parameters_of(condition: Condition) -> Float[np.ndarray, "p"]:
    """Contact parameters of an object from its MuJoCo model, in the order of `contact_model.PARAMETERS`.

    For a rolling wheel, the friction along its rolling direction is its rolling resistance; for a free caster this
    holds along both axes. Of more than four wheels, the four outermost are used.
    """
    model = object_spec(condition).compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    size = float(np.hypot(*condition.half_extents))
    mass = model.body_mass.sum()
    centre = model.body_mass @ data.xipos / mass
    turned = data.ximat.reshape(-1, 3, 3)
    own = np.einsum("bi,bi->b", turned[:, 2] ** 2, model.body_inertia)
    inertia = np.sum(own + model.body_mass * np.sum((data.xipos - centre)[:, :2] ** 2, axis=1))
    corners, friction, trails, rolling_mass = _points(condition, model, data)
    half = (corners.max(axis=0) - corners.min(axis=0)) / 2
    middle = (corners.max(axis=0) + corners.min(axis=0)) / 2
    values = {
        "log_mass": np.log(mass + rolling_mass),
        "log_gyration": 0.5 * np.log(inertia / mass) - np.log(size),
        "centre_x": centre[0] / size,
        "centre_y": centre[1] / size,
        "log_foot_x": np.log(half[0] / size),
        "log_foot_y": np.log(half[1] / size),
        "feet_x": middle[0] / size,
        "feet_y": middle[1] / size,
    }
    weight = loads(np.array([values.get(name, 0.0) for name in PARAMETERS]))
    for point, both, trail, load in zip(POINTS, friction, trails, weight, strict=True):
        values |= {f"log_friction_{axis}_{point}": np.log(mu) for axis, mu in zip("xy", both, strict=True)}
        swivel = (condition.swivel_friction / load + _SCRUB) / trail if trail else _NO_SWIVEL
        values[f"log_swivel_{point}"] = np.log(min(swivel, condition.friction))
    return np.array([values[name] for name in PARAMETERS])


def true_values(condition: Condition) -> dict[str, float]:
    """Ground truth of the quantities in `online.summary`, by name: mass [kg], friction along x and y of {O} [N].

    As in the contact model, the mass includes the rotary inertia of rolling wheels.
    """
    parameters = parameters_of(condition)
    friction_x, friction_y = resistance(parameters).tolist()
    mass = float(np.exp(parameters[PARAMETERS.index("log_mass")]))
    return {"mass": mass, "friction_x": friction_x, "friction_y": friction_y}


def draws(count: int = COUNT, first_seed: int = FIRST_SEED) -> Float[np.ndarray, "count p"]:
    """Contact parameters of ``count`` objects, which must be a multiple of six.

    Row i is of family FAMILIES[i % 3]. Half of the rows are mirror images of the others, so that the prior is
    symmetric.
    """
    seeds = [(FAMILIES[i % len(FAMILIES)], first_seed + i // len(FAMILIES)) for i in range(count // 2)]
    own = np.array([parameters_of(draw_condition(*seed)) for seed in seeds], np.float32)
    return np.concatenate([own, mirrored(own)])


def of_kind(prior: Float[Array, "M p"], kind: str | None) -> Float[Array, "M p"]:
    """The prior for an object of a known kind: the draws of its family, repeated to the same number of rows.

    Args:
        prior: result of `draws`.
        kind: one of FAMILIES, or None for an unknown kind, which returns ``prior``.

    Raises:
        ShmooError: ``kind`` is unknown.
    """
    if kind is None:
        return prior
    if kind not in FAMILIES:
        raise ShmooError(f"object kind {kind!r} is unknown: choose one of {', '.join(FAMILIES)}, or None.")
    own = prior[FAMILIES.index(kind) :: len(FAMILIES)]
    return se2.array_module(own).tile(own, (len(FAMILIES), 1))


def kind_of(condition: Condition) -> str | None:
    """Kind of an object by its appearance, one of FAMILIES; None for an object file with wheels."""
    if not is_custom(condition.family):
        return condition.family
    return None if condition.rolling else "box"


def mirrored(parameters: Float[np.ndarray, "... p"]) -> Float[np.ndarray, "... p"]:
    """Contact parameters of the object mirrored in its x-z plane."""
    other = {"left": "right", "right": "left"}
    names = ["_".join(other.get(word, word) for word in name.split("_")) for name in PARAMETERS]
    signs = np.array([-1.0 if name in ("centre_y", "feet_y") else 1.0 for name in PARAMETERS], np.float32)
    return signs * parameters[..., [PARAMETERS.index(name) for name in names]]


def _points(
    condition: Condition, model: mujoco.MjModel, data: mujoco.MjData
) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """Contact points of an object on the floor.

    Returns:
        Positions ``[4, 2]`` in the order of POINTS [m], friction coefficients along x and y at them ``[4, 2]``, the
        trails of the casters among them, otherwise 0 ``[4]`` [m], and the mass equivalent of the wheels' rotary inertia
        [kg].
    """
    if not condition.rolling:
        soles = [i for i in range(model.ngeom) if model.geom(i).name.endswith("sole")]
        centres, halves = data.geom_xpos[soles, :2], model.geom_aabb[soles, 3:5]
        low, high = (centres - halves).min(axis=0), (centres + halves).max(axis=0)
        corners = (low + high) / 2 + np.array(list(POINTS.values())) * (high - low) / 2
        return corners, np.full((4, 2), condition.friction), np.zeros(4), 0.0
    names = [f"wheel{k}" for k in range(len(condition.rolling))]
    places = np.array([data.geom(name).xpos[:2] for name in names])
    swivels = np.array([_has(model, f"{name}_swivel") for name in names])
    # The contact point of a caster is under its swivel on average, whatever its current direction.
    anchors = [data.joint(f"{name}_swivel").xanchor[:2] for name, on in zip(names, swivels, strict=True) if on]
    trails = np.zeros(len(names))
    if anchors:
        trails[swivels] = np.linalg.norm(places[swivels] - anchors, axis=1)
        places[swivels] = anchors
    locked, rolling = np.array(condition.locked), np.array(condition.rolling)
    along = np.where(locked, condition.friction, rolling)
    across = np.where(swivels, along, condition.friction)
    bodies = [model.geom(name).bodyid[0] for name in names]
    radii = [model.geom(name).size[0] for name in names]
    turning = sum(model.body_inertia[b].max() / r**2 for b, r in zip(bodies, radii, strict=True))
    middle = places.mean(axis=0)
    order = [int(np.argmax((places - middle) @ np.array(sign))) for sign in POINTS.values()]
    return places[order], np.stack([along, across], axis=1)[order], trails[order], float(turning)


def _has(model: mujoco.MjModel, joint: str) -> bool:
    return mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, joint) >= 0
