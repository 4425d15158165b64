"""Pages of results: a summary with limits, and a section and a page for each experiment.

python -m shmoo_mjx.evaluation.page FOLDER docs/results.md

FOLDER holds new results (runs/experiments), or is docs/results, which writes the same pages again. Compressed copies of
the results are kept in the folder ``results`` beside the page, together with the page of each experiment. Everything on
the pages comes from these copies. The README gets the summary, protocols.md the table of commands, and arena.md the
table of policies.
"""

from __future__ import annotations

import argparse
import base64
import gzip
import html
import re
from collections.abc import Mapping
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import NamedTuple

from shmoo_mjx.base.files import write_whole
from shmoo_mjx.evaluation import navigation, pushing
from shmoo_mjx.evaluation.ablations import cost_terms_table
from shmoo_mjx.evaluation.navigation_tables import reference_table
from shmoo_mjx.evaluation.registry import EXPERIMENTS, RELIABILITY, experiment_named
from shmoo_mjx.evaluation.result import ExperimentResult, as_json, read_result, same_weights
from shmoo_mjx.evaluation.tables import SNAPSHOT, NotMeasured, Section, effects, percent
from shmoo_mjx.report.tables import markdown_table

SUMMARY = ("navigation", "pushing", "object_planner", "object_model", "real_pushing")
"""Experiments with numbers in the summary, in this order."""

ADAPTATION = (
    ("pushing", "In pushing to a pose, it", "frozen_prior", pushing.EFFECTS),
    ("navigation", "In navigation, it", "frozen", navigation.EFFECTS),
)
"""Experiments with a method that does not adapt: start of a sentence, method, and what is compared."""

COST_TERMS = "cost_terms.json.gz"
"""Result of pushing without parts of the controller, of which the page of the ablations has a table."""

_LIMITS = """
- Everything is simulated. Only *Recorded pushes of other robots* uses measured data, and psi plays no part in it.
- One robot is simulated. Most experiments use a proxy robot of the same shape with other masses, friction, motors and
  delays.
- Maps are known. Objects carry tags, and the robot is told their sizes.
- Pushing to a pose takes place on an open floor, and the robot is told where the object starts.
- Wheelchairs and carts with a locked wheel turn when they are pushed and often jam in doorways.
- Near the border of what the robot can move, its decisions are hardly better than chance. It tends to go around.
- The paper's numbers come from its own simulator, objects and robot. Ratios compare better than absolute values.
""".strip()

_BLOCK = re.compile(r"(?<=<!-- results -->\n).*?(?=<!-- end -->)", re.DOTALL)


@cache
def sections() -> dict[str, Section]:
    """The section of each experiment, in the order of the page. Experiments for developers come last."""
    return {name: experiment_named(name).section for name in (*EXPERIMENTS, *RELIABILITY)}


def read_results(folder: Path) -> dict[str, ExperimentResult]:
    """The experiments' JSON files in a folder, compressed or not."""
    files = {name: [folder / f"{name}.json", folder / f"{name}.json.gz"] for name in sections()}
    existing = {name: [file for file in either if file.is_file()] for name, either in files.items()}
    return {name: read_result(either[0]) for name, either in existing.items() if either}


class SummaryRow(NamedTuple):
    """One number of the summary."""

    experiment: str
    label: str
    value: str
    """With its unit, and its 95 % interval if it has one."""
    trials: int
    paper: str
    """The paper's value; "" if it has none."""


def summary(results: Mapping[str, ExperimentResult]) -> list[SummaryRow]:
    """The numbers of the summary that ``results`` has measured."""
    rows = []
    for name in SUMMARY:
        for label, value in sections()[name].summary if name in results else ():
            with suppress(NotMeasured):
                rows.append(SummaryRow(name, label, *value(results[name])))
    return rows


def summary_table(results: Mapping[str, ExperimentResult], links: bool = True) -> str:
    """The summary as Markdown. With ``links`` each number leads to the section of its experiment."""
    rows = [
        [f"[{row.label}](#{_anchor(row.experiment)})" if links else row.label, row.value, f"{row.trials:,}", row.paper]
        for row in summary(results)
    ]
    return markdown_table(["measure", "here", "n", "paper"], rows)


