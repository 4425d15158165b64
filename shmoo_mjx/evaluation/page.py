"""One page for all experiments: each number beside the paper's, each table with the command that makes it anew.

python -m shmoo_mjx.evaluation.page runs/experiments docs/results.md (or runs/faults, runs/soak)

Numbers, spreads, versions and commands come from the experiments' JSON, of which compressed copies are kept beside
the page; a test makes each of their sections anew. Sections of experiments that are not in the folder stay as they are,
and so do sections of any other title: written by hand, they stay before or behind those of the experiments.
"""

from __future__ import annotations

import base64
import gzip
import html
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from shmoo_mjx.evaluation import faults, soak
from shmoo_mjx.evaluation.method_tables import ablations_table, baselines_table
from shmoo_mjx.evaluation.navigation_tables import navigation_tables
from shmoo_mjx.evaluation.pushing_measures import pushing_differences
from shmoo_mjx.evaluation.registry import EXPERIMENTS
from shmoo_mjx.evaluation.result import ExperimentResult, as_json, read_result, same_weights
from shmoo_mjx.files import write_whole
from shmoo_mjx.report.tables import markdown_table


@dataclass(frozen=True)
class Section:
    """How an experiment is shown."""

    title: str
    what: str
    """What was measured on what, in a sentence or two."""
    columns: tuple[str, ...] = ()
    """Heads of the table."""
    lines: tuple[tuple[str, tuple[str, ...]], ...] = ()
    """(label, name of the metric of each column; "" leaves the cell empty)."""
    figures: tuple[str, ...] = ()
    """Below the experiment's folder."""
    options: str = ""
    """What the command needs beside seeds."""
    without_psi: bool = False
    """No weights play a part in it."""


def _lines(labels: Mapping[str, str], *columns: str) -> tuple[tuple[str, tuple[str, ...]], ...]:
    """A line for each metric of ``labels``, which every column names in its own way, "{}_after" for example."""
    return tuple((label, tuple(c.format(metric) for c in columns or ("{}",))) for metric, label in labels.items())


def _of_methods(labels: Mapping[str, str], *names: str) -> tuple[tuple[str, tuple[str, ...]], ...]:
    """Lines whose columns are ours and the baselines ``names``."""
    return _lines(labels, "{}", *(f"baseline_{name}_{{}}" for name in names))


_FAMILIES = ("box", "cart", "wheelchair")
_PUSH_MODELS = ("", "published_", "published_quadratic_", "linear_", "no_motion_")
_LEFT_OUT = {"": "pair left out", "shape_out_": "shape left out", "mlab_": "triangle's support left out"}

