"""Experiment `robot_finetune`: R on another robot before and after five minutes of its data (Sec. III-D.3, Fig. 8).

A proxy robot with realistic sensing stands for the hardware (plant/perturbation.py, sensing): other parameters, delay,
noise, drift, and force from J tau only. Scripted operators push objects with it for five minutes. R is trained further
on these data and scored on another two minutes with other objects. Labels are the robot's own noisy measurements, as on
hardware. Training on eight times as much data shows how much can be learned. Then each robot pushes objects to goals,
as in the experiment `pushing`, with R before and after.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from shmoo_mjx.data import store
from shmoo_mjx.data.collect import CollectConfig, record
from shmoo_mjx.dynamics import core, features, robot_model
from shmoo_mjx.dynamics.robot_model import RobotParams
from shmoo_mjx.evaluation.experiment import Experiment, ExperimentConfig, Setup
from shmoo_mjx.evaluation.paired import OURS, difference_metrics
from shmoo_mjx.evaluation.pushing import PushingConfig
from shmoo_mjx.evaluation.pushing_trials import Runner, draw_trials
from shmoo_mjx.evaluation.result import ExperimentResult
from shmoo_mjx.evaluation.tables import Effect, Line, Section, Table, effects, lines_of, measured, number
from shmoo_mjx.geometry.hands import CONTACT_FORCE
from shmoo_mjx.learning import online, robot_fit
from shmoo_mjx.learning.robot_fit import RobotFitConfig, RobotSamples
from shmoo_mjx.learning.samples import samples_from_dataset
from shmoo_mjx.learning.weights import Weights, load_weights, posterior_from_recording
from shmoo_mjx.plant.objects import FAMILIES, draw_condition
from shmoo_mjx.report.style import SERIES, blank_figure, save_figure
from shmoo_mjx.sensing import SensedEngine, senses_named
from shmoo_mjx.types import SystemState

STEPS = 30
"""Length of the roll-outs [samples]."""

OUTPUTS = ("acceleration_x", "acceleration_y", "acceleration_yaw", "force_x", "force_y")


@dataclass(frozen=True)
class RobotFinetuneConfig(ExperimentConfig):
    """Size of the recordings and settings of the fine-tuning."""

    robots: int = 3
    """Number of robots. Each has its own seed and its own fine-tuning."""
    train_episodes: int = 8
    """Per family, of ``seconds`` each: 8 x 3 x 12.5 s = 5 minutes."""
    validation_episodes: int = 2
    """The last of these episodes, used for early stopping."""
    test_episodes: int = 3
    """Per family, each on an object of its own: 3 x 3 x 13.3 s = 2 minutes."""
    longer: int = 8
    """Factor of the episodes for a second fine-tuning on more data; 0 skips it."""
    seconds: float = 12.5
    test_seconds: float = 13.3
    pushed: int = 3
    """Objects per family that each robot pushes to each of three goals with R before and after; 0 skips this."""
    fit: RobotFitConfig = RobotFitConfig(
        batch=256,
        epochs=30,
        epoch_updates=50,
        learning_rate=2e-4,
        input_noise=0.1,
        weight_decay=1e-3,
        horizon=20,
        patience=8,
    )
    """Settings, chosen on the first two robots of condition seed 8000, which are not among the results."""
    most_epochs: int = 120
    """Most epochs of the fine-tuning on more data."""


MODELS = ("before", "after", "more")
"""Endings of the metrics of R as shipped, fine-tuned, and fine-tuned on more data."""


def _trial(setup: Setup[RobotFinetuneConfig], number: int) -> list[dict[str, Any]]:
    """Rows of one robot: those of the models, each followed by those of its pushes."""
    config, weights = setup.config, load_weights(setup.options.weights_file)
    robot_seed = setup.options.first_unseen + 10 * setup.options.seed + number
    train = _record(setup, robot_seed, config.train_episodes)
    test = _record(setup, robot_seed, config.test_episodes, test=True)
    robots = {"before": weights.params.robot, "after": _tuned(setup, weights, train, number)}
    if config.longer:
        train = _record(setup, robot_seed, config.longer * config.train_episodes)
        robots["more"] = _tuned(setup, weights, train, number, epochs=config.most_epochs)
    rows: list[dict[str, Any]] = []
    for label, robot in robots.items():
        mine = weights._replace(params=weights.params._replace(robot=robot))
        rows.append({"robot": number, "model": label} | _one_step(mine, test) | _roll_outs(mine, test))
        if label != "more":
            rows += [{"robot": number, "model": label} | row for row in _pushed(setup, mine, robot_seed)]
    return rows


def _pushed(setup: Setup[RobotFinetuneConfig], weights: Weights, robot_seed: int) -> list[dict[str, Any]]:
    """Rows of pushing trials by this robot. The trials are the same for every R."""
    runner = Runner(weights, PushingConfig().time_limit, senses_named(setup.options.senses))
    trials = draw_trials(setup.options.first_unseen, setup.options.seed, setup.config.pushed)
    rows = [runner.run(replace(trial, seed=robot_seed), OURS)[0] for trial in trials]
    return [{name: row[name] for name in ("trial", "offset_m", "yaw_error_deg", "success", "fell")} for row in rows]


def _tuned(
    setup: Setup[RobotFinetuneConfig], weights: Weights, train: store.Dataset, number: int, *, epochs: int | None = None
) -> RobotParams:
    """R after further training, for ``epochs`` or as in the config. The last episodes of each family are for early
    stopping, in the share given by the config."""
    config = setup.config
    episodes = len(train.names) // len(FAMILIES)
    kept = episodes - episodes * config.validation_episodes // config.train_episodes
    fit = replace(config.fit, robot=weights.config.robot, seed=setup.options.seed + number)
    return robot_fit.fit_samples(
        robot_fit.samples_from_dataset(_episodes(train, slice(0, kept))),
        robot_fit.samples_from_dataset(_episodes(train, slice(kept, None))),
        fit if epochs is None else replace(fit, epochs=epochs),
        start=weights.params.robot,
    ).params


def _record(setup: Setup[RobotFinetuneConfig], robot_seed: int, episodes: int, *, test: bool = False) -> store.Dataset:
    """Sensed recordings of the robot with this seed while operators push one object of each family per episode. The
    test has other objects and operators."""
    config, senses = setup.config, senses_named(setup.options.senses)
    settings = CollectConfig(
        episodes=1, seconds=config.test_seconds if test else config.seconds, seed=robot_seed + int(test)
    )
    names, conditions, arrays = [], [], []
    for k, family in enumerate(FAMILIES):
        seeds = [setup.options.first_unseen + 100 * (1 + int(test)) + i for i in range(episodes)]
        chunk = [draw_condition(family, seed) for seed in seeds]
        engine = partial(SensedEngine, senses=senses, seed=robot_seed, poses_known=True)
        recorded = record(settings, chunk, k, adjust=senses.adjust(robot_seed), engine_of=engine)
        for condition, values in zip(chunk, recorded, strict=True):
            names.append(f"{family}-{condition.seed}")
            conditions.append(condition.to_dict() | {"split": "test"})
            arrays.append(values)
    return store.Dataset(names, conditions, arrays, {})


def _episodes(dataset: store.Dataset, part: slice) -> store.Dataset:
    """Some of each family's recordings, by their place among them."""
    chosen = [
        i for family in FAMILIES for i in [k for k, c in enumerate(dataset.conditions) if c["family"] == family][part]
    ]
    return dataset.chosen(chosen)