def render(results: Mapping[str, ExperimentResult], figures: Mapping[str, list[str]], linked: bool = True) -> str:
    """The results page as Markdown. Experiments without a result are named as not run.

    Args:
        results: by name.
        figures: of each experiment, as the page names them.
        linked: whether each section leads to the page of its experiment.
    """
    parts = ["# Results", _about(results)]
    if summary(results):
        parts.append(summary_table(results))
    if effect := _adaptation(results):
        parts.append(f"**What adaptation brings.** {effect}")
    parts += ["## Limits", _LIMITS]
    for name, section in sections().items():
        if name in results:
            parts.append(_short(results[name], figures.get(name, []), linked))
        elif name in EXPERIMENTS:
            command = f"shmoo experiment {name} {section.arguments({})}".rstrip()
            parts.append(f"## {section.title}\n\n{section.question} Not run. `{command}` measures it.")
    return "\n\n".join(parts) + "\n"


def render_experiment(result: ExperimentResult, figures: list[str], linked: bool = True) -> str:
    """The page of one experiment as Markdown: all tables and figures."""
    section = sections()[result.experiment]
    protocol = f" [Protocol](../protocols.md#{_anchor(result.experiment)})." if linked else ""
    parts = [f"# {section.title}", f"{section.question}{protocol}", f"`{_command(result)}`", _weights(result)]
    parts += [_shows(result), *(table(result) for table in section.tables)]
    captions = {Path(file).stem: caption for file, caption in section.figures.items()}
    for path in figures:
        caption = next(text for stem, text in captions.items() if Path(path).stem.endswith(stem))
        parts.append(f"![{caption}]({path})\n\n*{caption}*")
    return "\n\n".join(part for part in parts if part) + "\n"


def commands_table(results: Mapping[str, ExperimentResult]) -> str:
    """The command of each experiment, and the versions, as Markdown."""
    used: dict[str, set[str]] = {}
    for result in results.values():
        for name, version in result.versions.items():
            used.setdefault(name, set()).add(version)
    shown = [name for name in sections() if name in results]
    rows = [[f"[{sections()[name].title}](#{_anchor(name)})", f"`{_command(results[name])}`"] for name in shown]
    versions = ", ".join(f"{name} {' / '.join(sorted(v))}" for name, v in used.items())
    return f"{markdown_table(['experiment', 'command'], rows)}\n\nVersions: {versions}."


def with_block(text: str, block: str) -> str:
    """The text with ``block`` between its comments ``<!-- results -->`` and ``<!-- end -->``."""
    return _BLOCK.sub(lambda _: f"{block}\n", text)


def write_page(results: Mapping[str, ExperimentResult], made_in: Path, page: Path, copies: Path | None = None) -> None:
    """Write ``page`` as Markdown with the figures in ``made_in``.

    Without ``copies`` the page holds everything, and an HTML file with the figures inside is written beside it. With
    ``copies``, a folder for figures, results are kept in ``results`` beside the page. The page then shows all kept
    results. The pages of experiments are written too, as are the tables in protocols.md, arena.md, index.md,
    paper.md and the README.
    """
    page.parent.mkdir(parents=True, exist_ok=True)
    if copies is None:
        named = {name: _named(page, [made_in / name / f for f in sections()[name].figures]) for name in results}
        shown = [name for name in sections() if name in results]
        details = [f"## All tables: {render_experiment(results[n], named[n], linked=False)[2:]}" for n in shown]
        text = "\n".join([render(results, named, linked=False), *details])
        write_whole(page, text.encode())
        write_whole(page.with_suffix(".html"), _as_html(text, page.parent).encode())
        return
    copies.mkdir(parents=True, exist_ok=True)
    kept_results = page.parent / "results"
    kept_results.mkdir(exist_ok=True)
    for name, result in results.items():
        for figure, kept in zip(sections()[name].figures, kept_figures(name, copies), strict=True):
            if (source := made_in / name / figure).is_file():
                write_whole(kept, source.read_bytes())
        write_whole(kept_results / f"{name}.json.gz", gzip.compress(as_json(result), mtime=0))
    results = read_results(kept_results)
    named = {name: _named(page, kept_figures(name, copies)) for name in results}
    write_whole(page, render(results, named).encode())
    for name, result in results.items():
        text = render_experiment(result, [f"../{figure}" for figure in named[name]])
        if name == "ablations" and (terms := kept_results / COST_TERMS).is_file():
            text += f"\n{cost_terms_table(read_result(terms))}\n"
        write_whole(kept_results / f"{name}.md", text.encode())
    blocks = {
        page.parent.parent / "README.md": summary_table(results, links=False),
        page.parent / "protocols.md": commands_table(results),
    }
    if "navigation" in results and (table := reference_table(results["navigation"])):
        blocks[page.parent / "arena.md"] = f"`{_command(results['navigation'])}`\n\n{table}"
    for file, block in blocks.items():
        if file.is_file():
            write_whole(file, with_block(file.read_text(), block).encode())
    for file in (page.with_name("index.md"), page.parent.parent / "paper.md"):
        if file.is_file():
            write_whole(file, _with_rows(file.read_text(), summary(results)).encode())