SECTIONS = {
    "object_model": Section(
        "Predicting unseen objects (III-D, Fig. 4)",
        "psi adapts on the first 25 s of each unseen object and is scored on later rows.",
        ("prior", "after 25 s", "constant twist"),
        (
            *_lines(
                {
                    "mse": "MSE of the acceleration",
                    "fvu": "variance unexplained",
                    "fvu_median": "variance unexplained, median object",
                },
                *("{}_before", "{}_after", "{}_constant_velocity"),
            ),
            *(
                (f"variance unexplained, {family}", (f"fvu_before_{family}", f"fvu_after_{family}", ""))
                for family in _FAMILIES
            ),
            *_lines(
                {
                    "pos_rmse_1s_m": "position after 1 s open loop [m]",
                    "yaw_rmse_1s_deg": "yaw after 1 s [deg]",
                    "pos_rmse_3s_m": "position after 3 s [m]",
                    "yaw_rmse_3s_deg": "yaw after 3 s [deg]",
                },
                *("{}_before", "{}", "{}_constant_velocity"),
            ),
            *_lines(
                {
                    "ratio_after_before": "MSE after / before",
                    "gap_closed_1s_median": "gap closed after 1 s of contact, median",
                    "gap_closed_1s_q25": "gap closed after 1 s, lower quartile",
                    "gap_closed_5s_median": "gap closed after 5 s, median",
                    "brake_fvu_unaware_median": "variance unexplained, a brake just put on, median",
                    "brake_fvu_known_median": "variance unexplained, a brake felt for 25 s, median",
                },
                *("", "{}", ""),
            ),
        ),
        ("roll_outs.png", "adaptation.png"),
    ),
    "baselines": Section(
        "Beside other ways to predict (V-B)",
        "Every method is tuned on validation objects with the same budget.",
        figures=("baselines.png",),
    ),
    "ablations": Section(
        "One choice at a time",
        "Trainings that differ in one choice; a fresh probe measures how well psi identifies the condition.",
        figures=("domain_invariance.png",),
    ),
    "robot_finetune": Section(
        "The robot's model on another robot (V-C, Fig. 8)",
        "R is trained further on 5 minutes of the proxy robot, and on 40, and scored on 2 other minutes.",
        ("before", "after", "after 40 minutes"),
        (
            *_lines(
                {
                    "mse": "MSE, all outputs",
                    "mse_contact": "MSE in contact",
                    "mse_free": "MSE without contact",
                    "pos_rmse_3s_contact_m": "position after 3 s in contact [m]",
                    "pos_rmse_3s_free_m": "position after 3 s without contact [m]",
                },
                *("{}_before", "{}_after", "{}_more"),
            ),
            *_lines(
                {
                    "": "reduction of the MSE [%]",
                    "_acceleration_x": "reduction, acceleration x [%]",
                    "_acceleration_y": "reduction, acceleration y [%]",
                    "_acceleration_yaw": "reduction, acceleration yaw [%]",
                    "_force_x": "reduction, force x [%]",
                    "_force_y": "reduction, force y [%]",
                },
                *("", "reduction_percent{}", "reduction_percent{}_more"),
            ),
            *_lines(
                {
                    "success": "pushing to a pose, success",
                    "offset_m": "pushing to a pose, offset [m]",
                    "yaw_error_deg": "pushing to a pose, yaw error [deg]",
                },
                *("{}_before", "{}_after", ""),
            ),
            *_lines(
                {
                    "offset_m_difference": "offset, after less before [m]",
                    "offset_m_difference_low": "95 % interval from [m]",
                    "offset_m_difference_high": "to [m]",
                },
                *("", "{}", ""),
            ),
        ),
        ("robot_finetune.png",),
    ),
    "pushing": Section(
        "Pushing to a pose (VI-A, Fig. 7)",
        "The proxy robot pushes unseen objects to three goals. Two strata: objects as drawn, and demanding ones (load "
        "far off the centre, 25 to 45 N of resistance, half or twice the friction, a brake from the start). "
        "Every method runs every trial.",
        ("ours", "frozen prior", "and Eq. 8", "quasi-static", "hindsight a*", "psi as printed"),
        (
            *_of_methods(
                {
                    **{f"offset_goal{i}_m": f"offset, goal {i} [m]" for i in (1, 2, 3)},
                    **{f"radius_goal{i}_m": f"enclosing circle, goal {i} [m]" for i in (1, 2, 3)},
                    "success_rate": "success",
                    "success_rate_drawn": "success, as drawn",
                    "success_rate_demanding": "success, demanding",
                    **{f"success_rate_{family}": f"success, {family}" for family in _FAMILIES},
                    "success_rate_change_brake": "success, a brake pressed on the way",
                    "offset_m": "offset, mean [m]",
                    "offset_drawn_m": "offset, mean, as drawn [m]",
                    "offset_demanding_m": "offset, mean, demanding [m]",
                    "offset_median_m": "offset, median [m]",
                    "yaw_error_deg": "yaw error [deg]",
                    "falls": "falls",
                    "worst_lean_rad": "worst lean [rad]",
                    "time_s": "time [s]",
                    "pushes": "pushes",
                    "trials": "trials",
                },
                *("frozen_prior", "eq8", "quasi_static", "hindsight", "paper_form"),
            ),
            ("way from the prior's offset to hindsight's", ("way_to_hindsight", "", "", "", "", "")),
        ),
        ("pushing.png",),
    ),
    "object_planner": Section(
        "Can it be moved? (IV-B, Algorithm 1, Fig. 5)",
        "The navigator probes unseen objects, at least half of which are immovable, and decides.",
        ("ours",),
        _lines(
            {
                "accuracy": "accuracy",
                "accuracy_clear": "accuracy, objects near the border left out",
                "near_border": "objects near the border of manipulability",
                "accuracy_after_1s": "accuracy after 1 s of contact",
                "accuracy_of_K_after_1s": "accuracy of the paper's rule, K after 1 s",
                "calibration_error_after_1s": "calibration error of the probability after 1 s",
                "decision_time_s": "median time from the first touch [s]",
                "decided_within_3s": "decided within 3 s",
                "manipulable_called_manipulable": "manipulable, called so",
                "manipulable_called_immovable": "manipulable, called immovable",
                "immovable_called_immovable": "immovable, called so",
                "immovable_called_manipulable": "immovable, called manipulable",
                "undecided": "no verdict",
                "auc_probability_after_1s": "ROC area after 1 s, probability",
                "auc_K_after_1s": "ROC area after 1 s, K",
                "auc_moved_m_after_1s": "ROC area after 1 s, distance moved",
            }
        ),
        ("reliability.png", "confusion.png", "planned_goals.png"),
    ),
    "navigation": Section(
        "Interactive navigation (VI-B)",
        "Generated scenarios. Effort efficiency is 1 if nothing is pushed; the interactive navigation score is that of "
        "Interactive Gibson, half path and half effort efficiency. Aims are those for ours.",
        ("ours", "always avoid", "always push", "oracle"),
        (
            *_of_methods(
                {
                    "success_rate": "success (aim 0.96)",
                    "success_rate_push_only": "success, push only (aim 0.92)",
                    "success_rate_detour_only": "success, detour only (aim 0.92)",
                    "success_rate_either": "success, either (aim 0.92)",
                    "success_rate_border": "success, an object near the border of manipulability",
                    "success_rate_clear": "success, none near it",
                    "falls": "falls (aim 0)",
                    "wall_contacts_per_100": "wall contacts in 100 runs (aim 1)",
                    "time_s": "time of successes [s]",
                    "path_length_m": "path of successes [m]",
                    "displacement_m": "objects displaced by [m]",
                    "efficiency": "path efficiency",
                    "effort": "effort efficiency, mass moved",
                    "effort_force": "effort efficiency, force",
                    "ins": "interactive navigation score",
                    "scenarios": "scenarios",
                },
                *("always_avoid", "always_push", "oracle"),
            ),
            ("time over the oracle's, where both succeed (aim 1.2)", ("time_over_oracle", "", "", "")),
            ("scenarios that neither baseline can do", ("neither_baseline", "", "", "")),
            ("scenarios that neither baseline can do and ours can", ("neither_baseline_but_ours", "", "", "")),
        ),
        ("success.png", "causes.png"),
        "--maps DIR",
    ),
    "lifelong": Section(
        "One goal after the other",
        "Five goals in a row in a world that stays as the robot has left it, with what it remembers of objects. A "
        "sequence ends where the robot gives up, falls or runs out of time.",
        ("ours",),
        _lines(
            {
                "success_rate": "all goals reached",
                "goals_reached": "goals reached",
                **{f"success_rate_goal{i}": f"goal {i} reached, of those begun" for i in range(1, 6)},
                **{f"time_s_goal{i}": f"time to goal {i} [s]" for i in range(1, 6)},
                **{f"efficiency_goal{i}": f"path efficiency to goal {i}" for i in range(1, 6)},
                "falls": "falls",
                "wall_contacts_per_100_goals": "wall contacts in 100 goals",
                "effort": "effort efficiency, mass moved",
                "effort_force": "effort efficiency, force",
                "sequences": "sequences",
            }
        ),
        (),
        "--maps DIR",
    ),
    "real_pushing": Section(
        "Real pushes (other people's data)",
        "Mean error of the final pose. Ours is a quasi-static model without psi; published models of the same data.",
        ("ours", "4th-order, published", "quadratic, published", "linear", "no motion"),
        tuple(
            (f"{place}, {unit}", tuple(f"{prefix}{method}{metric}" for method in _PUSH_MODELS))
            for prefix, place in _LEFT_OUT.items()
            for metric, unit in (("pos_error_mm", "mm"), ("angle_error_deg", "deg"))
        ),
        ("real_pushing.png",),
        "--data DIR",
        without_psi=True,
    ),
}