def _one_step(weights: Weights, dataset: store.Dataset) -> dict[str, float]:
    """Mean squared error of each output in units of its variance over the test rows, in contact and free."""
    rows: RobotSamples = robot_fit.samples_from_dataset(dataset)
    base, force = robot_model.predict(weights.params.robot, jnp.asarray(rows.inputs), weights.config.robot)
    error = (np.asarray(jnp.concatenate([base, force], axis=-1)) - rows.labels) ** 2 / rows.labels.var(axis=0)
    touching = np.hypot(*rows.inputs[:, features.slices(features.ROBOT_INPUTS)["last_force"]].T) > CONTACT_FORCE
    errors = {f"mse_{name}": float(error[:, i].mean()) for i, name in enumerate(OUTPUTS)}
    errors |= {"mse_contact": float(error[touching].mean()), "mse_free": float(error[~touching].mean())}
    return errors | {"mse": float(error.mean())}


def _roll_outs(weights: Weights, dataset: store.Dataset) -> dict[str, float]:
    """Root mean squared error of the robot's position 3 s ahead under the recorded commands [m], every 1 s.

    The object moves by psi with coefficients fitted to its own recording, the same before and after.
    """
    rows = jax.tree.map(jnp.asarray, samples_from_dataset(dataset))
    params, config = weights.params, weights.config
    rollout = jax.jit(lambda p, s, u: core.rollout(p, s, u, config)[0])
    learner = online.learner(config.object)
    square: dict[str, list[float]] = {"contact": [], "free": []}
    for i, arrays in enumerate(dataset.arrays):
        posterior = posterior_from_recording(weights, rows.inputs[i], rows.labels[i], rows.weights[i])
        adapted = learner.params_for_rollout(posterior, params)
        samples = store.system_states(arrays)
        starts = np.arange(1, samples.u.shape[1] - STEPS, 10)
        start = SystemState(*(np.asarray(v)[0, starts] for v in samples.state))
        controls = np.stack([samples.u[0, s : s + STEPS] for s in starts])
        ends = rollout(adapted, start, controls).robot_pose[:, -1]
        truth = arrays["robot_pose"][0, starts + STEPS]
        touched = [samples.contact[0, s : s + STEPS].mean() >= 0.5 for s in starts]
        for miss, touch in zip(np.sum((np.asarray(ends) - truth)[:, :2] ** 2, axis=-1), touched, strict=True):
            square["contact" if touch else "free"].append(float(miss))
    return {f"pos_rmse_3s_{k}_m": float(np.sqrt(np.mean(v))) if v else np.nan for k, v in square.items()}


