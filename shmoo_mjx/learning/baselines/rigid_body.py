"""A rigid body on four feet with anisotropic friction, its parameters identified by nonlinear least squares."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from scipy.optimize import least_squares as nonlinear_least_squares

from shmoo_mjx.dynamics import features
from shmoo_mjx.learning import training, trees
from shmoo_mjx.learning.baselines.protocol import Context, Job, Predictor, first_rows, output_scale
from shmoo_mjx.types import DT

__all__ = ["PARAMETERS", "acceleration", "rigid_body"]

Array = Any

PARAMETERS: dict[str, tuple[float, float]] = {
    "log_mass": (3.0, 1.0),
    "log_inertia": (0.5, 1.0),
    "centre_x": (0.0, 0.1),
    "centre_y": (0.0, 0.1),
    "log_friction_x": (-2.0, 1.5),
    "log_friction_y": (-2.0, 1.5),
    "log_foot_x": (-1.2, 0.5),
    "log_foot_y": (-1.2, 0.5),
    "log_drag_x": (1.0, 2.0),
    "log_drag_y": (1.0, 2.0),
    "log_drag_yaw": (0.0, 2.0),
}
"""What is identified: first guess and how far it may be off. Mass [kg], inertia [kg m^2], centre of mass in {O} [m],
Coulomb coefficients along x and y of {O}, half distances of the feet [m], drags [N s/m, N m s]."""

SLIDING = 0.05
"""Speed over which Coulomb friction sets in [m/s]."""
SUBSTEPS = 25
GRAVITY = 9.81
PRIOR_CONDITIONS = 36
"""Training conditions that the prior is made of; more change little and take their time."""


def acceleration(parameters: Array, twist: Array, wrench: Array) -> Array:
    """Mean acceleration ``[..., 3]`` over a sample under a constant wrench, both in {O} at the sample's start.

    Args:
        parameters: ``[11]`` in the order of PARAMETERS.
        twist: ``[..., 3]``.
        wrench: ``[..., 3]`` about the centre of {O}.
    """
    mass, inertia, friction_x, friction_y, foot_x, foot_y = jnp.exp(parameters[jnp.array([0, 1, 4, 5, 6, 7])])
    centre, drag = parameters[2:4], jnp.exp(parameters[8:11])
    inertia_here = inertia + mass * jnp.sum(centre**2)
    matrix = jnp.array(
        [
            [mass, 0.0, -mass * centre[1]],
            [0.0, mass, mass * centre[0]],
            [-mass * centre[1], mass * centre[0], inertia_here],
        ]
    )
    inverse = jnp.linalg.inv(matrix)
    feet = jnp.array([[1.0, 1.0], [1.0, -1.0], [-1.0, 1.0], [-1.0, -1.0]]) * jnp.stack([foot_x, foot_y])
    around = jnp.stack([-feet[:, 1], feet[:, 0]], axis=-1)
    grip = mass * GRAVITY / 4 * jnp.stack([friction_x, friction_y])

    def substep(_: int, v: Array) -> Array:
        sliding = v[..., None, :2] + v[..., None, 2:] * around
        speed = jnp.sqrt(jnp.sum(sliding**2, axis=-1, keepdims=True) + SLIDING**2)
        force = -grip * sliding / speed
        moment = jnp.sum(around * force, axis=(-1, -2))
        rubbing = jnp.concatenate([jnp.sum(force, axis=-2), moment[..., None]], axis=-1)
        centrifugal = mass * v[..., 2:] ** 2 * jnp.concatenate([centre, jnp.zeros(1)])
        return v + (DT / SUBSTEPS) * (wrench + rubbing - drag * v + centrifugal) @ inverse

    return (jax.lax.fori_loop(0, SUBSTEPS, substep, twist) - twist) / DT


def rigid_body(job: Job) -> Predictor:
    """Identify each condition's parameters; setting["prior"] weighs how training conditions turned out."""
    where = features.slices(features.OBJECT_INPUTS)
    scale = output_scale(job.train.rows)
    guess = np.array(list(PARAMETERS.values()))

    @jax.jit
    def residuals(parameters: Array, x: Array, y: Array, w: Array) -> Array:
        predicted = acceleration(parameters, x[:, where["object_twist"]], x[:, where["wrench"]])
        return ((predicted - y) / scale * jnp.sqrt(w)[:, None]).reshape(-1)

    slopes = jax.jit(jax.jacfwd(residuals))

    def identify(context: Context, mean: np.ndarray, root: np.ndarray, noise: float) -> np.ndarray:
        """Parameters with the least squared residual over ``noise`` plus squared distance from the prior."""
        rows = context.inputs, context.labels, context.weights
        found = nonlinear_least_squares(
            lambda p: np.concatenate([np.asarray(residuals(p, *rows)) / noise, root @ (p - mean)]),
            mean,
            lambda p: np.concatenate([np.asarray(slopes(p, *rows)) / noise, root]),
            bounds=(guess[:, 0] - 5 * guess[:, 1], guess[:, 0] + 5 * guess[:, 1]),
            x_scale=guess[:, 1],
            max_nfev=40,
        )
        return np.asarray(found.x)

    count = len(job.train.properties)
    chosen = range(0, count, -(-count // PRIOR_CONDITIONS))
    contexts = [first_rows(job.train, i, job.fit_rows) for i in chosen]

    def of_training() -> tuple[np.ndarray, np.ndarray]:
        """Parameters of the chosen training conditions, and the noise they leave."""
        broad = np.diag(1.0 / guess[:, 1])
        found = np.stack([identify(c, guess[:, 0], broad, 0.5) for c in contexts])
        left = [residuals(p, c.inputs, c.labels, c.weights) for p, c in zip(found, contexts, strict=True)]
        rows = sum(float(np.sum(c.weights)) for c in contexts)
        return found, np.sqrt(np.sum(np.square(left)) / max(rows * scale.shape[0], 1.0))

    found, noise = _kept(job, (len(contexts), len(PARAMETERS)), of_training)
    spread = np.cov(found.T) + np.diag((0.1 * guess[:, 1]) ** 2)
    root = np.linalg.cholesky(np.linalg.inv(spread)).T * job.setting["prior"] ** 0.5
    mean = found.mean(axis=0)

    def predict(parameters: Array, x: Array, time: Array) -> Array:
        return acceleration(parameters, x[..., where["object_twist"]], x[..., where["wrench"]])

    return Predictor(lambda c: jnp.asarray(identify(c, mean, root, float(noise)), jnp.float32), predict)


def _kept(
    job: Job, shape: tuple[int, int], make: Callable[[], tuple[np.ndarray, np.ndarray]]
) -> tuple[np.ndarray, np.ndarray]:
    """What ``make`` gives, read from the job's directory if it was made before."""
    if job.directory is None:
        return make()
    path, rows = job.directory / "rigid_body.safetensors", job.train.rows
    identity = training.fingerprint((job.fit_rows, shape), rows.inputs, rows.labels)
    loaded = trees.load_checkpoint(path, {"found": np.zeros(shape), "noise": np.zeros(())}, identity)
    if loaded is not None:
        return loaded[0]["found"], loaded[0]["noise"]
    found, noise = make()
    trees.save_checkpoint(path, {"found": found, "noise": np.asarray(noise)}, {"identity": identity})
    return found, noise