RELIABILITY = {
    "faults": ("Faults", "One fault in each run of the demo, judged by the true state.", faults.summary),
    "soak": ("Soak", "Errand after errand in one building while others move objects.", soak.summary),
}
"""Title, what was done, and the table of what ``shmoo faults`` and ``shmoo soak`` write."""


def read_results(folder: Path) -> dict[str, ExperimentResult]:
    """The experiments' JSON files that are in a folder, compressed or not."""
    files = {name: [folder / f"{name}.json", folder / f"{name}.json.gz"] for name in (*EXPERIMENTS, *RELIABILITY)}
    found = {name: [file for file in either if file.is_file()] for name, either in files.items()}
    return {name: read_result(either[0]) for name, either in found.items() if either}


def render(results: Mapping[str, ExperimentResult], figures: Mapping[str, list[str]], before: str = "") -> str:
    """The page as Markdown; experiments that are missing are named as not run.

    Args:
        results: by name.
        figures: for each, paths as the page is to name them.
        before: the page as it was, whose sections stay where there is no result.
    """
    kept = {title: text.strip() for title, _, text in (part.partition("\n") for part in before.split("\n## ")[1:])}
    titles, made = list(kept), {section.title for section in SECTIONS.values()}
    made |= {title for name, (title, *_) in RELIABILITY.items() if name in results}
    first = next((i for i, title in enumerate(titles) if title in made), len(titles))
    written = [(i < first, f"## {title}\n\n{kept[title]}") for i, title in enumerate(titles) if title not in made]
    parts = ["# Results", _about(results), *(text for is_before, text in written if is_before)]
    for name, section in SECTIONS.items():
        if name in results:
            parts.append(section_of(results[name], figures.get(name, [])))
        else:
            command = " ".join(["shmoo experiment", name, *section.options.split()])
            parts.append(f"## {section.title}\n\n{kept.get(section.title, f'Not run. `{command}` measures it.')}")
    parts += [section_of(results[name], []) for name in RELIABILITY if name in results]
    return "\n\n".join([*parts, *(text for is_before, text in written if not is_before)]) + "\n"


