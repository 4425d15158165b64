"""What the networks see and say: one table of every input and output, and the functions that compute them.

All of it is told in {R} or {O}, so that moving and turning the whole scene leaves every number here as it was.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax.numpy as jnp

from shmoo_mjx import se2
from shmoo_mjx.hands import HAND_RADIUS, hand_targets
from shmoo_mjx.types import SystemState

__all__ = [
    "GAP_LIMIT",
    "OBJECT_INPUTS",
    "OBJECT_OUTPUTS",
    "ROBOT_INPUTS",
    "ROBOT_OUTPUTS",
    "Contact",
    "Entry",
    "contact",
    "markdown_table",
    "object_inputs",
    "robot_inputs",
    "slices",
    "width",
]

Array = Any

GAP_LIMIT = 0.15
"""Gaps between hand and face are clipped to +- this [m]: farther off, they say nothing about the force."""


class Entry(NamedTuple):
    """One line of the input/output table."""

    name: str
    width: int
    frame: str
    unit: str
    meaning: str


ROBOT_INPUTS: tuple[Entry, ...] = (
    Entry("base_twist", 3, "R", "m/s, rad/s", "twist of the base"),
    Entry("lean", 2, "R", "rad", "lean towards +x and +y"),
    Entry("lean_rate", 2, "R", "rad/s", "rates of the lean"),
    Entry("face_pose", 3, "R", "m, rad", "centre of the pushed face; its inward normal against the heading, wrapped"),
    Entry("relative_twist", 3, "R", "m/s, rad/s", "object's motion at the face's centre as the robot sees it"),
    Entry("gap", 2, "O", "m", "left and right hand: gap to the face along its inward normal, clipped"),
    Entry("offset", 2, "O", "1", "left and right hand: offset from the face's centre over half its width, clipped"),
    Entry("gap_rate", 2, "O", "m/s", "rates of the two gaps with the hands at rest in {R}"),
    Entry("last_force", 2, "R", "N", "mean force of the hands on the object over the last sample"),
    Entry("last_u", 3, "R", "rad", "command of the last sample"),
    Entry("u", 3, "R", "rad", "command of this sample"),
    Entry("half_width", 1, "O", "m", "half the width of the pushed face"),
)
"""The 28 inputs of R."""

ROBOT_OUTPUTS: tuple[Entry, ...] = (
    Entry("base_acceleration", 3, "R", "m/s^2, rad/s^2", "mean acceleration of the base over the sample"),
    Entry("force", 2, "R", "N", "mean planar force of the hands on the object over the sample"),
)
"""The 5 outputs of R."""

OBJECT_INPUTS: tuple[Entry, ...] = (
    Entry("object_twist", 3, "O", "m/s, rad/s", "twist of the object"),
    Entry("wrench", 3, "O", "N, N m", "mean wrench of the hands about the object's centre over the sample"),
    Entry("last_object_twist", 3, "O", "m/s, rad/s", "twist one sample earlier, in {O} of that time"),
    Entry("size", 1, "O", "m", "half the diagonal of the footprint"),
)
"""The 10 inputs of psi."""

OBJECT_OUTPUTS: tuple[Entry, ...] = (
    Entry("object_acceleration", 3, "O", "m/s^2, rad/s^2", "mean acceleration of the object over the sample: psi a"),
)
"""The 3 outputs of O = psi a."""


class Contact(NamedTuple):
    """Hands and face as the hands' targets for one steering angle would meet it; last axis (left, right)."""

    gap: Array
    """``[..., 2]`` from the hand's surface to the face's line, along the inward normal [m]; negative = pressed in."""
    lateral: Array
    """``[..., 2]`` offset of the hand from the face's centre along the face [m]."""
    rate: Array
    """``[..., 2]`` rate of the gap with the hands at rest in {R} [m/s]."""
    face: Array
    """``[..., 3]`` pose of the face in {R}: centre x, y [m], direction of the inward normal [rad]."""
    motion: Array
    """``[..., 3]`` twist of the face as seen from the moving {R}, at the face's centre [m/s, rad/s]."""


def width(table: tuple[Entry, ...]) -> int:
    """Total width of a table."""
    return sum(entry.width for entry in table)


