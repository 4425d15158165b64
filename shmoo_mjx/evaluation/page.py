"""One page for all experiments: each number beside the paper's, each table with the command that makes it anew.

python -m shmoo_mjx.evaluation.page FOLDER docs/results.md

FOLDER holds new results (runs/experiments), or is docs/results, to write the page anew.

Numbers, spreads, versions and commands come from the experiments' JSON, of which compressed copies are kept beside
the page. The page shows the results of FOLDER and, for other experiments, the copies; the README gets the page's first
table, and arena.md beside the page the table of policies. Sections of other titles are written by hand: they stay
before or behind those of the experiments.
"""

from __future__ import annotations

import base64
import gzip
import html
import re
import sys
from collections.abc import Mapping, Sequence
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import NamedTuple

from shmoo_mjx.base.files import write_whole
from shmoo_mjx.evaluation.navigation_tables import reference_table
from shmoo_mjx.evaluation.registry import EXPERIMENTS, RELIABILITY, experiment_named
from shmoo_mjx.evaluation.result import ExperimentResult, as_json, read_result, same_weights
from shmoo_mjx.evaluation.tables import NotMeasured, Section
from shmoo_mjx.report.tables import markdown_table

SUMMARY = ("navigation", "pushing", "object_planner", "object_model", "real_pushing")
"""Experiments whose numbers the page and the README begin with, in this order."""

_BLOCK = re.compile(r"(?<=<!-- results -->\n).*?(?=<!-- end -->)", re.DOTALL)


@cache
def sections() -> dict[str, Section]:
    """How each experiment is shown, in the order of the page."""
    return {name: experiment_named(name).section for name in EXPERIMENTS}


def section_named(name: str) -> Section:
    """How this experiment is shown, faults and soak included."""
    return experiment_named(name).section


def read_results(folder: Path) -> dict[str, ExperimentResult]:
    """The experiments' JSON files that are in a folder, compressed or not."""
    files = {name: [folder / f"{name}.json", folder / f"{name}.json.gz"] for name in (*EXPERIMENTS, *RELIABILITY)}
    existing = {name: [file for file in either if file.is_file()] for name, either in files.items()}
    return {name: read_result(either[0]) for name, either in existing.items() if either}


def render(results: Mapping[str, ExperimentResult], figures: Mapping[str, list[str]], before: str = "") -> str:
    """The page as Markdown; experiments that are missing are named as not run.

    Args:
        results: by name.
        figures: for each, paths as the page is to name them.
        before: the page as it was, whose sections stay where there is no result.
    """
    kept = {title: text.strip() for title, _, text in (part.partition("\n") for part in before.split("\n## ")[1:])}
    shown = sections() | {name: section_named(name) for name in RELIABILITY if name in results}
    titles, made = list(kept), {section.title for section in shown.values()}
    first = next((i for i, title in enumerate(titles) if title in made), len(titles))
    written = [(i < first, f"## {title}\n\n{kept[title]}") for i, title in enumerate(titles) if title not in made]
    parts = ["# Results", _about(results), *([summary_table(results)] if summary(results) else [])]
    parts += [text for is_before, text in written if is_before]
    for name, section in shown.items():
        if name in results:
            parts.append(section_of(results[name], figures.get(name, [])))
        else:
            command = f"shmoo experiment {name} {section.arguments({})}".rstrip()
            parts.append(f"## {section.title}\n\n{kept.get(section.title, f'Not run. `{command}` measures it.')}")
    return "\n\n".join([*parts, *(text for is_before, text in written if not is_before)]) + "\n"


class SummaryRow(NamedTuple):
    """One number of the summary."""

    experiment: str
    label: str
    value: str
    """With its unit, and its 95 % interval where there is one."""
    trials: int
    paper: str
    """The paper's number; "" where it has none."""


def summary(results: Mapping[str, ExperimentResult]) -> list[SummaryRow]:
    """The numbers of the summary that ``results`` has measured."""
    rows = []
    for name in SUMMARY:
        for label, value in sections()[name].summary if name in results else ():
            with suppress(NotMeasured):
                rows.append(SummaryRow(name, label, *value(results[name])))
    return rows


def summary_table(results: Mapping[str, ExperimentResult], commands: bool = True) -> str:
    """The numbers that the page begins with, as Markdown; without ``commands`` as the README shows them."""
    rows = [
        [row.label, row.value, f"{row.trials:,}", row.paper]
        + ([f"`{_command(results[row.experiment])}`"] if commands else [])
        for row in summary(results)
    ]
    return markdown_table(["measure", "here", "n", "paper", *(["command"] if commands else [])], rows)


