"""Random conditions c of the three object families, and the MJCF of an object.

Family and seed determine a condition. The functions in ``_DRAW`` define all distributions and ranges; docs/plant.md
gives their sources.
"""

from __future__ import annotations

import dataclasses
import operator
from collections.abc import Mapping
from typing import Any, SupportsIndex

import mujoco
import numpy as np

from shmoo_mjx.base.assets import asset
from shmoo_mjx.base.schema import check_angle
from shmoo_mjx.errors import ShmooError
from shmoo_mjx.plant.condition import Condition, is_custom
from shmoo_mjx.plant.object_file import custom_condition, custom_spec

FAMILIES = ("box", "cart", "wheelchair")
_CASTER_RADIUS = {"cart": 0.05, "wheelchair": 0.08}
_REAR_RADIUS = 0.28
_REAR_AXLE = -0.12
"""x of the wheelchair's rear axle in {O} [m]. The wheels then end at the footprint's rear edge."""
_LOCKED_TORQUE = 200.0
"""Roll friction of a locked wheel [N m]. No floor contact can overcome it, so the wheel slides."""


def _draw_box(rng: np.random.Generator) -> dict[str, Any]:
    mass = float(np.exp(rng.uniform(np.log(2.0), np.log(40.0))))
    loaded = rng.random() < 0.5
    size = (rng.uniform(0.45, 0.70), rng.uniform(0.45, 0.80), rng.uniform(0.55, 0.75))
    return {
        "size": size,
        "mass": mass * (0.6 if loaded else 1.0),
        "payload": mass * 0.4 if loaded else 0.0,
        "payload_x": rng.uniform(-0.3, 0.3) * size[0],
        "payload_y": rng.uniform(-0.3, 0.3) * size[1],
        "friction": rng.uniform(0.25, 0.65),
    }


def _draw_wheeled(
    rng: np.random.Generator, size: tuple[float, float, float], *, mass: float, load: float, load_x: tuple[float, float]
) -> dict[str, Any]:
    # Rolling resistance varies more between objects than between the wheels of one object.
    sigma = np.exp(rng.uniform(np.log(0.008), np.log(0.05))) * rng.uniform(0.8, 1.25, 4)
    locked = [False] * 4
    brakes = rng.choice([0, 1, 2], p=[0.6, 0.2, 0.2])
    pair = [(0, 1), (0, 2), (1, 3)][rng.integers(3)]
    for wheel in pair[:brakes]:
        locked[wheel] = True
    return {
        "size": size,
        "mass": mass,
        "payload": load,
        "payload_x": rng.uniform(*load_x),
        "payload_y": rng.uniform(-0.08, 0.08),
        "friction": rng.uniform(0.5, 1.0),
        "rolling": tuple(float(s) for s in sigma),
        "swivel_friction": float(np.exp(rng.uniform(np.log(0.02), np.log(0.3)))),
        "locked": tuple(locked),
    }


def _draw_cart(rng: np.random.Generator) -> dict[str, Any]:
    size = (rng.uniform(0.60, 0.90), rng.uniform(0.45, 0.65), rng.uniform(0.55, 0.70))
    values = _draw_wheeled(rng, size, mass=rng.uniform(8.0, 25.0), load=rng.uniform(0.0, 35.0), load_x=(-0.10, 0.10))
    return values | {"caster_angle": tuple(float(a) for a in rng.uniform(-np.pi, np.pi, 4))}


def _draw_wheelchair(rng: np.random.Generator) -> dict[str, Any]:
    size = (0.80, rng.uniform(0.54, 0.60), 0.52)
    # The load is ahead of the rear axle; otherwise the chair would tip.
    values = _draw_wheeled(rng, size, mass=rng.uniform(8.0, 15.0), load=rng.uniform(0.0, 70.0), load_x=(0.0, 0.10))
    locked = values["locked"]
    brakes = sum(locked)  # a wheelchair has brakes on its rear wheels only
    left_first = rng.random() < 0.5
    rear = {0: (False, False), 1: (left_first, not left_first), 2: (True, True)}[brakes]
    return values | {
        "locked": (*rear, False, False),
        "caster_angle": tuple(float(a) for a in rng.uniform(-np.pi, np.pi, 2)),
    }