def section_of(result: ExperimentResult, figures: Sequence[str]) -> str:
    """The part of the page that shows one experiment."""
    if result.experiment in RELIABILITY:
        return _reliability(result)
    section = SECTIONS[result.experiment]
    parts = [f"## {section.title}", section.what, f"`{_command(result, section)}`"]
    if not same_weights(result) and not section.without_psi:
        parts.append("**Measured with other weights than those shipped now.**")
    parts.append(_table(result, section))
    parts += [f"![{Path(path).stem.replace('_', ' ')}]({path})" for path in figures]
    return "\n\n".join(parts)


def write_page(results: Mapping[str, ExperimentResult], made_in: Path, page: Path, copies: Path | None = None) -> None:
    """Write ``page`` as Markdown, with the figures in ``made_in``, and as HTML beside it if these stay where they are.

    With ``copies``, a folder apart from the run, figures are copied there and results into ``results`` beside the page.
    """
    shown = {name: SECTIONS[name].figures for name in results if name in SECTIONS}
    found = {name: [p for p in (made_in / name / f for f in files) if p.is_file()] for name, files in shown.items()}
    page.parent.mkdir(parents=True, exist_ok=True)
    named: dict[str, list[str]] = {}
    for name, files in found.items():
        if copies is not None:
            copies.mkdir(parents=True, exist_ok=True)
            kept = [copies / f"{name}_{f.name}" if f.stem != name else copies / f.name for f in files]
            for source, target in zip(files, kept, strict=True):
                write_whole(target, source.read_bytes())
            files = kept
        named[name] = [Path(f).resolve().relative_to(page.parent.resolve()).as_posix() for f in files]
    before = ""
    if copies is not None:
        kept_results = page.parent / "results"
        kept_results.mkdir(exist_ok=True)
        for name, result in results.items():
            write_whole(kept_results / f"{name}.json.gz", gzip.compress(as_json(result), mtime=0))
        before = page.read_text() if page.is_file() else ""
    text = render(results, named, before)
    write_whole(page, text.encode())
    if copies is None:
        write_whole(page.with_suffix(".html"), _as_html(text, page.parent).encode())


