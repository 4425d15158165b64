"""Experiment `estimate`: what the posterior over an object's dynamics says of unseen objects, and whether it is so.

Scripted operators push objects as they are drawn, heavy ones and locked wheels included, with the robot's own senses.
After some seconds of contact, the posterior's median is compared with the truth of the simulator (`contact_prior`), and
how often its 80 % band holds the truth is counted.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cache, partial
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from shmoo_mjx.data.collect import drive, operators
from shmoo_mjx.dynamics import contact_model
from shmoo_mjx.evaluation.result import ExperimentOptions, ExperimentResult, make_result
from shmoo_mjx.evaluation.trials import run_trials
from shmoo_mjx.fingerprints import fingerprint
from shmoo_mjx.hands import HAND_HEIGHT, REACH, touches
from shmoo_mjx.learning import contact_prior, estimate
from shmoo_mjx.learning.estimate import EstimateConfig, ObjectEstimate, Sighting
from shmoo_mjx.learning.online import BAND
from shmoo_mjx.learning.weights import load_weights
from shmoo_mjx.options import SensesName
from shmoo_mjx.plant.condition import Condition
from shmoo_mjx.plant.objects import FAMILIES, draw_condition
from shmoo_mjx.plant.scene import build_scene
from shmoo_mjx.sensing import senses_named
from shmoo_mjx.sensing.engine import SensedEngine
from shmoo_mjx.types import DT, Command

SECONDS = (1.0, 3.0, 10.0)
"""Of contact, after which the estimate is looked at [s]."""
_MASS = contact_model.PARAMETERS.index("log_mass")
JUMP = 1.5
"""Ratio of the masses of two samples in a row from which on the estimate has jumped."""


@dataclass(frozen=True)
class ObjectEstimateConfig:
    """Size of the experiment."""

    objects: int = 20
    """Of each family."""
    seconds: float = 40.0
    """Length of a recording [s]."""
    speeds: tuple[float, float] = (0.06, 0.3)
    """Range of the operators' speeds [m/s]: they push steadily, as the controller does."""
    estimate: EstimateConfig = field(default_factory=EstimateConfig)
    workers: int = 2


class _Asked(NamedTuple):
    """What a worker is told of the experiment's options."""

    seed: int
    first_unseen: int
    senses: SensesName
    weights: Path | None


def run(options: ExperimentOptions) -> ExperimentResult:
    """Record and estimate; goes on from ``options.out`` after a stop."""
    config = ObjectEstimateConfig(objects=2, seconds=15.0) if options.quick else ObjectEstimateConfig()
    identity = fingerprint(__name__, (config, options.seed, options.first_unseen, options.senses))
    folder = options.out / "estimate" / identity[:10]
    chunks = range(0, config.objects, 5)
    trials = {f"{family}-{first}": (family, first) for family in FAMILIES for first in chunks}
    rows = run_trials(
        trials,
        partial(_trial, _Asked(options.seed, options.first_unseen, options.senses, options.weights), config),
        folder,
        options.progress,
        config.workers,
    )
    return make_result("estimate", options, config, _metrics(rows), {}, rows)


def _trial(asked: _Asked, config: ObjectEstimateConfig, trial: tuple[str, int]) -> list[dict[str, Any]]:
    """One row for some objects and each of SECONDS that their recording has."""
    family, first = trial
    count = min(5, config.objects - first)
    seeds = [asked.first_unseen + first + i for i in range(count)]
    conditions = [draw_condition(family, seed) for seed in seeds]
    seen, axes = _recorded(asked, config, conditions, seeds)
    bands, masses = (
        np.asarray(a) for a in _filter(config.estimate, contact_prior.of_kind(_prior(asked.weights), family), seen)
    )
    contact = np.cumsum(touches(seen.wrench) & seen.detected, axis=1)
    rows = []
    for i, condition in enumerate(conditions):
        truth = contact_prior.parameters_of(condition)
        true = np.log(
            [contact_model.resistance(truth)[axes[i]], np.exp(truth[contact_model.PARAMETERS.index("log_mass")])]
        )
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
            rows.append(row)
    return rows


