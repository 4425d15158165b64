"""Inputs and outputs of the networks: one table each, and the functions that compute them.

All quantities are expressed in {R} or {O}, so they are invariant to translation and rotation of the whole scene.
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
"""Gaps between hand and face are clipped to plus or minus this value [m]. Larger gaps carry no information about the
force."""


class Entry(NamedTuple):
    """One line of the input/output table."""

    name: str
    """Name of the entry, unique in its table."""
    width: int
    """Number of channels."""
    frame: str
    """Letter of the frame, R or O."""
    unit: str
    """Units of the channels."""
    meaning: str
    """Description for the docs."""
    reflected: tuple[int, ...]
    """Sign of each channel under reflection in the x-z plane."""
    sides: bool = False
    """True if the two channels belong to the left and the right hand, which the reflection exchanges."""


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
"""The 13 inputs of psi. The paper has 10 inputs, all but the last entry."""

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
    """Pose and relative motion of robot and face, independent of the hands. Channels first."""

    heading: SO2
    """Rotation from {R} to {W}."""
    yaw: SO2
    """Rotation from {O} to {W}."""
    relative: SO2
    """Rotation from {O} to {R}."""
    pose: Float[Array, "3 ..."]
    """Pose of the face in {R}: centre x, y [m], direction of the inward normal [rad]."""
    motion: Float[Array, "3 ..."]
    """Twist of the face at its centre, relative to the moving {R} [m/s, rad/s]."""
    normal: SO2
    """Direction of the face's inward normal in {R}; its cosine and sine are the unit vector."""


class Contact(NamedTuple):
    """Gaps and offsets between the target positions of the hands and the face, for one steering angle.

    Channels first, hands in the order (left, right).
    """

    gap: Float[Array, "2 ..."]
    """Distance from the hand's surface to the face's line along the inward normal [m]; negative means compression."""
    lateral: Float[Array, "2 ..."]
    """Offset of the hand from the face's centre along the face [m]."""
    rate: Float[Array, "2 ..."]
    """Rate of change of the gap for hands at rest in {R} [m/s]."""
    hands: tuple[Float[Array, "2 ..."], Float[Array, "2 ..."]]
    """x and y of the hands in {R} [m]."""


def width(table: tuple[Entry, ...]) -> int:
    """Total number of channels of a table."""
    return sum(entry.width for entry in table)


def slices(table: tuple[Entry, ...]) -> dict[str, slice]:
    """Slice of each named entry in the vector that the table describes."""
    slices, start = {}, 0
    for entry in table:
        slices[entry.name] = slice(start, start + entry.width)
        start += entry.width
    return slices


def reflection(table: tuple[Entry, ...]) -> Float[np.ndarray, "n n"]:
    """Matrix that reflects the vector of the table in the x-z plane."""
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
    """Pose and motion of the pushed face, for a state with channels first (see `layout`) and any batch dimensions."""
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
    """Gaps and offsets between the face and the hands at their targets for steering angle ``gamma`` [rad]."""
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
    """The inputs of R in the order of ROBOT_INPUTS.

    Args:
        state: SystemState, any batch dimensions.
        u: command (phi_x, phi_y, gamma) of this sample [rad].
    """
    batch = jnp.broadcast_shapes(jnp.shape(state.robot_pose)[:-1], jnp.shape(u)[:-1])
    inside = to_channels_first(state, batch)
    u = channels_first(jnp.broadcast_to(u, (*batch, 3)))
    face = facing(inside)
    return channels_last(stacked_robot_inputs(inside, face, contact(face, inside.last_u[2]), u))


def stacked_robot_inputs(
    state: SystemState, face: Facing, touch: Contact, u: Float[Array, "3 ..."]
) -> Float[Array, "28 ..."]:
    """`robot_inputs` with channels first. ``touch`` is the contact for the steering angle of the last command."""
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
    """The inputs of psi in the order of OBJECT_INPUTS.

    Args:
        twist: twist of the object in {O} [m/s, rad/s].
        wrench: wrench of the hands about the object's centre in {O} [N, N m].
        last_twist: twist one sample earlier, in {O} of that time.
        size: half the diagonal of the footprint [m].
        last_wrench: wrench one sample earlier, in {O} of that time.
        axis: axis of the channels in the arguments and in the result; 0 for channels first, -1 for channels last.
    """
    batch = twist.shape[:-1] if axis == -1 else twist.shape[1:]
    size = jnp.expand_dims(jnp.broadcast_to(jnp.asarray(size), batch), axis)
    return jnp.concatenate([twist, wrench, last_twist, size, last_wrench], axis=axis)


def last_sample(inputs: Float[Array, "13 ..."]) -> tuple[Float[Array, "13 ..."], Float[Array, "3 ..."]]:
    """Inputs and acceleration of the previous sample, recovered from the inputs of psi. Channels first.

    Returns:
        The inputs of the previous sample, in which the last twist and last wrench are unknown and set to zero; and the
        mean acceleration over that sample, in {O} at its start, as in the labels of psi.
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
    """Velocity ``[2, ...]`` of the point at ``lever`` from a body's origin; ``twist`` and ``lever`` in one frame."""
    return jnp.stack([twist[0] - twist[2] * lever[1], twist[1] + twist[2] * lever[0]])
