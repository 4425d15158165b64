"""Inputs and outputs of the networks: one table of each, and the functions that compute them.

All of it is expressed in {R} or {O}, so that moving and turning the whole scene leaves every number here as it was.
"""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from scipy.linalg import block_diag

from shmoo_mjx.arrays import Array, Float, Scalar
from shmoo_mjx.dynamics.layout import SO2, channels_first, channels_last, once, to_channels_first
from shmoo_mjx.geometry import se2
from shmoo_mjx.geometry.hands import HAND_RADIUS, hand_components
from shmoo_mjx.types import DT, SystemState

GAP_LIMIT = 0.15
"""Gaps between hand and face are clipped to +- this [m]: farther off, they say nothing about the force."""


class Entry(NamedTuple):
    """One line of the input/output table."""

    name: str
    width: int
    frame: str
    unit: str
    meaning: str
    reflected: tuple[int, ...]
    """Signs of its channels in the mirror of the x-z plane."""
    sides: bool = False
    """Whether its two channels are of the left and the right hand, which the mirror exchanges."""


ROBOT_INPUTS: tuple[Entry, ...] = (
    Entry("base_twist", 3, "R", "m/s, rad/s", "twist of the base", (1, -1, -1)),
    Entry("lean", 2, "R", "rad", "lean towards +x and +y", (1, -1)),
    Entry("lean_rate", 2, "R", "rad/s", "rates of the lean", (1, -1)),
    Entry(
        "face_pose",
        3,
        "R",
        "m, rad",
        "centre of the pushed face; its inward normal against the heading, wrapped",
        (1, -1, -1),
    ),
    Entry(
        "relative_twist", 3, "R", "m/s, rad/s", "object's motion at the face's centre as the robot sees it", (1, -1, -1)
    ),
    Entry(
        "gap", 2, "O", "m", "left and right hand: gap to the face along its inward normal, clipped", (1, 1), sides=True
    ),
    Entry(
        "offset",
        2,
        "O",
        "1",
        "left and right hand: offset from the face's centre over half its width, clipped",
        (-1, -1),
        sides=True,
    ),
    Entry("gap_rate", 2, "O", "m/s", "rates of the two gaps with the hands at rest in {R}", (1, 1), sides=True),
    Entry("last_force", 2, "R", "N", "mean force of the hands on the object over the last sample", (1, -1)),
    Entry("last_u", 3, "R", "rad", "command of the last sample", (1, -1, -1)),
    Entry("u", 3, "R", "rad", "command of this sample", (1, -1, -1)),
    Entry("half_width", 1, "O", "m", "half the width of the pushed face", (1,)),
)
"""The 28 inputs of R."""

ROBOT_OUTPUTS: tuple[Entry, ...] = (
    Entry("base_acceleration", 3, "R", "m/s^2, rad/s^2", "mean acceleration of the base over the sample", (1, -1, -1)),
    Entry("force", 2, "R", "N", "mean planar force of the hands on the object over the sample", (1, -1)),
)
"""The 5 outputs of R."""

OBJECT_INPUTS: tuple[Entry, ...] = (
    Entry("object_twist", 3, "O", "m/s, rad/s", "twist of the object", (1, -1, -1)),
    Entry(
        "wrench", 3, "O", "N, N m", "mean wrench of the hands about the object's centre over the sample", (1, -1, -1)
    ),
    Entry("last_object_twist", 3, "O", "m/s, rad/s", "twist one sample earlier, in {O} of that time", (1, -1, -1)),
    Entry("size", 1, "O", "m", "half the diagonal of the footprint", (1,)),
    Entry("last_wrench", 3, "O", "N, N m", "wrench one sample earlier, in {O} of that time", (1, -1, -1)),
)
"""The 13 inputs of psi; the paper has 10, and the last entry is not among them."""

OBJECT_OUTPUTS: tuple[Entry, ...] = (
    Entry(
        "object_acceleration",
        3,
        "O",
        "m/s^2, rad/s^2",
        "mean acceleration of the object over the sample: psi a",
        (1, -1, -1),
    ),
)
"""The 3 outputs of O = psi a."""


