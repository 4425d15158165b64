"""From recorded pushes to DAIML's {condition: (x, y)}, and from its coefficients back to motions.

x and y are given in the frame of the contact (inward normal, tangent towards which the pusher goes, lengths in units of
the object's size), so that pushes on any side of any shape look alike. y is what a quasi-static model leaves: its
outline comes from where the pusher touched, its few parameters from the pushes that the coefficients are fitted on.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from shmoo_mjx import se2
from shmoo_mjx.data.real_pushes import RealPushCondition
from shmoo_mjx.evaluation import push_outline, push_physics
from shmoo_mjx.learning import daiml
from shmoo_mjx.types import Array

__all__ = ["Prepared", "adapted", "credible", "prepare", "trained", "unscaled"]


class Prepared(NamedTuple):
    """N pushes of one condition as the learner takes them."""

    inputs: Array
    """``[N, n]``"""
    labels: Array
    """``[N, 3]`` motion less ``base``, in the contact's frame."""
    base: Array
    """``[N, 3]`` motion that the labels are added to, in the object's frame [m, m, rad]."""
    angle: Array
    """``[N]`` of the contact's normal in the object's frame [rad]."""
    side: Array
    """``[N]`` -1 where the contact's frame is mirrored."""
    size: float
    """Unit of length [m]."""
    parameters: Array
    """``[7]`` of the quasi-static model."""
    corners: Array
    """``[M, 2]`` of the outline [m]."""


def credible(condition: RealPushCondition) -> np.ndarray:
    """``[N]`` False where the point touched moved much farther than the pusher: the object's pose was lost.

    It needs the outcome, so it may pick what is learned from, never what is scored.
    """
    carried = np.linalg.norm(se2.transform_point(condition.motion, condition.start) - condition.start, axis=1)
    return np.asarray(carried < 1.3 * np.linalg.norm(condition.end - condition.start, axis=1))


def prepare(
    condition: RealPushCondition,
    known: Array,
    same_shape: Sequence[RealPushCondition] = (),
    prior: tuple[Array, Array] | None = None,
) -> Prepared:
    """Outline and quasi-static model from the pushes ``known [n]`` (indices), and all pushes in those terms.

    Touches of ``same_shape``, other recordings of this shape, may be used for the outline. ``prior`` is mean and
    standard deviation of the model's parameters.
    """
    touched = condition.touch[known]
    others = [push_outline.align(o.touch[credible(o)], touched) for o in same_shape]
    corners = push_outline.estimate(np.concatenate([touched, *others]), condition.tip_radius)
    start, end, radius = condition.start, condition.end, condition.tip_radius
    gap = push_outline.contact(start, corners).distance - radius
    if condition.touching_at_start:
        start, end = push_physics.start_of_push(start, end, corners, radius)
    arguments = start[known], end[known], condition.motion[known], corners, radius
    parameters = push_physics.identify(*arguments, prior)
    base = push_physics.push(start, end, corners, radius, parameters[None])[0]
    size, touch = push_outline.size(corners), push_outline.contact(start, corners)
    angle = np.arctan2(-touch.normal[:, 1], -touch.normal[:, 0])
    travel = se2.rotate(end - start, -angle)
    side = np.where(travel[:, 1] < 0.0, -1.0, 1.0)
    prepared = Prepared(np.empty(0), np.empty(0), base, angle, side, size, parameters, corners)
    inputs = [
        _in_contact(prepared, touch.point) / size,
        _in_contact(prepared, end - start) / size,
        _face_ends(prepared, touch.point),
        gap[:, None] / size,
        _scaled(prepared, base),
        -touch.normal,
        touch.point / size,
    ]
    labels = _scaled(prepared, condition.motion - base)
    return prepared._replace(inputs=np.concatenate(inputs, axis=1), labels=labels)