def slices(table: tuple[Entry, ...]) -> dict[str, slice]:
    """Where each named entry lies in the vector the table describes."""
    found, start = {}, 0
    for entry in table:
        found[entry.name] = slice(start, start + entry.width)
        start += entry.width
    return found


def markdown_table(table: tuple[Entry, ...]) -> str:
    """The table as Markdown, for the docs."""
    rows = ["| # | name | frame | unit | meaning |", "|---|---|---|---|---|"]
    for entry, where in zip(table, slices(table).values(), strict=True):
        number = str(where.start) if entry.width == 1 else f"{where.start}-{where.stop - 1}"
        rows.append(f"| {number} | {entry.name} | {{{entry.frame}}} | {entry.unit} | {entry.meaning} |")
    return "\n".join(rows) + "\n"


def contact(state: SystemState, gamma: Array) -> Contact:
    """Where the hands, held at the targets for steering angle ``gamma [...]`` [rad], stand against the face.

    Takes ``state`` with any batch dimensions.
    """
    lever = se2.rotate(state.face[..., :2], state.object_pose[..., 2])
    to_face = state.object_pose[..., :2] + lever - state.robot_pose[..., :2]
    heading = state.robot_pose[..., 2]
    centre = se2.rotate(to_face, -heading)
    angle = se2.wrap(state.object_pose[..., 2] + state.face[..., 2] - heading)
    velocity = _point_velocity(state.object_twist, lever) - _point_velocity(state.robot_twist, to_face)
    spin = (state.object_twist - state.robot_twist)[..., 2:]
    velocity = se2.rotate(velocity, -heading)
    normal = jnp.stack([jnp.cos(angle), jnp.sin(angle)], axis=-1)[..., None, :]
    tangent = jnp.stack([-jnp.sin(angle), jnp.cos(angle)], axis=-1)[..., None, :]
    away = centre[..., None, :] - hand_targets(gamma)
    along = jnp.sum(away * tangent, axis=-1)
    return Contact(
        gap=jnp.sum(away * normal, axis=-1) - HAND_RADIUS,
        lateral=-along,
        rate=jnp.sum(velocity[..., None, :] * normal, axis=-1) + spin * along,
        face=jnp.concatenate([centre, angle[..., None]], axis=-1),
        motion=jnp.concatenate([velocity, spin], axis=-1),
    )


def robot_inputs(state: SystemState, u: Array) -> Array:
    """The inputs of R ``[..., 28]`` as ROBOT_INPUTS lists them; ``u [..., 3]`` is the command of this sample [rad]."""
    touch = contact(state, state.last_u[..., 2])
    half_width = state.face[..., 3:]
    return jnp.concatenate(
        [
            se2.rotate(state.robot_twist, -state.robot_pose[..., 2]),
            state.lean,
            state.lean_rate,
            touch.face,
            touch.motion,
            jnp.clip(touch.gap, -GAP_LIMIT, GAP_LIMIT),
            jnp.clip(touch.lateral / half_width, -3.0, 3.0),
            touch.rate,
            state.last_force,
            state.last_u,
            u,
            half_width,
        ],
        axis=-1,
    )


def object_inputs(twist: Array, wrench: Array, last_twist: Array, size: Array) -> Array:
    """The inputs of psi ``[..., 10]`` as OBJECT_INPUTS lists them.

    Args:
        twist: ``[..., 3]`` of the object, in {O}.
        wrench: ``[..., 3]`` about the object's centre, in {O}.
        last_twist: ``[..., 3]`` one sample earlier, in {O} of that time.
        size: ``[...]`` half the diagonal of the footprint [m].
    """
    size = jnp.broadcast_to(jnp.asarray(size)[..., None], (*twist.shape[:-1], 1))
    return jnp.concatenate([twist, wrench, last_twist, size], axis=-1)


def _point_velocity(twist: Array, lever: Array) -> Array:
    """Velocity ``[..., 2]`` of the point at ``lever`` from the origin of a body with this twist, all in one frame."""
    spin = twist[..., 2:]
    return twist[..., :2] + spin * jnp.stack([-lever[..., 1], lever[..., 0]], axis=-1)
