"""Experiment object_planner: can the robot tell within seconds of contact whether it can move an object?

Unseen objects stand alone on an open floor in the robot's way. The unchanged navigator runs from the approach to three
seconds of contact. After each second, roll-outs over the posterior of the object's dynamics (`planning.reach`) give the
probability that the object can be moved. Ground truth is the object's progress along the push in the plant
(`manipulable`), on the side that the robot pushes.

Other criteria are evaluated on the same touches after one second: K, displacement with impulse, and displacement alone.
A logistic regression, fitted to training objects, turns each into a probability. Half of the objects are manipulable on
the side that faces the robot. The robot may choose another side, on which fewer are. The second stratum has objects
near the border: their load is chosen such that they move just far enough, or nearly, on the side that is pushed.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from shmoo_mjx.arrays import Array
from shmoo_mjx.base.options import SensesName
from shmoo_mjx.behavior.interaction import rolled
from shmoo_mjx.behavior.push_decisions import PROBE_TIME
from shmoo_mjx.behavior.state import Mode
from shmoo_mjx.evaluation.experiment import Experiment, ExperimentConfig, Prepared, Setup
from shmoo_mjx.evaluation.manipulable import (
    IMMOVABLE,
    STRATA,
    SteadyPush,
    draw_immovable,
    manipulable,
    near_border,
    near_border_by_load,
    steady_push,
)
from shmoo_mjx.evaluation.movability import (
    CRITERIA,
    navigator_config,
    open_floor,
    open_floor_scenario,
    probability_by,
)
from shmoo_mjx.evaluation.object_planner_figures import draw_figures
from shmoo_mjx.evaluation.result import ExperimentResult
from shmoo_mjx.evaluation.tables import Section, Table, lines_of, measured, percent, rate
from shmoo_mjx.evaluation.trials import controller_of
from shmoo_mjx.planning.object_planner import planning_stage
from shmoo_mjx.planning.reach import foresight_of
from shmoo_mjx.plant.condition import Condition
from shmoo_mjx.plant.objects import FAMILIES, draw_condition

LOOKS = (1.0, 2.0, 3.0)
"""Contact times of the decisions [s]. For a push that ends earlier, the decision is taken at its end."""
_BINS = 5
"""Number of bins of the calibration error."""


@dataclass(frozen=True)
class ObjectPlannerTrials(ExperimentConfig):
    """Size of the experiment."""

    objects: int = 60
    """Objects per stratum."""
    time_s: float = 40.0
    """Longest trial [s]."""
    truth: SteadyPush = SteadyPush()


def draw_object(index: int, first_seed: int, cfg: SteadyPush) -> tuple[Condition, int, str]:
    """(condition, side, kind) of object ``index``: even ones are manipulable on that side, odd ones are not.

    Families and kinds take turns. An object that the plant contradicts is drawn again.
    """
    family = FAMILIES[(index // 2) % 3]
    kind = "drawn" if index % 2 == 0 else IMMOVABLE[(index // 6) % 3]
    for seed in _seeds(index, first_seed):
        condition, side = _of_kind(kind, family, seed)
        if manipulable(condition, side, cfg) == (kind == "drawn"):
            return condition, side, kind
    raise AssertionError("every object that was drawn is the other kind")


def draw_border_object(
    index: int, first_seed: int, cfg: SteadyPush, pushed: Callable[[Condition, int], int]
) -> tuple[Condition, int, str]:
    """(condition, side, kind) of object ``index`` near the border: even ones are manipulable, just, odd ones nearly.

    This holds on the side that the robot chooses according to ``pushed``, given the ``side`` that faces it.
    """
    family = FAMILIES[(index // 2) % 3]
    # A box has no wheels that a kind could lock or make heavy to turn.
    kind = "drawn" if family == "box" else ("drawn", "heavy", "brakes")[(index // 6) % 3]
    # Seeds are used in reverse, because `draw_object` rarely reaches the last ones.
    for seed in reversed(list(_seeds(index, first_seed))):
        base, side = _of_kind(kind, family, seed)
        condition = near_border_by_load(base, pushed(base, side), index % 2 == 0, cfg)
        if condition is not None:
            return condition, side, kind
    raise AssertionError("no object that was drawn comes near the border by its load")


def _of_kind(kind: str, family: str, seed: int) -> tuple[Condition, int]:
    """An object as drawn or of a kind of `IMMOVABLE`, and the side of it that faces the robot."""
    condition = draw_condition(family, seed) if kind == "drawn" else draw_immovable(kind, family, seed)
    return condition, int(np.random.default_rng([seed, 1]).integers(4))


def _seeds(index: int, first_seed: int) -> Iterator[int]:
    """Sixteen seeds for each object in two blocks, so that redraws of one object do not change the next object."""
    # Both lie within the 1,000 seeds of a condition seed, for up to 62 objects.
    blocks = (first_seed + 8 * index, first_seed + 500 + 8 * index)
    return itertools.chain.from_iterable(range(first, first + 8) for first in blocks)


def probe(
    condition: Condition,
    side: int,
    seed: int,
    *,
    cfg: ObjectPlannerTrials,
    weights: Path,
    senses: SensesName = "real",
) -> tuple[dict[str, Any], Any]:
    """Evidence from three seconds of contact (empty if the object was never touched), and the episode.

    The object's face ``side`` is towards the robot. The evidence is the side that was pushed, the probability of being
    manipulable at each of `LOOKS`, and K, displacement [m] and impulse [N s] at the first of them.
    """
    from shmoo_mjx.run.episode import Hooks, run_episode

    probabilities: list[float] = []
    evidence: dict[str, Any] = {"probabilities": probabilities}
    controller = controller_of(weights)

    def over(navigator: Any) -> bool:
        push = navigator.segment.push if navigator.segment is not None else None
        if push is None:
            return False
        ended = navigator.mode not in (Mode.PROBE, Mode.PUSH)
        belief = navigator.belief.objects[navigator.segment.object]
        if ended and push.contact_time < PROBE_TIME and not rolled(push, belief.pose):
            return False  # the touch is too short for evidence, and the robot touches the object again
        while len(probabilities) < len(LOOKS) and (ended or push.contact_time >= LOOKS[len(probabilities)] - 1e-6):
            if not probabilities:
                evidence.update(_criteria(navigator, controller))
            probabilities.append(_probability(navigator, controller, cfg.truth))
        return len(probabilities) == len(LOOKS)

    scenario = open_floor_scenario(condition, side, seed, cfg.time_s)
    episode = run_episode(
        open_floor(), scenario, controller, config=navigator_config(), hooks=Hooks(over=over), senses=senses
    )
    return (evidence if probabilities else {}), episode


def _probability(navigator: Any, controller: Any, truth: SteadyPush) -> float:
    """Probability that the object comes along the push as far as the ground truth requires."""
    segment = navigator.segment
    belief = navigator.belief.objects[segment.object]
    return foresight_of(controller).probability_to_move(
        belief.adapt,
        belief.kind,
        belief.pose,
        belief.half_extents,
        face=segment.face,
        distance=truth.distance,
        turn=truth.turn,
    )


def _criteria(navigator: Any, controller: Any) -> dict[str, Any]:
    """Displacement and impulse so far, and K from the planning stage of Algorithm 1."""
    segment, planner = navigator.segment, navigator.config.planner
    push, belief = segment.push, navigator.belief.objects[segment.object]
    poses, _, costs = controller.planning_rollouts(
        push.pusher, segment.goal, segment.clearance, np.array(belief.half_extents)
    )
    stage = planning_stage(poses[:, -1], costs, belief.pose, lambda ends: np.ones(len(ends), dtype=bool), cfg=planner)
    moved = push.moved(belief.pose)
    return {"side": segment.side, "K_first": stage.K, "moved_m_first": moved, "impulse_Ns_first": push.impulse}


def _trial(setup: Setup[ObjectPlannerTrials], trial: tuple[str, int]) -> list[dict[str, Any]]:
    from shmoo_mjx.run.episode import Hooks, run_episode

    (stratum, number), options, cfg = trial, setup.options, setup.config
    controller, own_seed = controller_of(options.weights_file), 1000 * options.seed + number

    def pushed(condition: Condition, side: int) -> int:
        # The navigator chooses a face before it can know the load.
        scenario = open_floor_scenario(condition, side, own_seed, cfg.time_s)
        begins = Hooks(over=lambda navigator: navigator.segment is not None)
        episode = run_episode(
            open_floor(), scenario, controller, config=navigator_config(), hooks=begins, senses=options.senses
        )
        return episode.navigator.state.current().side

    if stratum == "drawn":
        condition, side, kind = draw_object(number, options.first_unseen, cfg.truth)
    else:
        condition, side, kind = draw_border_object(number, options.first_unseen, cfg.truth, pushed)
    evidence, episode = probe(condition, side, own_seed, cfg=cfg, weights=options.weights_file, senses=options.senses)
    side = evidence.get("side", side)
    truth = steady_push(condition, side, cfg.truth)
    row = {
        "stratum": stratum,
        "object": number,
        "family": condition.family,
        "kind": kind,
        "description": condition.describe(),
        "transitions": len(episode.result["transitions"]),
        "side": side,
        "manipulable": truth >= cfg.truth.distance,
        "truth_m": truth,
        "border": near_border(condition, side, cfg.truth),
    }
    return [row | evidence]


def right(row: dict[str, Any], look: int = 0) -> bool:
    """Whether the decision at one of `LOOKS` is right. An object that was not touched counts as a mistake."""
    return "probabilities" in row and (row["probabilities"][look] >= 0.5) == row["manipulable"]


def measure(rows: list[dict[str, Any]]) -> dict[str, float]:
    """Accuracy, confusion counts, and scores of the criteria."""
    touched, clear = [r for r in rows if "probabilities" in r], [r for r in rows if not r["border"]]
    truths = np.array([r["manipulable"] for r in touched], dtype=bool)
    metrics = {
        "accuracy": float(np.mean([right(r) for r in rows])),
        **{f"accuracy_{look:g}s": float(np.mean([right(r, k) for r in rows])) for k, look in enumerate(LOOKS) if k},
        "accuracy_clear": float(np.mean([right(r) for r in clear])) if clear else np.nan,
        "near_border": len(rows) - len(clear),
        "undecided": len(rows) - len(touched),
    }
    for truth, name in ((True, "manipulable"), (False, "immovable")):
        decided = probability_by("reach", [r for r in touched if r["manipulable"] == truth]) >= 0.5
        metrics[f"{name}_called_manipulable"] = int(np.sum(decided))
        metrics[f"{name}_called_immovable"] = int(np.sum(~decided))
    for criterion in CRITERIA:
        p = probability_by(criterion, touched)
        metrics |= {
            f"accuracy_{criterion}_after_1s": float(np.sum((p >= 0.5) == truths)) / len(rows),
            f"log_score_{criterion}_after_1s": log_score(p, truths),
            f"calibration_error_{criterion}_after_1s": calibration(p, truths),
            f"auc_{criterion}_after_1s": auc(p, truths),
        }
    return metrics


def log_score(probability: Array, truth: Array) -> float:
    """Mean logarithm of the probability ``[N]`` of the true class: 0 is best, a coin has -0.69."""
    p = np.clip(np.where(np.asarray(truth, dtype=bool), probability, 1.0 - np.asarray(probability)), 1e-6, 1.0)
    return float(np.log(p).mean()) if p.size else float("nan")


def calibration(probability: Array, truth: Array) -> float:
    """Expected calibration error of ``probability [N]`` of ``truth [N]``, in five bins of equal width."""
    p, truth = np.asarray(probability, dtype=float), np.asarray(truth, dtype=bool)
    place = np.minimum((p * _BINS).astype(int), _BINS - 1)
    return float(sum(abs(np.sum(p[place == b] - truth[place == b])) for b in range(_BINS)) / max(len(p), 1))


def auc(values: np.ndarray, truth: np.ndarray) -> float:
    """Area under the ROC curve: 1 separates the classes, 0.5 is chance."""
    positive, negative = values[truth], values[~truth]
    if not positive.size or not negative.size:
        return float("nan")
    above = (positive[:, None] > negative).mean() + 0.5 * (positive[:, None] == negative).mean()
    return float(above)


def _metrics(setup: Setup[ObjectPlannerTrials], rows: list[dict[str, Any]]) -> dict[str, float]:
    parts = {stratum: [r for r in rows if r["stratum"] == stratum] for stratum in STRATA}
    of = {"": parts["drawn"], "_border": parts["border"], "_all": rows}
    return {f"{name}{suffix}": value for suffix, part in of.items() for name, value in measure(part).items()}


def _draw(setup: Setup[ObjectPlannerTrials], rows: list[dict[str, Any]]) -> None:
    draw_figures(setup.folder, rows, setup.options)


_CRITERIA = {"reach": "roll-outs", "K": "K", "impulse": "displacement and impulse", "moved_m": "displacement"}
_OF_CRITERIA = {
    "accuracy": "Share of right decisions",
    "log_score": "Log score (a coin: -0.69)",
    "calibration_error": "Calibration error",
    "auc": "Area under the ROC curve",
}


def _shows(result: ExperimentResult) -> str:
    wrong = [measured(result, n) for n in ("manipulable_called_immovable_all", "immovable_called_manipulable_all")]
    right = {
        name: percent(measured(result, f"accuracy{name}"))
        for name in ("", "_3s", "_border", "_K_after_1s", "_moved_m_after_1s")
    }
    return (
        f"Of objects as drawn, the robot decides rightly in {right['']} of the cases after 1 s of contact and in "
        f"{right['_3s']} after 3 s. The paper's criterion K, with a fitted threshold, decides rightly in "
        f"{right['_K_after_1s']} after 1 s, displacement alone in {right['_moved_m_after_1s']}. Near the border "
        f"(objects that a push moves 0.2 to 0.5 m) {right['_border']} of the decisions after 1 s are right; chance "
        f"gives 50 %. Of both groups, after 1 s, {wrong[0]:.0f} movable objects are judged immovable and "
        f"{wrong[1]:.0f} immovable ones movable."
    )


_COLUMNS, _PARTS = ("as drawn", "near the border", "both"), ("{}", "{}_border", "{}_all")

EXPERIMENT = Experiment(
    Section(
        "Decision whether an object can be moved",
        "Can the robot tell within seconds of contact whether it can move an object? (Sec. IV-B, Algorithm 1, Fig. 5 "
        "of the paper)",
        (
            Table(
                _COLUMNS,
                lines_of(
                    {
                        "accuracy": "Share of right decisions after 1 s of contact",
                        "accuracy_2s": "Share of right decisions after 2 s of contact",
                        "accuracy_3s": "Share of right decisions after 3 s of contact",
                        "accuracy_K_after_1s": "Share of right decisions after 1 s, by K (paper, fitted threshold)",
                        "accuracy_moved_m_after_1s": "Share of right decisions after 1 s, by displacement",
                    },
                    *_PARTS,
                ),
            ),
            Table(
                _COLUMNS,
                lines_of(
                    {
                        "accuracy_clear": "Share of right decisions, objects near the border left out",
                        "near_border": "Objects near the border",
                        "manipulable_called_manipulable": "Movable objects judged movable",
                        "manipulable_called_immovable": "Movable objects judged immovable",
                        "immovable_called_immovable": "Immovable objects judged immovable",
                        "immovable_called_manipulable": "Immovable objects judged movable",
                        "undecided": "Objects that were not touched",
                    },
                    *_PARTS,
                ),
                "After 1 s of contact:",
            ),
            Table(
                _COLUMNS,
                lines_of(
                    {
                        f"{measure}_{criterion}_after_1s": f"{name}, {by}"
                        for measure, name in _OF_CRITERIA.items()
                        for criterion, by in _CRITERIA.items()
                    },
                    *_PARTS,
                ),
                "Criteria after 1 s of contact:",
            ),
        ),
        _shows,
        {
            "reliability.png": "Left: predicted and observed frequency of movable objects. Right: the same probability "
            "beside K",
            "confusion.png": "Decisions after 1 s of contact and the truth",
            "planned_goals.png": "Planned goals for three objects, after the paper's Fig. 5",
        },
        summary=(
            (
                "Accuracy of the decision whether an object can be moved, objects as drawn",
                rate("accuracy", lambda r: float(r.config.get("objects", 0))),
            ),
        ),
    ),
    ObjectPlannerTrials(),
    quick=ObjectPlannerTrials(objects=6),
    trials=lambda setup: {f"{s}-{i:03d}": (s, i) for s in STRATA for i in range(setup.config.objects)},
    trial=_trial,
    metrics=_metrics,
    draw=_draw,
    prepare=lambda options, config, folder: Prepared(
        files=(options.weights_file,), settings=(asdict(navigator_config()),)
    ),
    neutral=("objects",),
)