def with_block(text: str, block: str) -> str:
    """The text with ``block`` between its comments ``<!-- results -->`` and ``<!-- end -->``."""
    return _BLOCK.sub(lambda _: f"{block}\n", text)


def section_of(result: ExperimentResult, figures: Sequence[str]) -> str:
    """The part of the page that shows one experiment."""
    section = section_named(result.experiment)
    parts = [f"## {section.title}", section.what, f"`{_command(result)}`"]
    if not same_weights(result) and not section.without_psi:
        parts.append("**Measured with other weights than those shipped now.**")
    parts.append(section.body(result))
    parts += [f"![{Path(path).stem.replace('_', ' ')}]({path})" for path in figures]
    return "\n\n".join(parts)


def write_page(results: Mapping[str, ExperimentResult], made_in: Path, page: Path, copies: Path | None = None) -> None:
    """Write ``page`` as Markdown, with the figures in ``made_in``, and as HTML beside it if these stay where they are.

    With ``copies``, a folder apart from the run, figures are copied there and results into ``results`` beside the page;
    the page then shows all results that are kept there, the README one folder up gets its first table, and arena.md
    beside the page the table of policies.
    """
    page.parent.mkdir(parents=True, exist_ok=True)
    if copies is None:
        named = {name: _named(page, [made_in / name / f for f in _figures(name)]) for name in results}
        text = render(results, named)
        write_whole(page, text.encode())
        write_whole(page.with_suffix(".html"), _as_html(text, page.parent).encode())
        return
    copies.mkdir(parents=True, exist_ok=True)
    kept_results = page.parent / "results"
    kept_results.mkdir(exist_ok=True)
    for name, result in results.items():
        for figure, kept in zip(_figures(name), kept_figures(name, copies), strict=True):
            if (source := made_in / name / figure).is_file():
                write_whole(kept, source.read_bytes())
        write_whole(kept_results / f"{name}.json.gz", gzip.compress(as_json(result), mtime=0))
    results = read_results(kept_results)
    before = page.read_text() if page.is_file() else ""
    named = {name: _named(page, kept_figures(name, copies)) for name in results}
    write_whole(page, render(results, named, before).encode())
    blocks = {page.parent.parent / "README.md": summary_table(results, commands=False)}
    if "navigation" in results and (table := reference_table(results["navigation"])):
        blocks[page.parent / "arena.md"] = f"`{_command(results['navigation'])}`\n\n{table}"
    for file, block in blocks.items():
        if file.is_file():
            write_whole(file, with_block(file.read_text(), block).encode())


def kept_figures(name: str, copies: Path) -> list[Path]:
    """Where the copies of an experiment's figures are, or would be."""
    return [copies / (f if Path(f).stem == name else f"{name}_{f}") for f in _figures(name)]


def _figures(name: str) -> tuple[str, ...]:
    return section_named(name).figures


def _named(page: Path, figures: Sequence[Path]) -> list[str]:
    """The figures that are there, as the page names them."""
    return [f.resolve().relative_to(page.parent.resolve()).as_posix() for f in figures if f.is_file()]


def _about(results: Mapping[str, ExperimentResult]) -> str:
    if not results:
        return "Nothing has been run."
    used: dict[str, set[str]] = {}
    for result in results.values():
        for name, version in result.versions.items():
            used.setdefault(name, set()).add(version)
    quick = sorted(name for name, r in results.items() if r.config.get("quick"))
    lines = [
        "All numbers come from simulation, except the section on recorded pushes. Objects and scenarios are drawn from "
        "seeds that training does not use. Numbers in brackets are 95 % intervals: bootstrap intervals over trials for "
        "differences, Wilson intervals for rates. Numbers after ± are standard deviations over seeds. The paper's "
        "numbers come from its own simulator, objects and robot.",
        "Versions: " + ", ".join(f"{name} {' and '.join(sorted(v))}" for name, v in used.items()) + ".",
    ]
    if quick:
        lines.append(f"**Short form (--quick), for the shape of the page only:** {', '.join(quick)}.")
    return "\n\n".join(lines)


def _command(result: ExperimentResult) -> str:
    """The command line that makes a result anew."""
    section, config = section_named(result.experiment), result.config
    words = [section.command or f"shmoo experiment {result.experiment}", section.arguments(config)]
    words += [f"--seed {result.seed}"]
    if not section.command:
        words += [f"--condition-seed {config.get('condition_seed', 0)}"]
        words += ["--senses perfect"] if config.get("senses") == "perfect" else []
        words += ["--quick"] if config.get("quick") else []
    return " ".join(word for word in words if word)


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