class Facing(NamedTuple):
    """Poses and relative motion of robot and face, whatever the hands do; channels first."""

    heading: SO2
    """From {R} to {W}."""
    yaw: SO2
    """From {O} to {W}."""
    relative: SO2
    """From {O} to {R}."""
    pose: Float[Array, "3 ..."]
    """Pose of the face in {R}: centre x, y [m], direction of the inward normal [rad]."""
    motion: Float[Array, "3 ..."]
    """Twist of the face as seen from the moving {R}, at the face's centre [m/s, rad/s]."""
    normal: SO2
    """Its cosine and sine are the inward normal of the face in {R}."""


class Contact(NamedTuple):
    """Gaps and offsets of the hands' targets against the face, for one steering angle; channels first, hands (left,
    right)."""

    gap: Float[Array, "2 ..."]
    """From the hand's surface to the face's line, along the inward normal [m]; negative = pressed in."""
    lateral: Float[Array, "2 ..."]
    """Offset of the hand from the face's centre along the face [m]."""
    rate: Float[Array, "2 ..."]
    """Rate of the gap with the hands at rest in {R} [m/s]."""
    hands: tuple[Float[Array, "2 ..."], Float[Array, "2 ..."]]
    """x and y of the hands in {R} [m]."""


def width(table: tuple[Entry, ...]) -> int:
    """Total width of a table."""
    return sum(entry.width for entry in table)


def slices(table: tuple[Entry, ...]) -> dict[str, slice]:
    """Where each named entry lies in the vector the table describes."""
    slices, start = {}, 0
    for entry in table:
        slices[entry.name] = slice(start, start + entry.width)
        start += entry.width
    return slices


def reflection(table: tuple[Entry, ...]) -> Float[np.ndarray, "n n"]:
    """The matrix that makes the vector of the table what it is in the mirror of the x-z plane."""
    blocks = []
    for entry in table:
        block = np.diag(np.array(entry.reflected, np.float32))
        blocks.append(block[::-1] if entry.sides else block)
    return block_diag(*blocks)


def markdown_table(table: tuple[Entry, ...]) -> str:
    """The table as Markdown, for the docs."""
    rows = ["| # | name | frame | unit | meaning |", "|---|---|---|---|---|"]
    for entry, where in zip(table, slices(table).values(), strict=True):
        number = str(where.start) if entry.width == 1 else f"{where.start}-{where.stop - 1}"
        rows.append(f"| {number} | {entry.name} | {{{entry.frame}}} | {entry.unit} | {entry.meaning} |")
    return "\n".join(rows) + "\n"


def facing(state: SystemState) -> Facing:
    """Pose and motion of the pushed face, for a state with channels first (`layout`) and any batch dimensions."""
    heading, yaw = once((SO2.from_angle(state.robot_pose[2]), SO2.from_angle(state.object_pose[2])))
    relative = yaw.compose(heading.inverse())
    lever = yaw.apply(state.face[:2])
    to_face = state.object_pose[:2] + lever - state.robot_pose[:2]
    velocity = _point_velocity(state.object_twist, lever) - _point_velocity(state.robot_twist, to_face)
    angle = se2.wrap(state.object_pose[2] + state.face[2] - state.robot_pose[2])
    face = Facing(
        heading=heading,
        yaw=yaw,
        relative=relative,
        pose=jnp.stack([*heading.inverse_apply(to_face), angle]),
        motion=jnp.stack([*heading.inverse_apply(velocity), state.object_twist[2] - state.robot_twist[2]]),
        normal=relative.compose(SO2.from_angle(state.face[2])),
    )
    return once(face)


def contact(face: Facing, gamma: Scalar | Float[Array, "..."]) -> Contact:
    """Gaps and offsets of the hands, held at the targets for steering angle ``gamma`` [rad], against the face."""
    n = face.normal
    (left_x, left_y), (right_x, right_y) = hand_components(gamma)
    x, y = once((jnp.stack([left_x, right_x]), jnp.stack([left_y, right_y])))
    away_x, away_y = face.pose[0] - x, face.pose[1] - y
    along = away_y * n.c - away_x * n.s
    touch = Contact(
        gap=away_x * n.c + away_y * n.s - HAND_RADIUS,
        lateral=-along,
        rate=face.motion[0] * n.c + face.motion[1] * n.s + face.motion[2] * along,
        hands=(x, y),
    )
    return once(touch)