def _reliability(result: ExperimentResult) -> str:
    title, what, summary = RELIABILITY[result.experiment]
    asked = {name: result.config[name] for name in ("runs", "minutes", "buildings") if name in result.config}
    words = [f"shmoo {result.experiment}", *(f"--{name} {value:g}" for name, value in asked.items())]
    parts = [f"## {title}", what, f"`{' '.join(words)} --seed {result.seed}`"]
    parts += [] if same_weights(result) else ["**Measured with other weights than those shipped now.**"]
    return "\n\n".join([*parts, summary(result)])


def _about(results: Mapping[str, ExperimentResult]) -> str:
    if not results:
        return "Nothing has been run."
    versions = {k: v for r in results.values() for k, v in r.versions.items()}
    quick = sorted(name for name, r in results.items() if r.config.get("quick"))
    lines = [
        "Measured in simulation, on objects and scenarios outside the training seeds; the real pushes are others' "
        "recordings. Numbers after ± are standard deviations over seeds. The paper's numbers come from its own "
        "simulator, objects and robot.",
        "Versions: " + ", ".join(f"{k} {v}" for k, v in versions.items()) + ".",
    ]
    if quick:
        lines.append(f"**Short form (--quick), for the shape of the page only:** {', '.join(quick)}.")
    return "\n\n".join(lines)


def _command(result: ExperimentResult, section: Section) -> str:
    # Navigation goes without maps as well, on floor plans of its own.
    options = "" if result.config.get("generated_maps") else section.options
    options = "--scenarios FILE" if result.config.get("scenario_set") else options
    words = ["shmoo experiment", result.experiment, options]
    words += [f"--seed {result.seed}", f"--condition-seed {result.config.get('condition_seed', 0)}"]
    words += ["--senses perfect"] if result.config.get("senses") == "perfect" else []
    words += ["--quick"] if result.config.get("quick") else []
    return " ".join(word for word in words if word)


def _table(result: ExperimentResult, section: Section) -> str:
    if result.experiment == "baselines":
        return baselines_table(result)
    if result.experiment == "ablations":
        return ablations_table(result)
    # Methods that did not run have no column.
    shown = [(label, names) for label, names in section.lines if any(name in result.metrics for name in names)]
    columns = [i for i in range(len(section.columns)) if any(names[i] in result.metrics for _, names in shown)]
    papers = [" / ".join(f"{result.paper[n]:.3g}" for n in names if n in result.paper) for _, names in shown]
    parts = [
        markdown_table(
            ["", *(section.columns[i] for i in columns), "paper"],
            [
                [label, *(_cell(result, names[i]) for i in columns), paper]
                for (label, names), paper in zip(shown, papers, strict=True)
            ],
        )
    ]
    if result.experiment == "navigation":
        parts.append(navigation_tables(result))
    if result.experiment == "pushing":
        parts.append(pushing_differences(result))
    return "\n\n".join(parts)


def _cell(result: ExperimentResult, name: str) -> str:
    if not name or name not in result.metrics:
        return ""
    value, std = result.metrics[name], result.metrics.get(f"{name}_std")
    if value is None:
        return "-"
    return f"{value:.3g}" + (f"±{std:.2g}" if std else "")


def _as_html(text: str, folder: Path) -> str:
    """The page with its figures inside, so that it can be sent to somebody."""
    from markdown_it import MarkdownIt

    markdown = MarkdownIt("commonmark").enable("table")
    tokens = markdown.parse(text)
    for token in tokens:
        for child in token.children or []:
            if child.type == "image":
                data = base64.b64encode((folder / str(child.attrs["src"])).read_bytes()).decode()
                child.attrs["src"] = f"data:image/png;base64,{data}"
    body = markdown.renderer.render(tokens, markdown.options, {})
    style = (
        "body{font:15px/1.5 system-ui,sans-serif;max-width:60em;margin:2em auto;padding:0 1em}img{max-width:100%}"
        "table{border-collapse:collapse}td,th{border:1px solid #ccc;padding:.2em .6em;text-align:left}"
    )
    title = html.escape("shmoo_mjx: results")
    return f'<!doctype html><meta charset="utf-8"><title>{title}</title><style>{style}</style>\n{body}'


def main() -> None:
    """Make the page anew from a folder of results."""
    made_in, page = Path(sys.argv[1]), Path(sys.argv[2])
    write_page(read_results(made_in), made_in, page, page.parent / "figures")


if __name__ == "__main__":
    main()
