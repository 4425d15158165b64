"""``shmoo report``: from a recording of somebody's robot to a page with the verdicts and the body that are right."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from subprocess import CompletedProcess

import numpy as np
import pyarrow
import pyarrow.csv
import pyarrow.parquet
import pytest

from shmoo_mjx.custom_log import OPTIONAL, REQUIRED, read_log, run_of_log
from shmoo_mjx.errors import ShmooError
from shmoo_mjx.learning.weights import load_weights
from shmoo_mjx.plant.engine_mujoco import MujocoEngine
from shmoo_mjx.plant.objects import draw_condition
from shmoo_mjx.plant.scene import build_scene
from shmoo_mjx.plant.trials import command

ROOT = Path(__file__).resolve().parents[1]
STEP = 0.05


def recorded(mass: float, friction: float, noise: float = 0.002) -> dict[str, np.ndarray]:
    """A box of 0.5 m by 0.4 m, leant against twice at 20 Hz, as a motion capture system and a force sensor see it."""
    box = draw_condition("box", 3, {"size": [0.5, 0.4, 0.6], "mass": mass, "payload": 0.0, "friction": friction})
    engine = MujocoEngine([build_scene([(box, (0.72, 0.0, 0.0))])])
    world, rng = engine.init(), np.random.default_rng(0)
    rows: dict[str, list[float]] = {name: [] for name in (*REQUIRED, *OPTIONAL)}
    before = engine.observe(world)
    for k in range(160):
        lean = 0.09 if k % 80 < 50 else -0.05
        world, seen = engine.step(world, command(1, (lean, 0.0), reach=0.42, hand_height=0.38), duration=STEP)
        pose = before.object_pose[0, 0] + noise * rng.normal(size=3)
        for name, value in zip(("object_x", "object_y", "object_yaw"), pose, strict=True):
            rows[name].append(value)
        for name, value in zip(("force_x", "force_y", "torque"), seen.wrench[0, 0], strict=True):
            rows[name].append(value + 0.3 * rng.normal())
        for name, value in zip(("robot_x", "robot_y", "robot_yaw"), before.robot_pose[0], strict=True):
            rows[name].append(value)
        rows["t"].append(100.0 + k * STEP)
        before = seen
    engine.close()
    return {name: np.array(values) for name, values in rows.items()}


def written(columns: dict[str, np.ndarray], file: Path) -> Path:
    table = pyarrow.table(columns)
    (pyarrow.parquet.write_table if file.suffix == ".parquet" else pyarrow.csv.write_csv)(table, file)
    return file


@pytest.fixture(scope="module")
def light() -> dict[str, np.ndarray]:
    return recorded(8.0, 0.4)


def test_a_light_box_is_identified_and_judged(light: dict[str, np.ndarray], tmp_path: Path) -> None:
    log = read_log(written(light, tmp_path / "log.csv"))
    np.testing.assert_allclose(np.diff(log.t), 0.1)
    np.testing.assert_allclose(log.object_pose[10, :2], [light["object_x"][20], light["object_y"][20]], atol=0.01)
    result, trace = run_of_log(log, (0.25, 0.2), load_weights())
    assert result["decisions"][0]["manipulable"] and result["decisions"][0]["probability"] > 0.9
    mass, friction = (np.exp(result["learned"][name]) for name in ("log_mass", "log_friction_x"))
    assert mass == pytest.approx(8.0, rel=0.1) and friction == pytest.approx(0.4, rel=0.1)
    assert result["unexplained"]["learned"] < result["unexplained"]["prior"] - 0.05
    assert np.isfinite(trace.learned[trace.learned_object == 0]).all() and len(trace.t) == len(log.t)


def test_what_a_sample_teaches_is_not_known_before(light: dict[str, np.ndarray], tmp_path: Path) -> None:
    short = {name: values[:60] for name, values in light.items()}
    half, whole = (
        run_of_log(read_log(written(c, tmp_path / "log.csv")), (0.25, 0.2), load_weights())[1] for c in (short, light)
    )
    count = len(half.t) - 4
    np.testing.assert_allclose(half.learned[:count], whole.learned[:count], rtol=1e-4)


def test_a_heavy_one_can_t_be_moved(tmp_path: Path) -> None:
    log = read_log(written(recorded(60.0, 0.6), tmp_path / "log.parquet"))
    result, _ = run_of_log(log, (0.25, 0.2), load_weights())
    assert [d["manipulable"] for d in result["decisions"]] == [False] * len(result["decisions"]) != []
    assert result["objects"][0]["registered"] and "too little to tell its mass" in result["summary"]


def test_the_command_writes_the_page_from_what_must_be_there_alone(
    light: dict[str, np.ndarray],
    shmoo: Callable[..., CompletedProcess[str]],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    least = {name: values for name, values in light.items() if name in REQUIRED}
    least["object_x"] = np.where(np.arange(160) % 7 == 0, np.nan, least["object_x"])  # lost now and then
    written(least, tmp_path / "log.csv")
    monkeypatch.chdir(tmp_path)
    done = shmoo("report", "log.csv", "--size", "0.5", "0.4")
    assert done.returncode == 0, done.stderr
    page = (tmp_path / "runs" / "report" / "report.html").read_text()
    for text in ("moves like", "can be moved", "shmoo report log.csv --size 0.5 0.4", "What it learned on the way"):
        assert text in page
    result = json.loads((tmp_path / "runs" / "report" / "result.json").read_text())
    assert set(result["learned"]) == set(result["prior"])
    again = shmoo("report", "runs/report")
    assert again.returncode == 0 and "report.html" in again.stdout


Change = Callable[[dict[str, np.ndarray]], dict[str, np.ndarray]]


def put(name: str, change: Callable[[np.ndarray], object]) -> Change:
    return lambda columns: columns | {name: change(columns[name])}  # type: ignore[dict-item]


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda c: {k: v for k, v in c.items() if k != "force_y"}, "the column 'force_y' is missing; did you mean"),
        (lambda c: {"a": c["t"]}, "the column 't' is missing; there are a"),
        (put("object_yaw", lambda v: np.array(["east"] * len(v))), "'object_yaw' holds 'east'; give numbers"),
        (put("t", lambda v: v[::-1]), "the column 't' must grow from row to row, in s; row 2"),
        (put("t", lambda v: 10 * v), "at least 1 s with 10 rows each second"),
        (put("object_x", lambda v: 1000 * v), "'object_x' changes by more than 5 m/s"),
        (put("object_yaw", lambda v: 57.3 * np.arange(len(v))), "'object_yaw' changes by more than 10 rad/s"),
        (put("force_x", lambda v: 0.001 * v), "never reach 2 N"),
    ],
)
def test_a_bad_log_is_refused_with_its_column(
    light: dict[str, np.ndarray], tmp_path: Path, change: Change, says: str
) -> None:
    file = written(change(light), tmp_path / "log.csv")
    with pytest.raises(ShmooError, match=says.replace("(", "\\(")) as refused:
        read_log(file)
    assert str(refused.value).startswith(f"{file}: ") and "\n" not in str(refused.value)


def test_bad_input_of_the_command_is_one_sentence_with_exit_code_2(
    shmoo: Callable[..., CompletedProcess[str]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "odd.parquet").write_bytes(b"nothing")
    (tmp_path / "empty").mkdir()
    for arguments, says in (
        (("gone.csv", "--size", "1", "1"), "there is no such file"),
        (("odd.parquet", "--size", "1", "1"), "no Parquet file"),
        (("odd.parquet",), "--size LENGTH WIDTH"),
        (("odd.parquet", "--size", "1", "-1"), "--size '-1' must be a number"),
        (("empty",), "there is no result here"),
    ):
        done = shmoo("report", *arguments)
        assert done.returncode == 2 and len(done.stderr.splitlines()) == 1, done.stderr
        assert done.stderr.startswith("shmoo: ") and says in done.stderr


def test_the_page_in_the_documentation_lists_every_column() -> None:
    text = (ROOT / "docs" / "make_your_own.md").read_text()
    assert all(f"`{name}`" in text for name in (*REQUIRED, *OPTIONAL))