def robot_inputs(state: SystemState, u: Float[Array, "... 3"]) -> Float[Array, "... 28"]:
    """The inputs of R as ROBOT_INPUTS lists them; ``u`` is the command of this sample [rad]."""
    batch = jnp.broadcast_shapes(jnp.shape(state.robot_pose)[:-1], jnp.shape(u)[:-1])
    inside = to_channels_first(state, batch)
    u = channels_first(jnp.broadcast_to(u, (*batch, 3)))
    face = facing(inside)
    return channels_last(stacked_robot_inputs(inside, face, contact(face, inside.last_u[2]), u))


def stacked_robot_inputs(
    state: SystemState, face: Facing, touch: Contact, u: Float[Array, "3 ..."]
) -> Float[Array, "28 ..."]:
    """`robot_inputs` with channels first, from the contact as the last command's steering has it."""
    half_width = state.face[3:]
    return jnp.concatenate(
        [
            face.heading.inverse_apply(state.robot_twist),
            state.lean,
            state.lean_rate,
            face.pose,
            face.motion,
            jnp.clip(touch.gap, -GAP_LIMIT, GAP_LIMIT),
            jnp.clip(touch.lateral / half_width, -3.0, 3.0),
            touch.rate,
            state.last_force,
            state.last_u,
            u,
            jnp.broadcast_to(half_width, (1, *u.shape[1:])),
        ]
    )


def object_inputs(
    twist: Float[Array, "... 3"] | Float[Array, "3 ..."],
    wrench: Float[Array, "... 3"] | Float[Array, "3 ..."],
    *,
    last_twist: Float[Array, "... 3"] | Float[Array, "3 ..."],
    size: Scalar | Float[Array, "..."],
    last_wrench: Float[Array, "... 3"] | Float[Array, "3 ..."],
    axis: int = -1,
) -> Float[Array, "... 13"] | Float[Array, "13 ..."]:
    """The inputs of psi as OBJECT_INPUTS lists them.

    Args:
        twist: of the object, in {O}.
        wrench: about the object's centre, in {O}.
        last_twist: one sample earlier, in {O} of that time.
        size: half the diagonal of the footprint [m].
        last_wrench: one sample earlier, in {O} of that time.
        axis: where the channels lie, in the arguments and in the answer; 0 for channels first.
    """
    batch = twist.shape[:-1] if axis == -1 else twist.shape[1:]
    size = jnp.expand_dims(jnp.broadcast_to(jnp.asarray(size), batch), axis)
    return jnp.concatenate([twist, wrench, last_twist, size, last_wrench], axis=axis)


def last_sample(inputs: Float[Array, "13 ..."]) -> tuple[Float[Array, "13 ..."], Float[Array, "3 ..."]]:
    """Inputs and acceleration of the previous sample, as far as psi's inputs, channels first, hold them.

    Returns:
        Inputs of that sample, whose own past is not known and left zero; and the mean acceleration over it, in {O} at
        its start, the convention of psi's labels.
    """
    where = slices(OBJECT_INPUTS)
    twist, last, wrench = (inputs[where[name]] for name in ("object_twist", "last_object_twist", "last_wrench"))
    before = object_inputs(
        last,
        wrench,
        last_twist=jnp.zeros_like(last),
        size=inputs[where["size"]][0],
        last_wrench=jnp.zeros_like(last),
        axis=0,
    )
    turned = SO2.from_angle(0.5 * (last[2] + twist[2]) * DT)
    return before, (turned.apply(twist) - last) / DT


def _point_velocity(twist: Array, lever: Array) -> Array:
    """Velocity ``[2, ...]`` of the point at ``lever`` from the origin of a body with this twist, all in one frame."""
    return jnp.stack([twist[0] - twist[2] * lever[1], twist[1] + twist[2] * lever[0]])