def _with_rows(text: str, rows: list[SummaryRow]) -> str:
    """The text with the current values in those lines of its tables that begin with a label of the summary.

    Such a line has the columns measure, here and n, and may have the column paper.
    """
    values = {row.label: [row.label, row.value, f"{row.trials:,}", row.paper] for row in rows}

    def current(line: str) -> str:
        cells = values.get(line.removeprefix("| ").partition(" |")[0])
        return line if cells is None else f"| {' | '.join(cells[: line.count('|') - 1])} |"

    return "".join(f"{current(line)}\n" for line in text.splitlines())


def kept_figures(name: str, copies: Path) -> list[Path]:
    """Where the copies of an experiment's figures are, or would be."""
    return [copies / (f if Path(f).stem == name else f"{name}_{f}") for f in sections()[name].figures]


def _named(page: Path, figures: list[Path]) -> list[str]:
    """The existing figures, as the page names them."""
    return [f.resolve().relative_to(page.parent.resolve()).as_posix() for f in figures if f.is_file()]


def _about(results: Mapping[str, ExperimentResult]) -> str:
    if not results:
        return "Nothing has been run."
    lines = [
        "Measured on objects and scenarios that training has not seen; all but the recorded pushes in simulation, with "
        "simulated sensors. Brackets are 95 % intervals, n counts trials, and psi is the learned object model. How "
        "each number is measured: [protocols and seeds](protocols.md)."
    ]
    quick = sorted(name for name, r in results.items() if r.config.get("quick"))
    if quick:
        lines.append(f"**Short form (--quick), for the shape of the page only:** {', '.join(quick)}.")
    return "\n\n".join(lines)


def _adaptation(results: Mapping[str, ExperimentResult]) -> str:
    """What learning in contact changes, in sentences."""
    told = []
    if "object_model" in results and (ratio := results["object_model"].metrics.get("ratio_after_before")) is not None:
        told.append(f"Learning in contact lowers the squared error of predictions to {percent(ratio)}.")
    for name, where, key, measures in ADAPTATION:
        if name in results:
            told.append(effects(results[name], where, f"difference_{key}_", measures))
    return " ".join(sentence for sentence in told if sentence)


def _short(result: ExperimentResult, figures: list[str], linked: bool) -> str:
    """The section of one experiment: question, command, first table, first figure, one paragraph."""
    section = sections()[result.experiment]
    parts = [f"## {section.title}", f"{section.question} `{_command(result)}`", section.tables[0](result)]
    parts += [f"![{caption}]({path})" for caption, path in zip(section.figures.values(), figures[:1], strict=False)]
    more = f"[All tables](results/{result.experiment}.md)." if linked else ""
    parts.append(" ".join(text for text in (_shows(result), _weights(result), more) if text))
    return "\n\n".join(part for part in parts if part)


def _shows(result: ExperimentResult) -> str:
    try:
        return sections()[result.experiment].shows(result)
    except NotMeasured:
        return ""


def _weights(result: ExperimentResult) -> str:
    if same_weights(result) or sections()[result.experiment].without_weights:
        return ""
    return SNAPSHOT


def _command(result: ExperimentResult) -> str:
    """The command line that makes a result again."""
    section, config = sections()[result.experiment], result.config
    words = [f"shmoo experiment {result.experiment}", section.arguments(config), f"--seed {result.seed}"]
    if section.draws_conditions:
        words.append(f"--condition-seed {config.get('condition_seed', 0)}")
    words += ["--senses perfect"] if config.get("senses") == "perfect" else []
    words += ["--quick"] if config.get("quick") else []
    return " ".join(word for word in words if word)


def _anchor(name: str) -> str:
    """The anchor of a heading, as GitHub and mkdocs make it."""
    return re.sub(r"[^a-z0-9 -]", "", sections()[name].title.lower()).replace(" ", "-")


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
    """Write the pages from a folder of results."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("folder", type=Path, help="folder of results, such as runs/experiments")
    parser.add_argument("page", type=Path, help="file of the page, such as docs/results.md")
    paths = parser.parse_args()
    write_page(read_results(paths.folder), paths.folder, paths.page, paths.page.parent / "figures")


if __name__ == "__main__":
    main()