_DRAW = {"box": _draw_box, "cart": _draw_cart, "wheelchair": _draw_wheelchair}


def draw_condition(family: str, seed: SupportsIndex, properties: Mapping[str, Any] | None = None) -> Condition:
    """Draw the condition of an object from its family and a seed.

    Args:
        family: one of FAMILIES, or the path of an object file (``*.json``) from plant/mesh.py.
        seed: seed of all properties; for a custom object it draws only the casters' initial angles.
        properties: values that replace drawn ones, by field name of :class:`Condition`.

    Returns:
        The condition.

    Raises:
        ShmooError: the family or a property is unknown, or a value is out of range.
    """
    seed = operator.index(seed)
    if is_custom(family):
        values = custom_condition(family, seed)
    elif family in _DRAW:
        # With the family's index in the seed, (box, 3) and (cart, 3) draw different random numbers.
        rng = np.random.default_rng([FAMILIES.index(family), seed])
        values = {"family": family, "seed": seed} | _plain(_DRAW[family](rng))
    else:
        names = ", ".join(FAMILIES)
        raise ShmooError(f"object family {family!r} is unknown: choose one of {names} or an object file (*.json).")
    drawn = Condition(**values)
    fields = [f.name for f in dataclasses.fields(Condition) if f.name not in ("family", "seed")]
    for name, value in (properties or {}).items():
        if name not in fields:
            raise ShmooError(f"property {name!r} of the {family} is unknown: use one of {', '.join(fields)}.")
        values[name] = tuple(value) if isinstance(value, list | tuple) else value
    condition = Condition(**values)
    _check(condition, drawn)
    return condition


def _plain(values: Mapping[str, Any]) -> dict[str, Any]:
    # Rounding makes the hash and the printed condition independent of the last bits of exp and log.
    def one(v: Any) -> Any:
        return v if isinstance(v, bool) else round(float(v), 6)

    return {k: tuple(one(x) for x in v) if isinstance(v, tuple) else one(v) for k, v in values.items()}


def _check(c: Condition, drawn: Condition) -> None:
    what = f"{c.family} (seed {c.seed})"
    for name in ("size", "rolling", "locked", "caster_angle"):
        value, length = getattr(c, name), len(getattr(drawn, name))
        if not length and value:
            raise ShmooError(
                f"{what}: it has no {'casters' if name == 'caster_angle' else 'wheels'}; leave out {name}."
            )
        if not isinstance(value, tuple) or len(value) != length:
            raise ShmooError(f"{what}: {name} must be a list of {length} entries.")
    if is_custom(c.family) and c.size != drawn.size:
        raise ShmooError(f"{what}: size is that of its mesh; make the object again with another --scale.")
    if not is_custom(c.family) and (any(isinstance(s, bool) for s in c.size) or min(c.size) < 0.2 or max(c.size) > 2.5):
        raise ShmooError(f"{what}: size {c.size} must be three lengths between 0.2 and 2.5 m.")
    for name, low, high in (("mass", 0.5, 500.0), ("payload", 0.0, 500.0), ("friction", 0.05, 2.0)):
        value = getattr(c, name)
        if isinstance(value, bool | tuple) or not (np.isfinite(value) and low <= value <= high):
            raise ShmooError(f"{what}: {name} {value} must be a number between {low} and {high}.")
    for name, values, low, high in (
        ("rolling", c.rolling, 0.0, 0.5),
        ("swivel_friction", (c.swivel_friction,), 0.0, 5.0),
        ("payload_x", (c.payload_x,), -c.size[0] / 2, c.size[0] / 2),
        ("payload_y", (c.payload_y,), -c.size[1] / 2, c.size[1] / 2),
    ):
        for value in values:
            if isinstance(value, bool | tuple) or not (np.isfinite(value) and low <= value <= high):
                raise ShmooError(f"{what}: {name} {value} must lie between {low:.3g} and {high:.3g}.")
    for angle in c.caster_angle:
        try:
            check_angle(angle)
        except ValueError as error:
            raise ShmooError(f"{what}: caster_angle {error}") from None
    if not all(isinstance(on, bool | np.bool_) for on in c.locked):
        raise ShmooError(f"{what}: locked {list(c.locked)} must be true or false for each wheel.")