def _metrics(rows: list[dict[str, Any]]) -> dict[str, float]:
    """Means over the robots. Reductions are those of the means."""
    pushes, rows = [row for row in rows if "trial" in row], [row for row in rows if "trial" not in row]
    measures = [name for name in rows[0] if name not in ("robot", "model")]
    of = {model: mine for model in MODELS if (mine := [row for row in rows if row["model"] == model])}
    metrics: dict[str, float] = {}
    for name in measures:
        metrics |= {f"{name}_{model}": float(np.nanmean([row[name] for row in of[model]])) for model in of}
    for model, suffix in (("after", ""), ("more", "_more")):
        if model not in of:
            continue
        lower = [100 * (1 - row["mse"] / first["mse"]) for first, row in zip(of["before"], of[model], strict=True)]
        metrics[f"reduction_percent{suffix}"] = 100 * (1 - metrics[f"mse_{model}"] / metrics["mse_before"])
        metrics[f"reduction_percent{suffix}_std"] = float(np.std(lower))
        for name in OUTPUTS:
            ratio = metrics[f"mse_{name}_{model}"] / metrics[f"mse_{name}_before"]
            metrics[f"reduction_percent_{name}{suffix}"] = 100 * (1 - ratio)
    before, after = ([row for row in pushes if row["model"] == model] for model in MODELS[:2])
    for name in ("success", "offset_m", "yaw_error_deg") if pushes else ():
        metrics |= {f"{name}_before": float(np.mean([row[name] for row in before]))}
        metrics |= {f"{name}_after": float(np.mean([row[name] for row in after]))}
        metrics |= difference_metrics(f"{name}_difference", name, list(zip(after, before, strict=True)))
    return metrics


