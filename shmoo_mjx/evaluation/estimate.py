"""Experiment `estimate`: accuracy and coverage of the posterior over an object's dynamics, on unseen objects.

Scripted operators push objects as drawn, including heavy ones and locked wheels, with the robot's own sensors. After
some seconds of contact, the posterior's median is compared with the ground truth (`contact_prior`), and the coverage of
its 80 % band is counted. Roll-outs of posterior samples with psi are compared with the motion in the following 3 s.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cache, partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from shmoo_mjx.arrays import Array, Scalar
from shmoo_mjx.data.collect import drive, operators
from shmoo_mjx.dynamics import contact_model, features, object_model
from shmoo_mjx.evaluation.experiment import Experiment, ExperimentConfig, Setup
from shmoo_mjx.evaluation.result import ExperimentResult
from shmoo_mjx.evaluation.tables import Section, Table, lines_of, measured, percent
from shmoo_mjx.geometry import se2
from shmoo_mjx.geometry.hands import HAND_HEIGHT, REACH, touches
from shmoo_mjx.learning import contact_prior, estimate
from shmoo_mjx.learning.estimate import EstimateConfig, ObjectEstimate, Sighting
from shmoo_mjx.learning.online import BAND
from shmoo_mjx.learning.weights import Weights, load_weights
from shmoo_mjx.plant.condition import Condition
from shmoo_mjx.plant.objects import FAMILIES, draw_condition
from shmoo_mjx.plant.scene import build_scene
from shmoo_mjx.sensing import senses_named
from shmoo_mjx.sensing.engine import SensedEngine
from shmoo_mjx.types import DT, Command

SECONDS = (1.0, 3.0, 10.0)
"""Times in contact at which the estimate is scored [s]."""
_MASS = contact_model.PARAMETERS.index("log_mass")
_AHEAD = 30
"""Steps of the roll-outs."""
_CHUNK = 5
"""Objects per trial. They are simulated in parallel."""
_DRAWS = 32
"""Number of roll-outs, each with another posterior sample."""
JUMP = 1.5
"""Ratio of the mass estimates of two consecutive samples above which the estimate jumps."""


@dataclass(frozen=True)
class ObjectEstimateConfig(ExperimentConfig):
    """Size of the experiment."""

    objects: int = 20
    """Objects per family."""
    seconds: float = 40.0
    """Length of a recording [s]."""
    speeds: tuple[float, float] = (0.06, 0.3)
    """Range of the operators' speeds [m/s], similar to the controller's."""
    estimate: EstimateConfig = field(default_factory=EstimateConfig)


def _trials(setup: Setup[ObjectEstimateConfig]) -> dict[str, tuple[str, int]]:
    chunks = range(0, setup.config.objects, _CHUNK)
    return {f"{family}-{first}": (family, first) for family in FAMILIES for first in chunks}


def _trial(setup: Setup[ObjectEstimateConfig], trial: tuple[str, int]) -> list[dict[str, Any]]:
    """One row per object and time in SECONDS that its recording reaches."""
    config, (family, first) = setup.config.estimate, trial
    count = min(_CHUNK, setup.config.objects - first)
    seeds = [setup.options.first_unseen + first + i for i in range(count)]
    conditions = [draw_condition(family, seed) for seed in seeds]
    sightings, poses, axes = _recorded(setup, conditions, seeds)
    weights = _weights(setup.options.weights_file)
    prior = contact_prior.of_kind(weights.contact_prior, family)
    bands, masses, states = _filter(config, prior, sightings)
    bands, masses = np.asarray(bands), np.asarray(masses)
    contact = np.cumsum(np.asarray(touches(sightings.wrench)) & np.asarray(sightings.detected), axis=1)
    rows = []
    for i, condition in enumerate(conditions):
        truth = contact_prior.parameters_of(condition)
        true = np.log([contact_model.resistance(truth)[axes[i]], np.exp(truth[_MASS])])
        jumps = int(np.sum(np.abs(np.diff(np.log(masses[i]))) > np.log(JUMP)))
        for seconds in SECONDS:
            at = int(np.searchsorted(contact[i], round(seconds / DT)))
            if at == contact.shape[1]:
                continue
            row = {
                "family": family,
                "seed": seeds[i],
                "contact_s": seconds,
                "locked": any(condition.locked),
                "jumps": jumps,
            }
            for k, (name, column) in enumerate((("friction", axes[i]), ("mass", 2))):
                low, middle, high = np.log(bands[i, at, :, column])
                row |= {
                    f"{name}_true": float(np.exp(true[k])),
                    f"{name}_median": float(np.exp(middle)),
                    f"{name}_error": float(abs(np.expm1(middle - true[k]))),
                    f"{name}_covered": bool(low <= true[k] <= high),
                }
            if at + _AHEAD < contact.shape[1]:
                state = jax.tree.map(lambda a, i=i, at=at: a[i, at], states)
                row |= _ahead(
                    config,
                    weights,
                    prior,
                    state,
                    wrenches=np.asarray(sightings.wrench)[i, at : at + _AHEAD + 1],
                    size=float(np.asarray(sightings.size)[i, 0]),
                    true=poses[i, at + _AHEAD, :2],
                )
            rows.append(row)
    return rows


def _ahead(
    config: EstimateConfig,
    weights: Weights,
    prior: Array,
    state: ObjectEstimate,
    *,
    wrenches: np.ndarray,
    size: float,
    true: np.ndarray,
) -> dict[str, float]:
    """Error [m] of the mean position 3 s ahead, and share of the axes of {W} on which the 80 % band of the samples
    holds the true position; for samples of the posterior and of the prior."""
    before = estimate.init(config, prior, jax.random.key(1))._replace(pose=state.pose, twist=state.twist)
    row = {}
    for name, posterior in (("ahead", state), ("prior_ahead", before)):
        ends = np.asarray(
            _roll_outs(config, weights.config.object, weights.params, posterior, wrenches=wrenches, size=size)
        )
        low, high = np.quantile(ends, (BAND[0], BAND[-1]), axis=0)
        row[f"{name}_error"] = float(np.hypot(*(ends.mean(axis=0) - true)))
        row[f"{name}_covered"] = float(np.mean((low <= true) & (true <= high)))
    return row


@partial(jax.jit, static_argnums=(0, 1))
def _roll_outs(
    config: EstimateConfig, shape: Any, params: Any, state: ObjectEstimate, *, wrenches: Array, size: Scalar
) -> Array:
    """Positions ``[_DRAWS, 2]`` of the object in {W} after the sensed ``wrenches [1 + T, 3]``. The first wrench is that
    of the previous sample."""
    chosen = jax.random.categorical(jax.random.key(0), state.log_weight, shape=(_DRAWS,))
    contact, force, pose, twist = (a[chosen] for a in (state.parameters, state.force, state.pose, state.twist))
    accelerations = jax.vmap(partial(object_model.predict, params.object, params.coefficients, config=shape))

    def sample(carry: Any, sensed: Any) -> tuple[Any, None]:
        pose, twist, last_twist, last_wrench = carry
        wrench = se2.rotate(estimate.true_wrench(config, force, sensed), -pose[:, 2])
        inside = se2.rotate(twist, -pose[:, 2])
        inputs = features.object_inputs(inside, wrench, last_twist=last_twist, size=size, last_wrench=last_wrench)
        acceleration = se2.rotate(accelerations(inputs=inputs, contact=contact), pose[:, 2])
        pose = pose + twist * DT + 0.5 * acceleration * DT**2
        return (pose, twist + acceleration * DT, inside, wrench), None

    before = se2.rotate(jnp.broadcast_to(wrenches[0], pose.shape), -pose[:, 2])
    start = (pose, twist, se2.rotate(twist, -pose[:, 2]), before)
    return jax.lax.scan(sample, start, wrenches[1:])[0][0][:, :2]


def _recorded(
    setup: Setup[ObjectEstimateConfig], conditions: list[Condition], seeds: list[int]
) -> tuple[Sighting, np.ndarray, np.ndarray]:
    """Sensed samples ``[W, T, ...]`` of W objects that operators push, true poses ``[W, T, 3]`` in {W}, and the axis of
    {O} along which each is pushed (0 or 1)."""
    senses, count = senses_named(setup.options.senses), len(conditions)
    rng = np.random.default_rng([setup.options.seed, *seeds[:1], FAMILIES.index(conditions[0].family)])
    half_extents = [c.half_extents for c in conditions]
    operator, poses = operators(rng, count, half_extents)
    operator = operator._replace(liveliness=np.full(count, 0.4))
    scenes = [
        build_scene([(c, (0.0, 0.0, 0.0))], pose.tolist(), adjust=senses.adjust(seed))
        for c, pose, seed in zip(conditions, poses, seeds, strict=True)
    ]
    sizes, columns, true = np.hypot(*np.array(half_extents).T), [], []
    with SensedEngine(scenes, senses, seeds, poses_known=True) as engine:
        ones = np.ones(count)
        still = Command(np.zeros((count, 3)), poses[:, 2], REACH * ones, HAND_HEIGHT * ones)
        world, sensed = engine.step(engine.init(), still, 1.0)
        for _ in range(round(setup.config.seconds / DT)):
            operator, command = drive(rng, operator, sensed)
            operator = operator._replace(speed=np.clip(operator.speed, *setup.config.speeds))
            world, sensed = engine.step(world, command)
            of_object = (sensed.object_pose, sensed.object_twist, sensed.object_age, sensed.detected, sensed.wrench)
            pose, twist, age, detected, wrench = (np.asarray(value[:, 0]) for value in of_object)
            columns.append(Sighting(pose, twist, age, detected, wrench, sizes))
            true.append(engine.true_observation(world).object_pose[:, 0])
    stacked = jax.tree.map(lambda *column: np.stack(column, axis=1), *columns)
    return stacked, np.stack(true, axis=1), (np.abs(np.cos(operator.face[:, 2])) < 0.5).astype(int)


@cache
def _weights(file: Path) -> Weights:
    return load_weights(file)


@partial(jax.jit, static_argnums=0)
def _filter(config: EstimateConfig, prior: Any, sightings: Sighting) -> tuple[Any, Any, ObjectEstimate]:
    """Bands ``[W, T, 3, 3]`` (low, median, high) of friction along x and y and of mass, the mean mass ``[W, T]``, and
    the posteriors after each sample without their constant fields."""

    def step(state: ObjectEstimate, sample: Sighting) -> tuple[ObjectEstimate, Any]:
        state = estimate.step(config, state, sample)
        friction = contact_model.resistance(state.parameters)
        quantities = jnp.concatenate([friction, jnp.exp(state.parameters[:, _MASS, None])], axis=-1)
        bands = estimate.quantiles(state, quantities, BAND)
        moving: dict[str, Any] = state._asdict() | {"prior": None, "key": None}
        return state, (bands, jnp.exp(estimate.mean(state)[_MASS]), ObjectEstimate(**moving))

    def one(samples: Sighting, key: Any) -> Any:
        return jax.lax.scan(step, estimate.init(config, prior, key), samples)[1]

    samples = jax.tree.map(lambda a: jnp.asarray(a, bool if a.dtype == bool else jnp.float32), sightings)
    keys = jax.random.split(jax.random.key(0), len(sightings.pose))
    filtered: tuple[Any, Any, ObjectEstimate] = jax.vmap(one)(samples, keys)
    return filtered


def _metrics(rows: list[dict[str, Any]]) -> dict[str, float]:
    """Median errors, coverage of the 80 % band, and median number of jumps."""
    metrics: dict[str, float] = {}
    for family in FAMILIES:
        for seconds in SECONDS:
            mine = [r for r in rows if r["family"] == family and r["contact_s"] == seconds]
            for name in ("friction", "mass", "ahead", "prior_ahead"):
                suffix = f"{family}_{seconds:g}s"
                # A recording may end before that.
                measured = [r for r in mine if f"{name}_error" in r]
                metrics[f"{name}_error_{suffix}"] = float(np.median([r[f"{name}_error"] for r in measured] or [np.nan]))
                metrics[f"{name}_coverage_{suffix}"] = float(
                    np.mean([r[f"{name}_covered"] for r in measured] or [np.nan])
                )
        jumps = {r["seed"]: r["jumps"] for r in rows if r["family"] == family}
        metrics[f"jumps_{family}"] = float(np.median([*jumps.values()] or [np.nan]))
    return metrics


_LINES = {
    "friction_error": "Friction: median relative error",
    "friction_coverage": "Friction: share of true values in the 80 % band",
    "mass_error": "Mass: median relative error",
    "mass_coverage": "Mass: share of true values in the 80 % band",
    "ahead_error": "Position 3 s ahead: median error [m]",
    "prior_ahead_error": "Position 3 s ahead, from the prior: median error [m]",
    "ahead_coverage": "Position 3 s ahead: share of true values in the 80 % band",
    "prior_ahead_coverage": "Position 3 s ahead, from the prior: share in the 80 % band",
}


def _shows(result: ExperimentResult) -> str:
    def each(name: str, seconds: float) -> str:
        values = (f"{percent(measured(result, f'{name}_{f}_{seconds:g}s'))} ({f})" for f in FAMILIES)
        return ", ".join(values)

    return (
        f"After 3 s of contact the friction along the push is known to {each('friction_error', 3.0)}, the mass to "
        f"{each('mass_error', 3.0)}. The 80 % band holds the true position 3 s ahead in "
        f"{each('ahead_coverage', 3.0)} of the cases, where 80 % would be right."
    )


EXPERIMENT = Experiment(
    Section(
        "Estimate of an object's dynamics",
        "How well does the robot know friction and mass after some seconds of contact, and how sure is it?",
        (
            Table(FAMILIES, lines_of(_LINES, *(f"{{}}_{family}_3s" for family in FAMILIES)), "After 3 s of contact:"),
            Table(
                tuple(f"{family}, {seconds:g} s" for family in FAMILIES for seconds in SECONDS),
                lines_of(_LINES, *(f"{{}}_{family}_{seconds:g}s" for family in FAMILIES for seconds in SECONDS)),
                "After 1, 3 and 10 s of contact:",
            ),
        ),
        _shows,
    ),
    ObjectEstimateConfig(),
    quick=ObjectEstimateConfig(objects=2, seconds=15.0),
    trials=_trials,
    trial=_trial,
    metrics=lambda setup, rows: _metrics(rows),
)
