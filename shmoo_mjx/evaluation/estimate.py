"""Experiment `estimate`: accuracy and coverage of the posterior over an object's dynamics, on unseen objects.

The robot pushes objects as drawn to a pose, including heavy ones and locked wheels. After some seconds of contact, the
posterior's median is compared with the ground truth (`contact_prior`), and the coverage of its 80 % band is counted. An
object that the robot gives up earlier is left out of the later times. Roll-outs of posterior samples with psi are
compared with the motion in the following 3 s.
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
from shmoo_mjx.behavior.state import Mode
from shmoo_mjx.control.presets import pose_push_config
from shmoo_mjx.control.pushing import PushController
from shmoo_mjx.dynamics import contact_model, features, object_model
from shmoo_mjx.evaluation.experiment import Experiment, ExperimentConfig, Setup
from shmoo_mjx.evaluation.pushing_trials import EVERYTHING, GOALS, Trial, draw_trials, scene_of_trial, task_of
from shmoo_mjx.evaluation.result import ExperimentResult
from shmoo_mjx.evaluation.tables import Section, Table, lines_of, measured, percent
from shmoo_mjx.geometry import se2
from shmoo_mjx.geometry.hands import touches
from shmoo_mjx.learning import contact_prior, estimate
from shmoo_mjx.learning.estimate import EstimateConfig, ObjectEstimate, Sighting
from shmoo_mjx.learning.online import BAND
from shmoo_mjx.learning.weights import Weights, load_weights
from shmoo_mjx.plant.objects import FAMILIES
from shmoo_mjx.sensing import senses_named
from shmoo_mjx.sensing.engine import SensedEngine
from shmoo_mjx.types import DT

SECONDS = (1.0, 3.0, 10.0)
"""Times in contact at which the estimate is scored [s]."""
_MASS = contact_model.PARAMETERS.index("log_mass")
_AHEAD = 30
"""Steps of the roll-outs."""
_DRAWS = 32
"""Number of roll-outs, each with another posterior sample."""
JUMP = 1.5
"""Ratio of the mass estimates of two consecutive samples above which the estimate jumps."""


@dataclass(frozen=True)
class ObjectEstimateConfig(ExperimentConfig):
    """Size of the experiment."""

    objects: int = 20
    """Objects per family."""
    seconds: float = 60.0
    """Longest recording [s]."""
    estimate: EstimateConfig = field(default_factory=EstimateConfig)


def _trials(setup: Setup[ObjectEstimateConfig]) -> dict[str, Trial]:
    options, count = setup.options, setup.config.objects
    drawn = draw_trials(options.first_unseen, options.seed, count, stratum=EVERYTHING)
    # One push per object; successive objects have successive goals.
    return {trial.name: trial for trial in drawn if trial.goal == trial.run % len(GOALS) + 1}


def _trial(setup: Setup[ObjectEstimateConfig], trial: Trial) -> list[dict[str, Any]]:
    """One row per time in SECONDS that the recording reaches."""
    config, condition = setup.config.estimate, trial.condition
    weights = _weights(setup.options.weights_file)
    sightings, first, poses = _recorded(setup, trial, _pusher(setup.options.weights_file))
    felt = se2.rotate(sightings.wrench[:, :2], -poses[:, 2])
    axis = int(np.nansum(np.abs(felt), axis=0).argmax())
    prior = contact_prior.of_kind(weights.contact_prior, trial.family)
    bands, masses, states = _filter(config, prior, sightings, first)
    bands, masses = np.asarray(bands), np.asarray(masses)
    contact = np.cumsum(np.asarray(touches(sightings.wrench)) & sightings.detected)
    truth = contact_prior.parameters_of(condition)
    true = np.log([contact_model.resistance(truth)[axis], np.exp(truth[_MASS])])
    jumps = int(np.sum(np.abs(np.diff(np.log(masses))) > np.log(JUMP)))
    rows = []
    for seconds in SECONDS:
        at = int(np.searchsorted(contact, round(seconds / DT)))
        if at == len(contact):
            continue
        row = {
            "family": trial.family,
            "seed": condition.seed,
            "contact_s": seconds,
            "locked": any(condition.locked),
            "jumps": jumps,
        }
        for k, (name, column) in enumerate((("friction", axis), ("mass", 2))):
            low, middle, high = np.log(bands[at, :, column])
            row |= {
                f"{name}_true": float(np.exp(true[k])),
                f"{name}_median": float(np.exp(middle)),
                f"{name}_error": float(abs(np.expm1(middle - true[k]))),
                f"{name}_covered": bool(low <= true[k] <= high),
            }
        # What follows must be one push.
        ends = at + _AHEAD
        if ends < len(contact) and np.isfinite(poses[ends]).all() and not first[at + 1 : ends + 1].any():
            row |= _ahead(
                config,
                weights,
                prior,
                jax.tree.map(lambda a, at=at: a[at], states),
                wrenches=np.asarray(sightings.wrench)[at : ends + 1],
                size=float(np.hypot(*condition.half_extents)),
                true=poses[ends, :2],
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
    setup: Setup[ObjectEstimateConfig], trial: Trial, pusher: PushController
) -> tuple[Sighting, np.ndarray, np.ndarray]:
    """Sensed samples ``[T, ...]`` of the robot's successive pushes, which of them begin a push ``[T]``, and the
    true poses ``[T, 3]`` of the object in {W}; NaN after the last push."""
    senses, config = senses_named(setup.options.senses), setup.config
    task = task_of(trial.condition, trial.goal_pose, pusher, seed=trial.seed)
    size = float(np.hypot(*trial.condition.half_extents))
    longest = round(config.seconds / DT)
    # Samples without a push have no pose, so the filter ignores them.
    three = (longest, 3)
    columns = (np.full(three, np.nan), np.zeros(three), np.zeros(longest), np.zeros(longest, bool), np.zeros(three))
    sightings = Sighting(*columns, np.full(longest, size))
    first, poses, count, pushed = np.zeros(longest, bool), np.full((longest, 3), np.nan), 0, False
    scene = scene_of_trial(trial, trial.condition, senses)
    with SensedEngine([scene], senses, trial.seed, poses_known=True) as engine:
        world = engine.init()
        obs = engine.observe(world)
        while not task.finished and float(obs.time[0]) < config.seconds:
            command = task.tick(obs)
            world, obs = engine.step(world, command)
            if engine.diverged(world)[0] or engine.fallen(world)[0]:
                break
            before, pushed = pushed, task.mode == Mode.PUSH
            if pushed and count < longest:
                of_object = (obs.object_pose, obs.object_twist, obs.object_age, obs.detected, obs.wrench)
                for column, value in zip(columns, of_object, strict=True):
                    column[count] = value[0, 0]
                first[count] = not before
                poses[count] = engine.true_observation(world).object_pose[0, 0]
                count += 1
    return sightings, first, poses


@cache
def _pusher(file: Path) -> PushController:
    return PushController(_weights(file), pose_push_config())


@cache
def _weights(file: Path) -> Weights:
    return load_weights(file)


@partial(jax.jit, static_argnums=0)
def _filter(config: EstimateConfig, prior: Any, sightings: Sighting, first: Any) -> tuple[Any, Any, ObjectEstimate]:
    """Bands ``[T, 3, 3]`` (low, median, high) of friction along x and y and of mass, the mean mass ``[T]``, and the
    posteriors after each sample without their constant fields."""

    def step(state: ObjectEstimate, sample: Any) -> tuple[ObjectEstimate, Any]:
        sighting, begins = sample
        state = estimate.step(config, state._replace(located=state.located & ~begins), sighting)
        friction = contact_model.resistance(state.parameters)
        quantities = jnp.concatenate([friction, jnp.exp(state.parameters[:, _MASS, None])], axis=-1)
        bands = estimate.quantiles(state, quantities, BAND)
        moving: dict[str, Any] = state._asdict() | {"prior": None, "key": None}
        return state, (bands, jnp.exp(estimate.mean(state)[_MASS]), ObjectEstimate(**moving))

    samples = jax.tree.map(lambda a: jnp.asarray(a, bool if a.dtype == bool else jnp.float32), sightings)
    filtered: tuple[Any, Any, ObjectEstimate] = jax.lax.scan(
        step, estimate.init(config, prior, jax.random.key(0)), (samples, jnp.asarray(first, bool))
    )[1]
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
