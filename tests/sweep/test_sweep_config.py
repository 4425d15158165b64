"""A sweep file is read or refused in one sentence."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from shmoo_mjx.errors import ShmooError
from shmoo_mjx.report.tables import markdown_table
from shmoo_mjx.sweep.config import Draw, SweepConfig, load_sweep, quick, sweep_fingerprint
from shmoo_mjx.sweep.parameters import PARAMETERS

ROOT = Path(__file__).resolve().parents[2]
WEIGHTS = ROOT / "experiments/weights/demo.safetensors"


def written(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "sweep.yaml"
    path.write_text(text)
    return path


@pytest.mark.parametrize("path", sorted((ROOT / "experiments/sweeps").glob("*.yaml")), ids=lambda p: p.stem)
def test_shipped_sweeps_load_and_ask_something(path: Path) -> None:
    config = load_sweep(path)
    assert config.question and config.varied and config.map
    assert set(quick(config).controllers) == set(config.controllers)
    assert quick(config).worlds < config.worlds


def test_a_bare_number_holds_in_every_world(tmp_path: Path) -> None:
    config = load_sweep(written(tmp_path, "vary: {object.mass: 5, delay.command: {choice: [0, 0.1]}}"))
    assert config.vary["object.mass"].fixed == 5.0
    assert config.varied == ["delay.command"]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("vary: {object.mas: 5}", ("object.mas", "did you mean 'object.mass'?")),
        ("vary: {object.mass: {uniform: [5, 2]}}", ("vary.object.mass", "smaller number first")),
        ("vary: {object.mass: {uniform: [1, 2], choice: [3]}}", ("needs a number or one of", "log_uniform")),
        ("vary: {object.mass: {unifrm: [1, 2]}}", ("unifrm", "did you mean 'uniform'?")),
        ("vary: {object.mass: {log_uniform: [0, 2]}}", ("above zero",)),
        ("vary: {object.mass: {uniform: [0.1, 2]}}", ("object.mass = 0.1", "between 0.5 and 500 kg")),
        ("vary: {object.mass: heavy}", ("vary.object.mass", "heavy")),
        ("controllers: {ours: {kind: mpi}}", ("controllers.ours.kind", "'mppi' or 'quasi_static'")),
        ("controllers: {ours: {sample: 3}}", ("sample", "did you mean 'samples'?")),
        ("controllers: {'../x': {}}", ("name files",)),
        ("families: [bx]", ("bx", "did you mean 'box'?")),
        ("families: [mine.json]", ("mine.json", "not there")),
        ("families: [a/chair.json, b/chair.json]", ("two families of one name",)),
        ("map: [object.mass, object.friction]", ("object.mass", "not varied")),
        ("vary: {object.mass: {uniform: ['2', 3]}}", ("vary.object.mass.uniform[0]", "without quotes")),
        ("vary: {object.mass: {uniform: [1:30, 300]}}", ("vary.object.mass.uniform[0]", "number")),
        ("controllers: {ours: {temperature: yes}}", ("controllers.ours.temperature", "number")),
        ("worlds: '5'", ("worlds", "without quotes")),
        ("worlds: 0", ("worlds", "greater than or equal to 1")),
        ("wolrds: 5", ("did you mean 'worlds'?",)),
        ("- 1", ("mapping",)),
    ],
)
def test_a_fault_is_one_sentence_with_its_place_and_remedy(tmp_path: Path, text: str, words: tuple[str, ...]) -> None:
    path = written(tmp_path, text)
    with pytest.raises(ShmooError) as caught:
        load_sweep(path)
    message = str(caught.value)
    assert message.startswith(str(path)) and "\n" not in message
    assert all(word in message for word in words), message


@given(st.integers(0, 1000), st.floats(0.6, 10.0), st.floats(0.1, 400.0))
def test_draws_stay_where_they_belong(seed: int, low: float, width: float) -> None:
    mass, rng = PARAMETERS["object.mass"], np.random.default_rng(seed)
    for kind in ("uniform", "log_uniform"):
        drawn = Draw(**{kind: (low, low + width)}).at(rng, mass.low, mass.high)
        assert low <= drawn <= low + width * (1 + 1e-9)
    assert mass.low <= Draw(normal=(low, 1000.0)).at(rng, mass.low, mass.high) <= mass.high
    assert Draw(choice=(low, width)).at(rng, mass.low, mass.high) in (low, width)


def test_what_decides_about_the_rows_is_in_the_fingerprint(tmp_path: Path) -> None:
    plain = SweepConfig(vary={"object.mass": Draw(uniform=(2, 3))})
    same = plain.model_copy(update={"question": "why?", "worlds": 512})
    assert sweep_fingerprint(plain, WEIGHTS) == sweep_fingerprint(same, WEIGHTS)
    for change in ({"seed": 1}, {"seconds": 7}, {"tolerance_m": 0.1}, {"vary": {}}, {"first_object": 3}):
        assert sweep_fingerprint(plain.model_copy(update=change), WEIGHTS) != sweep_fingerprint(plain, WEIGHTS)
    other = tmp_path / "other"
    other.write_bytes(WEIGHTS.read_bytes() + b"x")
    assert sweep_fingerprint(plain, other) != sweep_fingerprint(plain, WEIGHTS)


def table() -> str:
    rows = []
    for name, p in PARAMETERS.items():
        if name.startswith("gains."):
            continue
        nominal = "the object's seed" if p.default is None else f"{p.default:g}"
        bounds = f"{p.low:g} and {p.high:g}" if math.isfinite(p.high) else f"from {p.low:g} on"
        rows.append((f"`{name}`", p.text, p.unit, nominal, bounds))
    return markdown_table(("parameter", "what it is", "unit", "nominal", "between"), rows)


def test_the_page_lists_the_parameters() -> None:
    page = (ROOT / "docs/sweeps.md").read_text()
    assert f"\n\n{table()}\n\n" in page and "`gains.NAME`" in page
    example = page.partition("    question: Over")[2].partition("    map:")[0]
    text = "\n".join(line[4:] for line in ("    question: Over" + example).splitlines())
    assert SweepConfig.model_validate(yaml.safe_load(text)).varied
