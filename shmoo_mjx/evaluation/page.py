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
from pathlib import Path

from shmoo_mjx.evaluation import faults, soak
from shmoo_mjx.evaluation.page_sections import SECTIONS, Section
from shmoo_mjx.evaluation.registry import EXPERIMENTS
from shmoo_mjx.evaluation.result import ExperimentResult, as_json, read_result, same_weights
from shmoo_mjx.files import write_whole
from shmoo_mjx.report.tables import markdown_table

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
    if section.table is not None:
        return section.table(result)
    # Methods that did not run have no column.
    shown = [(label, names) for label, names in section.lines if any(name in result.metrics for name in names)]
    columns = [i for i in range(len(section.columns)) if any(names[i] in result.metrics for _, names in shown)]
    papers = [" / ".join(f"{result.paper[n]:.3g}" for n in names if n in result.paper) for _, names in shown]
    table = markdown_table(
        ["", *(section.columns[i] for i in columns), "paper"],
        [
            [label, *(_cell(result, names[i]) for i in columns), paper]
            for (label, names), paper in zip(shown, papers, strict=True)
        ],
    )
    return table if section.more is None else f"{table}\n\n{section.more(result)}"


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