def object_spec(condition: Condition) -> mujoco.MjSpec:
    """MJCF of the object: the family's XML with the values of this condition.

    Its root body is named ``object`` and its frame is {O}.
    """
    if is_custom(condition.family):
        return custom_spec(condition)
    spec = mujoco.MjSpec.from_file(str(asset(f"models_xml/objects/{condition.family}.xml")))
    length, width, height = condition.size
    hull = spec.geom("hull")
    bottom = {"box": 0.01, "cart": 0.15, "wheelchair": 0.22}[condition.family]
    half_height = (height - bottom) / 2 if condition.family != "wheelchair" else 0.25
    hull.size, hull.pos = [length / 2, width / 2, half_height], [0, 0, bottom + half_height]
    hull.mass = condition.mass
    payload = spec.geom("payload")
    # MuJoCo rejects massless bodies but accepts massless geoms. So an empty payload stays, and is only made invisible.
    payload.mass = condition.payload
    payload.pos = [condition.payload_x, condition.payload_y, hull.pos[2]]
    if condition.payload == 0:
        payload.rgba = [0, 0, 0, 0]
    if condition.family == "box":
        sole = spec.geom("sole")
        sole.size, sole.friction = [length / 2 - 0.01, width / 2 - 0.01, 0.005], [condition.friction, 0.005, 0.0001]
    else:
        _set_wheels(spec, condition)
    return spec


def _set_wheels(spec: mujoco.MjSpec, c: Condition) -> None:
    corners = {"cart": [(1, 1), (1, -1), (-1, 1), (-1, -1)], "wheelchair": [(0, 0), (0, 0), (1, 1), (1, -1)]}[c.family]
    casters = range(4) if c.family == "cart" else range(2, 4)
    for wheel in range(4):
        radius = _CASTER_RADIUS[c.family] if wheel in casters else _REAR_RADIUS
        # With condim 6, MuJoCo's rolling coefficient is a length: C_rr times the wheel's radius.
        spec.geom(f"wheel{wheel}").friction = [c.friction, 0.002, c.rolling[wheel] * radius]
        if c.locked[wheel]:
            spec.joint(f"wheel{wheel}_roll").frictionloss = _LOCKED_TORQUE
            spec.geom(f"wheel{wheel}").rgba = [0.8, 0.1, 0.1, spec.geom(f"wheel{wheel}").rgba[3]]
        if wheel in casters:
            fork, joint = spec.body(f"wheel{wheel}_fork"), spec.joint(f"wheel{wheel}_swivel")
            inset = 0.06
            fork.pos = [
                corners[wheel][0] * (c.size[0] / 2 - inset),
                corners[wheel][1] * (c.size[1] / 2 - inset),
                fork.pos[2],
            ]
            joint.frictionloss = c.swivel_friction
            joint.ref = 0.0
            angle = c.caster_angle[wheel if c.family == "cart" else wheel - 2]
            fork.quat = [np.cos(angle / 2), 0, 0, np.sin(angle / 2)]
        else:
            side = 1 if wheel == 0 else -1
            spec.body(f"wheel{wheel}").pos = [_REAR_AXLE, side * (c.size[1] / 2 - 0.02), _REAR_RADIUS]
