"""``shmoo report``: from a recording of somebody's robot to a page with the verdicts and the body that are right."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from subprocess import CompletedProcess
from typing import Any

import numpy as np
import pyarrow
import pyarrow.csv
import pyarrow.parquet
import pytest

from shmoo_mjx.control.presets import PushConfig
from shmoo_mjx.errors import ShmooError
from shmoo_mjx.learning.weights import load_weights
from shmoo_mjx.planning.reach import Foresight
from shmoo_mjx.plant.engine_mujoco import MujocoEngine
from shmoo_mjx.plant.objects import draw_condition
from shmoo_mjx.plant.scene import build_scene
from shmoo_mjx.plant.trials import command
from shmoo_mjx.report.trace import Trace
from shmoo_mjx.run import custom_log
from shmoo_mjx.run.custom_log import OPTIONAL, REQUIRED, Log, read_log, run_of_log

LogRun = tuple[Log, dict[str, Any], Trace]
ROOT = Path(__file__).resolve().parents[2]
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


@pytest.fixture(scope="module", autouse=True)
def compiled_once() -> Iterator[None]:
    """All logs share the compiled roll-outs of the shipped weights."""
    shared = Foresight(load_weights(), PushConfig())
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(custom_log, "Foresight", lambda weights, config: shared)
        yield


@pytest.fixture(scope="module")
def light() -> dict[str, np.ndarray]:
    return recorded(8.0, 0.4)


@pytest.fixture(scope="module")
def light_run(light: dict[str, np.ndarray], tmp_path_factory: pytest.TempPathFactory) -> LogRun:
    """The log, its result and its trace."""
    log = read_log(written(light, tmp_path_factory.mktemp("light") / "log.csv"))
    return log, *run_of_log(log, (0.25, 0.2), load_weights())


def test_a_light_box_is_known_and_judged(light: dict[str, np.ndarray], light_run: LogRun) -> None:
    log, result, trace = light_run
    np.testing.assert_allclose(np.diff(log.t), 0.1)
    np.testing.assert_allclose(log.object_pose[10, :2], [light["object_x"][20], light["object_y"][20]], atol=0.01)
    assert result["decisions"][0]["manipulable"] and result["decisions"][0]["probability"] > 0.7
    learned = result["learned"]
    assert learned["friction_x"] == pytest.approx(8.0 * 0.4 * 9.81, rel=0.1)
    assert learned["mass"] == pytest.approx(8.0, rel=0.15) and learned["mass_low"] < 8.0 < learned["mass_high"]
    assert result["unexplained"]["learned"] < result["unexplained"]["prior"] - 0.02
    assert np.isfinite(trace.learned[trace.learned_object == 0]).all() and len(trace.t) == len(log.t)


@pytest.mark.slow
def test_what_a_sample_teaches_is_not_known_before(
    light: dict[str, np.ndarray], light_run: LogRun, tmp_path: Path
) -> None:
    short = {name: values[:60] for name, values in light.items()}
    half = run_of_log(read_log(written(short, tmp_path / "log.csv")), (0.25, 0.2), load_weights())[1]
    whole = light_run[2]
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


def at(values: np.ndarray, place: int, value: float) -> np.ndarray:
    return np.where(np.arange(len(values)) == place, value, values)


def odd(values: np.ndarray, which: int) -> np.ndarray:
    return np.where(np.arange(len(values)) % 2 == which, np.nan, values)


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
        (put("t", lambda v: np.r_[0.0, 1.7e9 + v[1:]]), "row 2: 't' is 1.7e+09, which is 1.7e+09 s after"),
        (put("t", lambda v: v + 90.0 * (np.arange(len(v)) > 80)), "row 82: 't' is 194.05"),
        (put("t", lambda v: np.where(np.arange(len(v)) == 7, v[6], v)), "row 8 does not"),
        (put("t", lambda v: at(v, 3, np.nan)), "row 4 does not"),
        (lambda c: {k: v[:0] for k, v in c.items()}, "has a header but no rows"),
        *((put(name, lambda v: np.full(len(v), np.nan)), f"'{name}' holds no numbers") for name in REQUIRED),
        *((put(n, lambda v: at(v, 4, np.inf)), f"row 5: '{n}' is not finite") for n in (*REQUIRED[1:], *OPTIONAL)),
        (put("object_y", lambda v: at(v, 159, 1e9)), "row 160: 'object_y' is 1e+09, more than 100"),
        (put("object_x", lambda v: at(v, 9, 1e9)), "'object_x' changes by more than 5 m/s, as in row 10"),
        (put("robot_x", lambda v: at(v, 9, -1e12)), "row 10: 'robot_x' is -1e+12"),
        (put("force_y", lambda v: at(v, 9, 1e30)), "row 10: 'force_y' is 1e+30, more than 10000"),
        (
            lambda c: c | {"object_x": odd(c["object_x"], 0), "object_y": odd(c["object_y"], 1)},
            "are never known together while the hands push",
        ),
    ],
)
def test_a_bad_log_is_refused_with_its_column(
    light: dict[str, np.ndarray], tmp_path: Path, change: Change, says: str
) -> None:
    file = written(change(light), tmp_path / "log.csv")
    with pytest.raises(ShmooError, match=re.escape(says)) as refused:
        read_log(file)
    assert str(refused.value).startswith(f"{file}: ") and "\n" not in str(refused.value)


def as_text(columns: dict[str, np.ndarray], delimiter: str = ",", point: str = ".", header: str = "") -> str:
    rows = np.stack([*columns.values()], axis=-1).tolist()
    lines = [header or delimiter.join(columns)]
    lines += [delimiter.join(repr(v).replace(".", point) for v in row) for row in rows]
    return "\n".join(lines) + "\n"


def test_tables_of_other_programs_are_the_same_log(light: dict[str, np.ndarray], tmp_path: Path) -> None:
    expected = read_log(written(light, tmp_path / "log.parquet"))
    text = as_text(light)
    same = {
        "commas": text,
        "semicolons": as_text(light, ";"),
        "tabs": as_text(light, "\t"),
        "spaces": as_text(light, " , "),
        "quotes": as_text(light, header=",".join(f'"{name}"' for name in light)),
        "mark": "\ufeff" + text,
        "Windows": text.replace("\n", "\r\n"),
        "blank lines": "\n" + text.replace("\n", "\n\n"),
        "ends": text.replace("\n", ",\n"),
        "another column": "note," + text.replace("\n", '\n"a; b, c",', len(light["t"])),
    }
    for name, content in same.items():
        (tmp_path / "log.csv").write_bytes(content.encode())
        for one, other in zip(read_log(tmp_path / "log.csv"), expected, strict=True):
            np.testing.assert_array_equal(one, other, name)


def test_a_bad_table_is_refused(light: dict[str, np.ndarray], tmp_path: Path) -> None:
    text = as_text(light)
    names = list(light)
    for content, says in (
        (as_text(light, ";", ","), "row 1: the column 't' holds '100,0'; write a point for the decimal comma"),
        (as_text(light, ",", ","), "row 1 has 20 cells, the header 10; write a point"),
        (text + "1,2\n", "row 161 has 2 cells, the header 10"),
        (text.replace("torque", "t"), "the column 't' stands 2 times"),
        (text.replace("torque", " object_x "), "the column 'object_x' stands 2 times"),
        ("", "no CSV with a header"),
        ("\n \n", "no CSV with a header"),
        (",".join(names) + "\n", "has a header but no rows"),
        (text.encode("utf-16"), "no CSV with a header"),
        (bytes(range(256)) * 9, "no CSV with a header"),
    ):
        (tmp_path / "log.csv").write_bytes(content if isinstance(content, bytes) else content.encode())
        with pytest.raises(ShmooError, match=re.escape(says)):
            read_log(tmp_path / "log.csv")
    table = pyarrow.table([*light.values(), light["t"]], names=[*names, "t"])
    pyarrow.parquet.write_table(table, tmp_path / "log.parquet")
    with pytest.raises(ShmooError, match="the column 't' stands 2 times"):
        read_log(tmp_path / "log.parquet")


def test_a_log_in_which_the_object_is_rarely_known_has_a_result(light: dict[str, np.ndarray], tmp_path: Path) -> None:
    known = (np.arange(160) > 13) & (np.arange(160) < 20)
    file = written(light | {"object_x": np.where(known, light["object_x"], np.nan)}, tmp_path / "log.csv")
    result, _ = run_of_log(read_log(file), (0.25, 0.2), load_weights())
    assert "nan" not in json.dumps(result).lower()


def turned(columns: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    return columns | {name: -columns[name] for name in ("force_x", "force_y", "torque")}


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda c: c, ()),
        (turned, ("against its motion",)),
        (put("force_x", lambda v: 100 * v), ("not plausible",)),
        (put("object_yaw", lambda v: 90.0 + np.degrees(v) / 10), ("'object_yaw' goes up to 90", "in degrees")),
        (put("robot_yaw", lambda v: 180.0 + np.degrees(v)), ("'robot_yaw' goes up to 18", "in degrees")),
    ],
)
def test_doubtful_results_warn(
    light: dict[str, np.ndarray], tmp_path: Path, change: Change, says: tuple[str, ...]
) -> None:
    result, _ = run_of_log(read_log(written(change(light), tmp_path / "log.csv")), (0.25, 0.2), load_weights())
    text = " ".join(result["warnings"])
    assert bool(text) == bool(says) and text in result["summary"]
    assert all(part in text for part in says), text


@pytest.mark.slow
def test_the_command_prints_what_is_doubtful(
    light: dict[str, np.ndarray],
    shmoo: Callable[..., CompletedProcess[str]],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    monkeypatch.chdir(tmp_path)
    written(turned(light), tmp_path / "my $x$ log.csv")
    done = shmoo("report", "my $x$ log.csv", "--size", "0.5", "0.4")
    assert done.returncode == 0, done.stderr
    assert any("against its motion" in record.getMessage() for record in caplog.records)
    page = (tmp_path / "runs" / "report" / "report.html").read_text()
    assert "against its motion" in page and "shmoo report &#39;my $x$ log.csv&#39; --size" in page


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
    text = (ROOT / "docs" / "how_to" / "recording.md").read_text()
    assert all(f"`{name}`" in text for name in (*REQUIRED, *OPTIONAL))
