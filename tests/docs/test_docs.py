"""The documentation says what the code says: tables, links, names, examples, and the direction of imports."""

from __future__ import annotations

import ast
import dataclasses
import re
import tokenize
from graphlib import TopologicalSorter
from pathlib import Path

import pytest
import yaml

from shmoo_mjx.dynamics import features
from shmoo_mjx.planning.scenario import Scenario
from shmoo_mjx.plant.condition import Condition
from shmoo_mjx.plant.objects import FAMILIES, draw_condition

ROOT = Path(__file__).resolve().parents[2]
PAGES = [
    "README.md",
    "CONTRIBUTING.md",
    "CHANGELOG.md",
    "paper.md",
    *(str(p.relative_to(ROOT)) for p in sorted((ROOT / "docs").rglob("*.md"))),
]
SOURCES = sorted((ROOT / "shmoo_mjx").rglob("*.py"))
LINK = re.compile(r"\[([^\]]*)\]\(([^)\s]+)\)")
ON_GITHUB = "../../actions/"
"""Beginning of links to the host of the repository, relative to its front page."""
FENCED = re.compile(r"^```.*?^```", re.DOTALL | re.MULTILINE)
LONGEST_PAGE = 250
PRIVATE = re.compile(
    r"\b(hindsight|mended|mending|forerunners?|earlier versions?|formerly|previously|used to be|fresh draws?|"
    r"draws? \d+|missed aims?|livelock|dearest)\b",
    re.IGNORECASE,
)
"""Words of this project's history, which say nothing to a reader who arrives today."""
COMMIT = re.compile(r"(?<![\w.#/-])(?=[0-9a-f]*\d)(?=[0-9a-f]*[a-f])[0-9a-f]{7,40}(?![\w-])")


def read(page: str) -> str:
    return (ROOT / page).read_text(encoding="utf-8")


def names_in(source: Path) -> set[str]:
    """Functions, methods, classes and module-level names of a Python file."""
    tree = ast.parse(source.read_text(encoding="utf-8"))
    defined = {n.name for n in ast.walk(tree) if isinstance(n, ast.FunctionDef | ast.ClassDef)}
    targets = [t for n in tree.body if isinstance(n, ast.Assign) for t in n.targets]
    return defined | {t.id for t in targets if isinstance(t, ast.Name)}


@pytest.mark.parametrize("name", ["ROBOT_INPUTS", "ROBOT_OUTPUTS", "OBJECT_INPUTS", "OBJECT_OUTPUTS"])
def test_the_models_page_holds_the_codes_table(name: str) -> None:
    assert "\n\n" + features.markdown_table(getattr(features, name)) + "\n" in read("docs/models.md")


@pytest.mark.parametrize("page", PAGES)
def test_links_lead_somewhere(page: str) -> None:
    assert not [target for _, target in LINK.findall(read(page)) if not leads_somewhere(page, target)]


def leads_somewhere(page: str, target: str) -> bool:
    """Whether file and heading exist to which a page links; links to other sites are not followed."""
    if "://" in target or target.startswith(ON_GITHUB):
        return True
    name, _, anchor = target.partition("#")
    file = (ROOT / page).parent / name if name else ROOT / page
    return file.exists() and (not anchor or file.suffix != ".md" or anchor in anchors(file.read_text("utf-8")))


def anchors(text: str) -> set[str]:
    """Anchors of a page's headings, as GitHub and the site name them."""
    headings = re.findall(r"^#+ (.+)$", FENCED.sub("", text), re.MULTILINE)
    return {re.sub(r"\s+", "-", re.sub(r"[^\w\s-]", "", heading.lower()).strip()) for heading in headings}


def test_a_link_to_a_missing_heading_is_found() -> None:
    assert leads_somewhere("docs/gym.md", "#many-worlds") and leads_somewhere("README.md", "docs/gym.md#many-worlds")
    assert not leads_somewhere("docs/gym.md", "#no-worlds") and not leads_somewhere("README.md", "docs/none.md")


def test_pages_that_the_code_names_exist() -> None:
    for source in SOURCES:
        named = re.findall(r"\b((?:docs|examples)/[\w/]+\.(?:md|py|ipynb))\b", source.read_text(encoding="utf-8"))
        assert not [page for page in named if not (ROOT / page).exists()], source


def prose_of(source: Path) -> list[str]:
    """Comments and docstrings of a Python file."""
    with source.open("rb") as file:
        tokens = list(tokenize.tokenize(file.readline))
    return [t.string for t in tokens if t.type == tokenize.COMMENT or t.string.startswith(('"""', 'r"""'))]


def history_in(text: str) -> list[str]:
    return [match[0] for match in (*PRIVATE.finditer(text), *COMMIT.finditer(text))]


@pytest.mark.parametrize("page", sorted({*PAGES} - {"CHANGELOG.md"}))
def test_pages_speak_of_the_present(page: str) -> None:
    assert not history_in(read(page))


def test_docstrings_and_comments_speak_of_the_present() -> None:
    found = {source: history_in("\n".join(prose_of(source))) for source in SOURCES}
    assert not {source: words for source, words in found.items() if words}


def test_history_is_recognised() -> None:
    assert history_in("Mended since draw 112 (commit 8f121ec), formerly wrong.") == [
        "Mended", "draw 112", "formerly", "8f121ec",
    ]  # fmt: skip
    assert not history_in("Draw the map: 1000000 samples, decade, e2e, 0x1f2e3d4c, mass 5.0e-07.")


