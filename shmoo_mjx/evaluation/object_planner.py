"""Experiment object_planner: can the robot tell, within seconds of touching it, whether an object can be moved?

Unseen objects, half of them not manipulable, stand alone on open floor in the robot's way. The navigator runs as it is,
from the approach to the first planning stage of Algorithm 1; the truth is the plant's (``manipulable``). Beside the
paper's K other criteria are measured on the same touches.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from shmoo_mjx import se2
from shmoo_mjx.assets import WEIGHTS, asset
from shmoo_mjx.evaluation.manipulable import IMMOVABLE, SteadyPush, draw_immovable, manipulable, steady_push
from shmoo_mjx.evaluation.result import ExperimentOptions, ExperimentResult, make_result
from shmoo_mjx.evaluation.scenarios import entry_of
from shmoo_mjx.evaluation.trials import run_trials
from shmoo_mjx.faces import faces_of
from shmoo_mjx.fingerprints import fingerprint
from shmoo_mjx.navigation.maps import OCCUPIED, OccupancyGrid
from shmoo_mjx.navigation.records import Mode, NavigatorConfig
from shmoo_mjx.navigation.scenario import Limits, Scenario
from shmoo_mjx.plant.objects import FAMILIES, Condition, draw_condition
from shmoo_mjx.types import DT, SensesName

__all__ = ["CRITERIA", "ObjectPlannerTrials", "auc", "held_out_accuracy", "run"]

Array = Any

CRITERIA = ("K", "K_first", "K_posterior", "moved_m", "mobility")
"""K of Algorithm 1 when the verdict fell; after the first second, as the paper has it; then the median K over draws of
the coefficients from their posterior; how far the probe has moved the object; that over the impulse of the hands. The
last two need no model."""


@dataclass(frozen=True)
class ObjectPlannerTrials:
    """What is tried."""

    objects: int = 60
    """Half of them manipulable."""
    time_s: float = 40.0
    """Longest trial [s]."""
    draws: int = 16
    """Draws of the coefficients from their posterior."""
    workers: int = 2
    truth: SteadyPush = SteadyPush()


QUICK = ObjectPlannerTrials(objects=8)


def run(options: ExperimentOptions) -> ExperimentResult:
    """Run the experiment; figures go to ``options.out / object_planner``."""
    from shmoo_mjx.evaluation.object_planner_figures import draw_figures

    cfg = QUICK if options.quick else ObjectPlannerTrials()
    weights = options.weights or asset(WEIGHTS)
    about = {"seed": options.seed, "senses": options.senses, "navigator": asdict(navigator_config())}
    settings = asdict(replace(cfg, objects=0)) | about
    folder = options.out / "object_planner"
    # The trials of a quick run are the first ones of a full run.
    settings |= {"condition_seed": options.condition_seed}
    store = folder / f"trials-{fingerprint(__name__, settings, weights)}"
    names = [f"{i:03d}" for i in range(cfg.objects)]
    work = partial(_trial, cfg, options.first_unseen, options.seed, weights, options.senses)
    rows = run_trials(names, work, store, options.progress, cfg.workers)
    draw_figures(folder, rows, partial(fig5_episodes, weights, options.seed, options.senses))
    return make_result("object_planner", options, cfg, measure(rows), {}, rows)


def navigator_config() -> NavigatorConfig:
    """The navigator as it is, but on open floor it must not just walk round the object."""
    return NavigatorConfig(goes_round=False)


def open_floor(length: float = 9.0, width: float = 7.0, resolution: float = 0.05) -> OccupancyGrid:
    """A room with nothing in it."""
    cells = np.zeros((round(width / resolution), round(length / resolution)), dtype=np.int8)
    cells[:2] = cells[-2:] = cells[:, :2] = cells[:, -2:] = OCCUPIED
    return OccupancyGrid(cells, resolution)


def open_floor_scenario(condition: Condition, side: int, seed: int, time_s: float) -> Scenario:
    """The object in the middle of ``open_floor``, face ``side`` towards the robot, a little askew."""
    rng = np.random.default_rng([seed, 7])
    yaw = float(se2.wrap(-faces_of(condition.half_extents)[side][2] + rng.uniform(-0.15, 0.15)))
    return Scenario(
        start=(1.2, 3.5 + round(rng.uniform(-0.2, 0.2), 3), 0.0),
        goal=(7.8, 3.5),
        objects=(entry_of(condition, (3.6, 3.5, yaw)),),
        seed=seed,
        limits=Limits(time_s=time_s),
    )


def draw_object(index: int, first_seed: int, cfg: SteadyPush) -> tuple[Condition, int, str]:
    """(condition, side, kind) of object ``index``: even ones are manipulable on that side, odd ones are not.

    Families and kinds take turns. Whatever the plant says to be otherwise than its kind is drawn again.
    """
    family = FAMILIES[(index // 2) % 3]
    kind = "drawn" if index % 2 == 0 else IMMOVABLE[(index // 6) % 3]
    for seed in _seeds(index, first_seed):
        side = int(np.random.default_rng([seed, 1]).integers(4))
        condition = draw_condition(family, seed) if kind == "drawn" else draw_immovable(kind, family, seed)
        if manipulable(condition, side, cfg) == (kind == "drawn"):
            return condition, side, kind
    raise AssertionError("every object that was drawn is the other kind")


def _seeds(index: int, first_seed: int) -> Iterator[int]:
    """Sixteen seeds for each object, in two blocks, so that one object's redraws do not change the next one."""
    # Both lie within the 1,000 seeds of a condition seed, for up to 62 objects.
    blocks = (first_seed + 8 * index, first_seed + 500 + 8 * index)
    return itertools.chain.from_iterable(range(first, first + 8) for first in blocks)