def trained(
    train: Mapping[str, tuple[Prepared, Array]], validation: Sequence[str], config: daiml.DaimlConfig
) -> daiml.ObjectFit:
    """psi from the pushes (indices) of the other conditions, those named in ``validation`` deciding when to stop."""
    rng = np.random.default_rng(config.seed)
    # Every condition gets as many rows, so that the learner compiles once for all conditions left out.
    longest = max(len(prepared.inputs) for prepared, _ in train.values())

    def arrays(names: Sequence[str]) -> dict[str, tuple[Array, Array]]:
        chosen = {}
        for name in names:
            prepared, rows = train[name]
            rows = np.resize(rng.permutation(rows), longest)  # shuffled: the learner fits a on consecutive rows
            chosen[name] = (prepared.inputs[rows], _clipped(prepared.labels[rows]))
        return chosen

    return daiml.fit(arrays([n for n in train if n not in validation]), arrays(validation), config)


def adapted(fitted: daiml.ObjectFit, prepared: Prepared, known: Array) -> np.ndarray:
    """Motions ``[N, 3]`` in the object's frame, with a fitted on the pushes ``known`` (outliers counting less)."""
    import jax.numpy as jnp

    from shmoo_mjx.dynamics import contact_model, object_model
    from shmoo_mjx.learning import least_squares

    inputs = jnp.asarray(prepared.inputs, jnp.float32)
    phi = object_model.design_matrix(fitted.params, inputs, fitted.config, contact_model.guess())
    labels = jnp.asarray(_clipped(prepared.labels[known]), jnp.float32)
    weights, prior = jnp.ones(len(known)), (fitted.prior_mean.reshape(-1), fitted.prior_covariance)
    for _ in range(3):
        a, _ = least_squares.posterior(phi[known], labels, *prior, fitted.noise, weights)
        error = labels - phi[known] @ a
        weights = 1.0 / (1.0 + jnp.sum(error**2 / jnp.diag(fitted.noise), axis=1) / 9.0)
    return prepared.base + unscaled(prepared, np.asarray(phi @ a))


def _in_contact(prepared: Prepared, vector: Array) -> np.ndarray:
    """Vectors ``[N, 2]`` along the contact's normal and tangent."""
    turned = se2.rotate(vector, -prepared.angle)
    return np.stack([turned[:, 0], turned[:, 1] * prepared.side], axis=1)


def _scaled(prepared: Prepared, motion: Array) -> np.ndarray:
    """Motions ``[N, 3]`` of the object's frame in the contact's, lengths over the size."""
    shift = _in_contact(prepared, motion[:, :2]) / prepared.size
    return np.concatenate([shift, (se2.wrap(motion[:, 2]) * prepared.side)[:, None]], axis=1)


def unscaled(prepared: Prepared, scaled: Array) -> np.ndarray:
    """The reverse of `_scaled`."""
    shift = np.stack([scaled[:, 0], scaled[:, 1] * prepared.side], axis=1) * prepared.size
    return np.concatenate([se2.rotate(shift, prepared.angle), (scaled[:, 2] * prepared.side)[:, None]], axis=1)


def _face_ends(prepared: Prepared, point: Array) -> np.ndarray:
    """How far the touched face goes on along the tangent, both ways ``[N, 2]``, over the size and at most 1."""
    relative = (prepared.corners - point[:, None]) / prepared.size
    turned = se2.rotate(relative, -prepared.angle[:, None])
    along = turned[..., 1] * prepared.side[:, None]
    on_face = np.abs(turned[..., 0]) < 0.08
    ends = np.max(np.where(on_face, along, -1.0), axis=1), np.min(np.where(on_face, along, 1.0), axis=1)
    return np.clip(np.stack(ends, axis=1), -1.0, 1.0)


def _clipped(labels: Array, widths: float = 4.0) -> np.ndarray:
    """Labels drawn in to so many robust standard deviations: a squared error would follow the few failures."""
    middle = np.median(labels, axis=0)
    width = widths * 1.48 * np.median(np.abs(labels - middle), axis=0)
    return np.clip(labels, middle - width, middle + width)
