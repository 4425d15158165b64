"""Experiment `ablations`: what each choice in learning psi brings, one changed at a time, and how much psi gives away.

Trainings of psi as long as the shipped one, a few seeds each, scored on unseen objects by the protocol of `scoring`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from shmoo_mjx.data import store
from shmoo_mjx.evaluation import datasets, probe, scoring
from shmoo_mjx.evaluation.result import ExperimentOptions, ExperimentResult, make_result, over_seeds
from shmoo_mjx.evaluation.trials import run_trials
from shmoo_mjx.fingerprints import fingerprint
from shmoo_mjx.learning import daiml
from shmoo_mjx.learning.baselines import Budget, Job, Predictor, Recordings, recordings
from shmoo_mjx.learning.baselines.adaptive import daiml_config, from_fit
from shmoo_mjx.learning.baselines.protocol import output_scale
from shmoo_mjx.learning.daiml import DaimlConfig
from shmoo_mjx.types import DT

__all__ = ["VARIANTS", "AblationsConfig", "run"]

VARIANTS: dict[str, dict[str, Any]] = {
    "default": {},
    "horizon_1": {"horizon": 1},
    "horizon_5": {"horizon": 5},
    "horizon_15": {"horizon": 15},
    "horizon_30": {"horizon": 30},
    "horizon_15_forced": {"horizon": 15, "open_loop": False},
    "plain_ridge": {"coupled": False},
    "shared_functions": {"per_axis": False},
    "no_linear_terms": {"linear_terms": False},
    "no_body": {"body": False},
    "no_last_wrench": {"last_wrench": False},
    "functions_3": {"functions": 3},
    "functions_6": {"functions": 6},
    "functions_24": {"functions": 24},
    "alpha_0": {"alpha": 0.0},
    "alpha_0.01": {"alpha": 0.01},
    "alpha_0.1": {"alpha": 0.1},
    "alpha_1": {"alpha": 1.0},
}
"""Name -> what differs from the shipped settings of DAIML."""


@dataclass(frozen=True)
class AblationsConfig:
    """What is varied and how long each variant trains."""

    variants: tuple[str, ...] = tuple(VARIANTS)
    budget: Budget = field(default_factory=lambda: Budget(24, 150, 12))
    """As long as the shipped training: shorter ones prefer settings that a long one does not."""
    seeds: int = 2
    fit_seconds: tuple[float, ...] = (5.0, 10.0, 25.0)
    """Recording that the default variant adapts on [s]; the others take the longest. All are scored on later rows."""
    probes: int = 3
    """Probes with seeds of their own, for each psi."""
    probe_updates: int = 1500
    training_objects: int | None = None
    """Per family; None takes all that the training set has."""
    unseen: Mapping[str, int] = field(default_factory=lambda: dict(datasets.UNSEEN_COUNTS))
    workers: int = 1
    """Processes. One training keeps two cores busy by itself."""


QUICK = AblationsConfig(
    variants=("default", "horizon_15_forced", "functions_3", "alpha_0", "alpha_0.1"),
    budget=Budget(2, 100, 2),
    seeds=1,
    probes=1,
    probe_updates=300,
    training_objects=6,
    unseen={"box": 2, "cart": 2, "wheelchair": 2},
)


@dataclass(frozen=True)
class _Work:
    """One variant with one seed; called with "VARIANT-SEED", or "raw-SEED" for probes on the inputs themselves."""

    train: Path
    unseen: Path
    folder: Path
    config: AblationsConfig
    seed: int

    def __call__(self, name: str) -> list[dict[str, Any]]:
        variant, number = name.rsplit("-", 1)
        dataset = store.of_training(self.train)
        scale = output_scale(recordings(dataset.split("train")).rows)
        if self.config.training_objects is not None:
            dataset = datasets.subset(dataset, self.config.training_objects)
        parts = [dataset.split("train"), dataset.split("validation"), store.read(self.unseen, splits=("test",))]
        train, validation, unseen = (recordings(part) for part in parts)
        label = {"variant": variant, "run": int(number)}
        if variant == "raw":
            raw = {"inputs": train.rows.inputs, "inputs_without_size": probe.raw_without_size(train.rows)}
            found = {f"probe_{what}": self._probe(values, train.rows.weights) for what, values in raw.items()}
            return [label | found | {"chance": 1 / len(train.rows.inputs)}]
        job = Job(
            train,
            validation,
            VARIANTS[variant],
            self.config.budget,
            self.seed + int(number),
            self._rows(max(self.config.fit_seconds)),
        )
        config = daiml_config(job, DaimlConfig())
        # Variants that come to the same settings, as alpha_0.01 and the default do, share one training.
        directory = self.folder / "training" / fingerprint(__name__, asdict(config))
        fitted = daiml.fit_rows(train.rows, validation.rows, config, directory)
        rows = self._scored(from_fit(fitted, config), unseen, scale, label, variant)
        if variant.startswith("alpha"):
            psi = probe.psi_of(fitted, config, train.rows)
            rows[0]["probe_psi"] = self._probe(psi, train.rows.weights)
        return rows

    def _scored(
        self, predictor: Predictor, recorded: Recordings, scale: np.ndarray, label: dict[str, Any], variant: str
    ) -> list[dict[str, Any]]:
        """One row for each time to adapt; the variants but the default take the longest only."""
        longest = max(self.config.fit_seconds)
        times = self.config.fit_seconds if variant == "default" else (longest,)
        rows = []
        for seconds in times:
            scores = scoring.score(predictor, recorded, scale, self._rows(seconds), self._rows(longest))
            # The mean hangs on objects that hardly move.
            median = {"fvu_median": float(np.nanmedian(scores["fvu"]))}
            rows.append(label | {"fit_seconds": seconds} | scoring.average(scores) | median)
        return rows

    def _probe(self, values: Any, weights: Any) -> float:
        probes = range(self.config.probes)
        return float(np.mean([probe.accuracy(values, weights, seed, self.config.probe_updates) for seed in probes]))

    @staticmethod
    def _rows(seconds: float) -> int:
        return round(seconds / DT)


def run(options: ExperimentOptions, config: AblationsConfig | None = None) -> ExperimentResult:
    """Train and score every variant; goes on from ``options.out`` after a stop."""
    config = config or (QUICK if options.quick else AblationsConfig())
    train = datasets.training_directory(options)
    unseen = datasets.unseen_directory(options, config.unseen)
    manifests = [directory / store.MANIFEST for directory in (train, unseen)]
    key = asdict(replace(config, workers=1, seeds=1, variants=())) | {"seed": options.seed}
    folder = options.out / "ablations" / fingerprint(__name__, key, *manifests)
    names = ["raw-0", *(f"{variant}-{seed}" for variant in config.variants for seed in range(config.seeds))]
    rows = run_trials(
        names, _Work(train, unseen, folder, config, options.seed), folder, options.progress, workers=config.workers
    )
    result = make_result("ablations", options, config, _metrics(rows, config), {}, rows)
    _figure(result, options.out / "ablations" / "domain_invariance.png")
    return result


def _metrics(rows: list[dict[str, Any]], config: AblationsConfig) -> dict[str, float]:
    """Mean and spread over the seeds; the names of the variants with 5 s and 10 s to adapt end so."""
    metrics: dict[str, float] = {}
    measures = ("mse", "fvu", "fvu_median", "pos_rmse_3s_m", "yaw_rmse_3s_deg", "probe_psi")
    longest = max(config.fit_seconds)
    groups: dict[str, list[dict[str, Any]]] = {}
    for row in rows:
        seconds = row.get("fit_seconds", longest)
        groups.setdefault(row["variant"] + (f"_{seconds:g}s" if seconds != longest else ""), []).append(row)
    raw = groups.pop("raw")[0]
    for name, mine in groups.items():
        for measure in measures:
            metrics |= over_seeds(measure, name, [row.get(measure, np.nan) for row in mine])
    return metrics | {name: raw[name] for name in ("chance", "probe_inputs", "probe_inputs_without_size")}


def _figure(result: ExperimentResult, path: Path) -> None:
    """Accuracy of the probe, and error on unseen objects, over the adversary's weight alpha."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    found = result.metrics
    names = [name for name in VARIANTS if name.startswith("alpha") and f"probe_psi_{name}" in found]
    places = range(len(names))
    figure, (left, right) = pyplot.subplots(1, 2, figsize=(8.0, 3.2), constrained_layout=True)
    for axes, measure in ((left, "probe_psi"), (right, "fvu_median")):
        means, spread = ([found[f"{measure}{kind}_{name}"] or 0.0 for name in names] for kind in ("", "_std"))
        axes.errorbar(places, means, spread, marker="o", capsize=3, color="#0072B2", label="psi")
        axes.set(xticks=places, xticklabels=[n.removeprefix("alpha_") for n in names], xlabel="alpha")
    for name, label, style in (
        ("probe_inputs", "raw inputs", "-"),
        ("probe_inputs_without_size", "raw inputs without size", "--"),
        ("chance", "chance", ":"),
    ):
        left.axhline(found[name] or 0.0, color="#555555", linestyle=style, linewidth=1.0, label=label)
    left.set(ylabel="conditions told by a fresh probe", ylim=(0, None))
    left.legend(fontsize=7)
    right.set(ylabel="fraction of variance unexplained", ylim=(0, None), title="the median unseen object")
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=130)
    pyplot.close(figure)