def _trial(
    cfg: ObjectPlannerTrials, first_seed: int, seed: int, weights: Path, senses: SensesName, name: str
) -> list[dict[str, Any]]:
    from shmoo_mjx.episode import Hooks, run_episode

    condition, side, kind = draw_object(int(name), first_seed, cfg.truth)
    scenario = open_floor_scenario(condition, side, 1000 * seed + int(name), cfg.time_s)
    controller = _controller(weights)
    evidence: dict[str, Any] = {}

    def decided(navigator: Any) -> bool:
        if navigator.decisions and not evidence:
            evidence.update(_evidence(navigator, controller, cfg, scenario.seed))
        return navigator.belief.objects[0].manipulable is not None if navigator.belief.objects else False

    episode = run_episode(open_floor(), scenario, controller, navigator_config(), Hooks(over=decided), senses=senses)
    row = {"object": int(name), "family": condition.family, "kind": kind, "description": condition.describe()}
    row |= {"outcome": episode.result["outcome"], "transitions": len(episode.result["transitions"])}
    contacts = [t["t"] for t in episode.result["transitions"] if t["to"] == str(Mode.PROBE)]
    truth = steady_push(condition, evidence.get("side", side), cfg.truth)
    row |= {"side": side, "manipulable": truth >= cfg.truth.distance, "truth_m": truth, "decided": None} | evidence
    if episode.navigator.belief.objects[0].manipulable is None:
        return [row]
    # An object that it had to touch again is timed from the first touch.
    begin, last = contacts[0], episode.result["decisions"][-1]
    span = (episode.trace.t >= begin) & (episode.trace.t <= last["t"])
    seen = episode.recorded.observations
    impulse = float(np.hypot(*seen.wrench[span, 0, 0, :2].T).sum() * DT)
    moved = _moved(episode.trace.t, seen.object_pose[:, 0, 0, :2], begin, last["t"])
    return [
        row
        | {
            "decided": last["manipulable"],
            "K": last["K"],
            "decision_time_s": last["t"] - begin,
            "moved_m": moved,
            "impulse_Ns": impulse,
            "mobility": moved / max(impulse, 1.0),
        }
    ]


def _moved(times: np.ndarray, poses: np.ndarray, begin: float, end: float) -> float:
    """How far the object has moved as the robot perceived it [m]."""
    a, b = (int(np.searchsorted(times, t - 1e-6)) for t in (begin, end))
    return float(np.linalg.norm(poses[min(b, len(poses) - 1)] - poses[a]))


def _evidence(navigator: Any, controller: Any, cfg: ObjectPlannerTrials, seed: int) -> dict[str, Any]:
    """The decision, and K again with coefficients drawn from their posterior."""
    decision, segment = navigator.decisions[0], navigator.segment
    known = navigator.belief.objects[decision.object]
    adapt = segment.push.pusher.adapt
    rng = np.random.default_rng([seed, 11])
    # The square root by eigenvalues bears a covariance that rounding has made slightly indefinite.
    values, vectors = np.linalg.eigh(np.asarray(adapt.covariance, dtype=float))
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    drawn = []
    for _ in range(cfg.draws):
        mean = np.asarray(adapt.mean) + (root @ rng.normal(size=len(values))).astype(np.float32)
        state = segment.push.pusher._replace(adapt=adapt._replace(mean=mean))
        poses, _, costs = controller.planning_rollouts(
            state, decision.asked, segment.around, np.array(known.half_extents)
        )
        drawn.append(_k(poses, costs, known.pose, navigator.config.planner.best))
    quantiles = np.quantile(drawn, [0.1, 0.5, 0.9])
    return {
        "side": segment.side,
        "K_first": decision.K,
        "G_first": decision.G,
        "first_decided": decision.manipulable,
        "K_posterior_10": quantiles[0],
        "K_posterior": quantiles[1],
        "K_posterior_90": quantiles[2],
        "asked_m": float(np.linalg.norm(decision.asked[:2] - known.pose[:2])),
        "fastest_rollout": float(np.linalg.norm(np.diff(decision.rollouts[:3], axis=1), axis=-1).max() / 0.1),
    }