@pytest.mark.parametrize("page", ["docs/index.md", "paper.md"])
def test_numbers_of_other_pages_are_those_of_the_readme(page: str) -> None:
    rows = [line.rstrip(" |") for line in read(page).splitlines() if line.startswith("| ")]
    assert len(rows) >= 3 and all(f"\n{row} |" in read("README.md") for row in rows)


def test_words_are_spelt_right(capsys: pytest.CaptureFixture[str]) -> None:
    codespell = pytest.importorskip("codespell_lib", reason="codespell is not installed")
    folders = ["shmoo_mjx", "benchmarks", "examples", "docs"]
    sources = [str(path) for folder in folders for path in sorted((ROOT / folder).rglob("*.py"))]
    wrong = codespell.main("--toml", str(ROOT / "pyproject.toml"), *sources, *(str(ROOT / page) for page in PAGES))
    assert not wrong, capsys.readouterr().out


@pytest.mark.parametrize("page", PAGES)
def test_no_page_is_long(page: str) -> None:
    assert len(read(page).splitlines()) <= LONGEST_PAGE


def test_the_paper_map_names_functions_that_exist() -> None:
    for text, target in LINK.findall(read("docs/paper_map.md")):
        if target.endswith(".py"):
            wanted = set(re.findall(r"`(\w+)`", text))
            assert wanted <= names_in(ROOT / "docs" / target), target


def test_the_paper_map_names_settings_that_exist() -> None:
    deviations = read("docs/paper_map.md").partition("## Deviations")[2]
    bracketed = re.findall(r"\((`[^)]*`)\)", deviations)
    wanted = {name for names in bracketed for name in re.findall(r"`(\w+)`", names)}
    known: set[str] = set()
    for source in (ROOT / "shmoo_mjx").rglob("*.py"):
        tree = ast.parse(source.read_text(encoding="utf-8"))
        known |= names_in(source)
        annotated = [n.target for n in ast.walk(tree) if isinstance(n, ast.AnnAssign)]
        known |= {target.id for target in annotated if isinstance(target, ast.Name)}
    assert wanted and not wanted - known


def test_the_deviations_are_one_numbered_list() -> None:
    deviations = read("docs/paper_map.md").partition("## Deviations")[2]
    numbers = [int(n) for n in re.findall(r"^(\d+)\. ", deviations, re.MULTILINE)]
    assert numbers == list(range(1, len(numbers) + 1)) and numbers


def test_every_equation_and_figure_of_the_paper_has_a_row() -> None:
    page = read("docs/paper_map.md").partition("## Deviations")[0]
    first_cells = " ".join(line.split("|")[1] for line in page.splitlines() if line.startswith("|"))
    for item in [f"Eq. {n}" for n in range(1, 10)] + [f"Fig. {n}" for n in range(1, 9)] + ["Algorithm 1"]:
        assert re.search(rf"{re.escape(item)}(?!\d)", first_cells), item


def test_the_example_scenario_is_one() -> None:
    example = re.search(r"```yaml\n(.*?)```", read("docs/scenario.md"), re.DOTALL)
    assert example
    scenario = Scenario.model_validate(yaml.safe_load(example[1]))
    conditions = [draw_condition(o.family, o.seed, o.properties) for o in scenario.objects]
    assert conditions[0].mass == 3.0 and conditions[1].locked == (True, True, False, False)


def test_the_scenario_page_lists_every_property_and_family() -> None:
    page = read("docs/scenario.md")
    properties = {f.name for f in dataclasses.fields(Condition)} - {"family", "seed"}
    assert all(f"`{name}`" in page for name in properties | set(FAMILIES))


def test_the_readme_begins_with_its_two_lines() -> None:
    block = re.search(r"```bash\n(.*?)```", read("README.md"), re.DOTALL)
    assert block
    assert block[1].splitlines() == ["pip install uv && uv run shmoo demo", "pip install uv && uv run pytest"]
    assert "(pip install uv && uv run pytest)" in read(".ci/run")


LAYERS = (
    {"arrays", "base", "errors", "geometry", "types"},
    {"plant", "dynamics"},
    {"sensing"},
    {"data"},
    {"learning"},
    {"control"},
    {"planning"},
    {"behavior"},
    {"report"},
    {"run"},
    {"evaluation", "gym"},
    {"sweep", "live"},
    {"cli"},
)


def imports_of(source: Path) -> set[str]:
    """Modules and names of the package that a file imports, also inside functions."""
    nodes = ast.walk(ast.parse(source.read_text(encoding="utf-8")))
    froms = [n for n in nodes if isinstance(n, ast.ImportFrom) and (n.module or "").startswith("shmoo_mjx")]
    return {f"{n.module}.{alias.name}" for n in froms for alias in n.names}


def test_imports_point_one_way() -> None:
    rank = {part: i for i, layer in enumerate(LAYERS) for part in layer}
    for source in (ROOT / "shmoo_mjx").rglob("*.py"):
        part = source.relative_to(ROOT / "shmoo_mjx").parts[0].removesuffix(".py")
        for other in (name.split(".")[1] for name in imports_of(source)):
            allowed = other == part or rank.get(part, 0) > rank.get(other, 0) or rank[part] == rank[other] == 0
            assert allowed, f"{source.relative_to(ROOT)} imports {other}"


def test_no_modules_import_each_other() -> None:
    names = {
        ".".join(p.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__"): p
        for p in (ROOT / "shmoo_mjx").rglob("*.py")
    }
    graph = {
        name: {m if m in names else m.rpartition(".")[0] for m in imports_of(path)} & set(names) - {name}
        for name, path in names.items()
    }
    assert list(TopologicalSorter(graph).static_order())  # a CycleError names the circle