def _draw(setup: Setup[RobotFinetuneConfig], rows: list[dict[str, Any]]) -> None:
    """Draw the error of each output with each R."""
    metrics = _metrics(rows)
    figure = blank_figure(7.0, 3.2)
    axis = figure.subplots()
    names = (*OUTPUTS, "contact", "free")
    place = np.arange(len(names))
    labels = ("before fine-tuning", "after", "after, on more data")
    for shift, model, colour, label in zip((-1, 0, 1), MODELS, (SERIES[1], SERIES[0], SERIES[4]), labels, strict=True):
        if f"mse_{model}" in metrics:
            heights = [metrics[f"mse_{name}_{model}"] for name in names]
            axis.bar(place + 0.27 * shift, heights, width=0.27, color=colour, label=label)
    axis.set_xticks(place, [name.replace("_", "\n") for name in names], fontsize=8)
    axis.set_ylabel("squared error over variance")
    axis.legend(fontsize=8)
    save_figure(setup.folder / "robot_finetune.png", figure, 130)


def _shows(result: ExperimentResult) -> str:
    contact = [number(measured(result, f"pos_rmse_3s_contact_m_{model}")) for model in MODELS[:2]]
    pushes = [
        Effect("the success rate", "success_difference", "points", 100.0),
        Effect("the distance", "offset_m_difference", "cm", 100.0),
    ]
    return (
        f"Five minutes of another robot's data lower the one-step error by {number(measured(result, _REDUCED))} %; the "
        f"paper reports {result.paper.get(_REDUCED, 27.3):g} %. The error after 3 s in contact goes from {contact[0]} "
        f"to {contact[1]} m. {effects(result, 'In closed-loop pushing, fine-tuning', '', pushes)}"
    )


_REDUCED = "reduction_percent"

EXPERIMENT = Experiment(
    Section(
        "Fine-tuning the robot's model",
        "How much do five minutes of data from another robot improve its model R? (Sec. III-D.3, Fig. 8 of the paper)",
        (
            Table(
                ("before", "after 5 minutes", "after 40 minutes"),
                (
                    Line("Reduction of the mean squared error [%]", ("", _REDUCED, f"{_REDUCED}_more")),
                    *lines_of(
                        {
                            "mse": "Mean squared error, all outputs",
                            "pos_rmse_3s_contact_m": "Position error after 3 s in contact [m]",
                            "success": "Success rate of pushing to a pose",
                            "offset_m": "Distance from the goal after pushing [m]",
                        },
                        *("{}_before", "{}_after", "{}_more"),
                    ),
                ),
            ),
            Table(
                ("before", "after 5 minutes", "after 40 minutes"),
                (
                    *lines_of(
                        {
                            "mse_contact": "Mean squared error in contact",
                            "mse_free": "Mean squared error without contact",
                            "pos_rmse_3s_free_m": "Position error after 3 s without contact [m]",
                            "yaw_error_deg": "Yaw error after pushing [deg]",
                        },
                        *("{}_before", "{}_after", "{}_more"),
                    ),
                    *lines_of(
                        {name: f"Reduction of the error, {name.replace('_', ' ')} [%]" for name in OUTPUTS},
                        *("", "reduction_percent_{}", "reduction_percent_{}_more"),
                    ),
                    *lines_of(
                        {
                            "success": "Success rate of pushing, after minus before",
                            "offset_m": "Distance after pushing, after minus before [m]",
                        },
                        *("", "{}_difference", ""),
                    ),
                ),
            ),
        ),
        _shows,
        {"robot_finetune.png": "Error of each output of R before and after fine-tuning"},
    ),
    RobotFinetuneConfig(),
    quick=RobotFinetuneConfig(
        robots=1, train_episodes=2, validation_episodes=1, test_episodes=1, longer=2, pushed=0, most_epochs=5
    ),
    trials=lambda setup: {f"robot-{i}": i for i in range(setup.config.robots)},
    trial=_trial,
    metrics=lambda setup, rows: _metrics(rows),
    draw=_draw,
    neutral=("robots",),
    paper={"reduction_percent": 27.3},  # Sec. III-D.3
)