def _k(poses: np.ndarray, costs: np.ndarray, pose: np.ndarray, count: int) -> float:
    finite = np.isfinite(costs) & np.isfinite(poses).all(axis=(1, 2))
    if not finite.any():
        return 0.0
    best = poses[finite][np.argsort(costs[finite])[:count], -1, :2]
    return float(np.sum((best - pose[:2]) ** 2))


def measure(rows: list[dict[str, Any]]) -> dict[str, float]:
    """Accuracy, times and the comparison of the criteria."""
    found = [r for r in rows if r["decided"] is not None]
    right = [r["decided"] == r["manipulable"] for r in found]
    times = np.array([r["decision_time_s"] for r in found])
    metrics = {
        # An object that no decision was made about counts as a mistake.
        "accuracy": sum(right) / len(rows),
        "accuracy_after_1s": sum(r.get("first_decided") == r["manipulable"] for r in rows) / len(rows),
        "undecided": len(rows) - len(found),
        "decision_time_s": float(np.median(times)),
        "decision_time_90_s": float(np.quantile(times, 0.9)),
        "decided_within_3s": float(np.mean(times <= 3.0)),
        "K_threshold": NavigatorConfig().planner.threshold,
    }
    for truth, name in ((True, "manipulable"), (False, "immovable")):
        of = [r for r in found if r["manipulable"] == truth]
        metrics[f"{name}_called_manipulable"] = sum(r["decided"] for r in of)
        metrics[f"{name}_called_immovable"] = sum(not r["decided"] for r in of)
        metrics[f"{name}_K_median"] = float(np.median([r["K"] for r in of])) if of else np.nan
    truths = np.array([r["manipulable"] for r in found])
    for criterion in CRITERIA:
        values = np.array([r[criterion] for r in found], dtype=float)
        metrics[f"auc_{criterion}"] = auc(values, truths)
        metrics[f"accuracy_best_threshold_{criterion}"] = held_out_accuracy(values, truths)
    return metrics


def auc(values: np.ndarray, truth: np.ndarray) -> float:
    """Chance that a manipulable object has the larger value: 1 separates the classes, 0.5 says nothing."""
    positive, negative = values[truth], values[~truth]
    if not positive.size or not negative.size:
        return float("nan")
    above = (positive[:, None] > negative).mean() + 0.5 * (positive[:, None] == negative).mean()
    return float(above)


def held_out_accuracy(values: np.ndarray, truth: np.ndarray) -> float:
    """Accuracy of a threshold on ``values``, chosen for each object on all the others."""
    right = []
    for i in range(len(values)):
        others = np.arange(len(values)) != i
        right.append((values[i] >= _best_threshold(values[others], truth[others])) == truth[i])
    return float(np.mean(right)) if right else float("nan")


def _best_threshold(values: np.ndarray, truth: np.ndarray) -> float:
    """Midway between the two neighbours that part the classes best; the widest gap of those equally good."""
    order = np.sort(values)
    middles = np.concatenate([[order[0] - 1e-9], 0.5 * (order[1:] + order[:-1]), [order[-1] + 1e-9]])
    gaps = np.concatenate([[0.0], np.diff(order), [0.0]])
    score = [np.mean((values >= m) == truth) for m in middles]
    return float(middles[np.lexsort((gaps, score))[-1]])


def fig5_episodes(weights: Path, seed: int, senses: SensesName = "real") -> list[tuple[str, dict[str, Any], Any]]:
    """(title, result, trace) of one probe of each object of the paper's Fig. 5, ended at its decision."""
    from shmoo_mjx.episode import Hooks, run_episode

    objects: dict[str, tuple[str, dict[str, Any]]] = {
        "wheelchair, right wheel locked": ("wheelchair", {"locked": [False, True, False, False], "payload": 10.0}),
        "cart, front-left wheel locked": ("cart", {"locked": [True, False, False, False], "payload": 5.0}),
        "box": ("box", {"mass": 2.8, "payload": 0.0, "friction": 0.4}),
    }
    episodes = []
    for title, (family, properties) in objects.items():
        condition = draw_condition(family, 5, properties)
        scenario = open_floor_scenario(condition, 0, seed, 40.0)
        over = Hooks(over=lambda navigator: any(d.manipulable for d in navigator.decisions))
        episode = run_episode(open_floor(), scenario, _controller(weights), navigator_config(), over, senses=senses)
        episodes.append((title, episode.result, episode.trace))
    return episodes


@cache
def _controller(weights: Path) -> Any:
    from shmoo_mjx.control.pushing import PushController
    from shmoo_mjx.learning.weights import load_weights

    return PushController(load_weights(weights))