def _recorded(
    asked: _Asked, config: ObjectEstimateConfig, conditions: list[Condition], seeds: list[int]
) -> tuple[Sighting, np.ndarray]:
    """What is perceived ``[W, T, ...]`` of W objects that operators push, and the axis of {O} that each is pushed along
    (0 or 1)."""
    senses, count = senses_named(asked.senses), len(conditions)
    rng = np.random.default_rng([asked.seed, *seeds[:1], FAMILIES.index(conditions[0].family)])
    half_extents = [c.half_extents for c in conditions]
    operator, poses = operators(rng, count, half_extents)
    operator = operator._replace(liveliness=np.full(count, 0.4))
    scenes = [
        build_scene([(c, (0.0, 0.0, 0.0))], pose.tolist(), adjust=senses.adjust(seed))
        for c, pose, seed in zip(conditions, poses, seeds, strict=True)
    ]
    sizes, columns = np.hypot(*np.array(half_extents).T), []
    with SensedEngine(scenes, senses, seeds, poses_known=True) as engine:
        ones = np.ones(count)
        still = Command(np.zeros((count, 3)), poses[:, 2], REACH * ones, HAND_HEIGHT * ones)
        world, seen = engine.step(engine.init(), still, 1.0)
        for _ in range(round(config.seconds / DT)):
            operator, command = drive(rng, operator, seen)
            operator = operator._replace(speed=np.clip(operator.speed, *config.speeds))
            world, seen = engine.step(world, command)
            of_object = (seen.object_pose, seen.object_twist, seen.object_age, seen.detected, seen.wrench)
            pose, twist, age, detected, wrench = (np.asarray(value[:, 0]) for value in of_object)
            columns.append(Sighting(pose, twist, age, detected, wrench, sizes))
    stacked = jax.tree.map(lambda *column: np.stack(column, axis=1), *columns)
    return stacked, (np.abs(np.cos(operator.face[:, 2])) < 0.5).astype(int)


@cache
def _prior(weights: Path | None) -> Any:
    return load_weights(weights).contact_prior


@partial(jax.jit, static_argnums=0)
def _filter(config: EstimateConfig, prior: Any, seen: Sighting) -> tuple[Any, Any]:
    """Bands ``[W, T, 3, 3]`` (low, median, high) of friction along x and y and of mass, the mean mass ``[W, T]``."""

    def step(state: ObjectEstimate, sample: Sighting) -> tuple[ObjectEstimate, Any]:
        state = estimate.step(config, state, sample)
        friction = contact_model.resistance(state.parameters)
        told = jnp.concatenate([friction, jnp.exp(state.parameters[:, _MASS, None])], axis=-1)
        return state, (estimate.quantiles(state, told, BAND), jnp.exp(estimate.mean(state)[_MASS]))

    def one(samples: Sighting, key: Any) -> Any:
        return jax.lax.scan(step, estimate.init(config, prior, key), samples)[1]

    samples = jax.tree.map(lambda a: jnp.asarray(a, bool if a.dtype == bool else jnp.float32), seen)
    bands: tuple[Any, Any] = jax.vmap(one)(samples, jax.random.split(jax.random.key(0), len(seen.size)))
    return bands


def _metrics(rows: list[dict[str, Any]]) -> dict[str, float]:
    """Median errors, shares of true values in the 80 % band, and the median number of jumps."""
    found: dict[str, float] = {}
    for family in FAMILIES:
        for seconds in SECONDS:
            mine = [r for r in rows if r["family"] == family and r["contact_s"] == seconds]
            for name in ("friction", "mass"):
                suffix = f"{family}_{seconds:g}s"
                found[f"{name}_error_{suffix}"] = (
                    float(np.median([r[f"{name}_error"] for r in mine])) if mine else np.nan
                )
                found[f"{name}_coverage_{suffix}"] = (
                    float(np.mean([r[f"{name}_covered"] for r in mine])) if mine else np.nan
                )
        jumps = {r["seed"]: r["jumps"] for r in rows if r["family"] == family}
        found[f"jumps_{family}"] = float(np.median([*jumps.values()] or [np.nan]))
    return found
