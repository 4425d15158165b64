"""The result of an experiment as JSON, and the options of experiments."""

from __future__ import annotations

import gzip
import hashlib
import json
import math
import zlib
from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict, dataclass, field, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel, ConfigDict, ValidationError

from shmoo_mjx.base.assets import WEIGHTS, asset
from shmoo_mjx.base.files import write_whole
from shmoo_mjx.base.options import SensesName
from shmoo_mjx.base.seeds import MAX_CONDITION_SEED, UNSEEN_SEED, check_seed
from shmoo_mjx.base.versions import versions
from shmoo_mjx.errors import ShmooError

_UNITS = ("m", "mm", "deg", "rad", "s", "ms", "kg", "N")
"""Units at the end of metric names."""


def no_progress(stage: str, fraction: float) -> None:
    """Reports nothing."""


@dataclass(frozen=True)
class ExperimentOptions:
    """Options of the command ``shmoo experiment``."""

    seed: int = 0
    """Seed of trainings, operators and noise."""
    condition_seed: int = 0
    """Seed of the unseen objects or scenarios."""
    quick: bool = False
    """Short form with fewer objects, seeds and updates."""
    data: Path | None = None
    """Data set, for experiments that need one."""
    maps: Path | None = None
    """Folder with map_server maps, for navigation."""
    scenarios: int | None = None
    """Scenarios per map, for navigation."""
    scenario_set: Path | None = None
    """Scenario set, for navigation, in place of ``maps``."""
    weights: Path | None = None
    """Trained weights (default: the shipped ones)."""
    out: Path = Path("runs/experiments")
    """Folder for figures and finished trials, from which an interrupted experiment resumes."""
    progress: Callable[[str, float], None] = no_progress
    """Called with (stage, fraction done)."""
    senses: SensesName = "real"
    """Sensors of the simulated robot."""
    policies: tuple[str, ...] = ()
    """Policies (navigation) or controllers (pushing) to run; all if empty. Users' own are "package.module:Name"."""
    sizes: Mapping[str, Any] = field(default_factory=dict)
    """Fields of the experiment's config to replace, such as ``workers``."""

    def __post_init__(self) -> None:
        check_seed("--seed", self.seed)
        check_seed("--condition-seed", self.condition_seed, MAX_CONDITION_SEED)

    def chosen(self, names: Iterable[str], others: bool = False) -> tuple[str, ...]:
        """The requested ones of the policies or methods ``names``, or all of them, in the order in which they run.

        With ``others``, users' own ("package.module:Name") are allowed and come last.

        Raises:
            ShmooError: a name is unknown.
        """
        names = tuple(names)
        own = tuple(dict.fromkeys(name for name in self.policies if others and ":" in name))
        for name in self.policies:
            if name not in names and name not in own:
                own_too = " and your own as package.module:Name" if others else ""
                raise ShmooError(f"--policies {name}: is not known; choose from {', '.join(names)}{own_too}.")
        return (*(name for name in names if not self.policies or name in self.policies), *own)

    @property
    def weights_file(self) -> Path:
        """File of the requested weights, or of the shipped ones."""
        return self.weights or asset(WEIGHTS)

    @property
    def first_unseen(self) -> int:
        """Seed of the first unseen object."""
        return UNSEEN_SEED + 1000 * self.condition_seed


class ExperimentResult(BaseModel):
    """One experiment's JSON."""

    model_config = ConfigDict(extra="forbid")

    experiment: str
    seed: int
    config: dict[str, Any]
    """Every choice of the run, condition_seed, quick and `weights_id` included."""
    versions: dict[str, str]
    metrics: dict[str, float | None]
    """Flat names; null is a number that this run could not measure, or infinite."""
    paper: dict[str, float]
    """The paper's numbers under the names of the metrics they compare with."""
    rows: list[dict[str, Any]]
    """One per condition, trial or scenario."""


def make_result(
    experiment: str,
    options: ExperimentOptions,
    config: Any,
    metrics: dict[str, Any],
    *,
    paper: dict[str, float],
    rows: list[dict[str, Any]],
) -> ExperimentResult:
    """Assemble a result. NumPy numbers become plain numbers, and values that are not finite become null."""
    settings = asdict(config) if is_dataclass(config) and not isinstance(config, type) else dict(config)
    choices = {
        "condition_seed": options.condition_seed,
        "quick": options.quick,
        "weights": weights_id(options.weights),
        "senses": options.senses,
    }
    return ExperimentResult(
        experiment=experiment,
        seed=options.seed,
        config=_plain(settings | choices),
        versions=versions(),
        metrics=_plain(metrics),
        paper=paper,
        rows=_plain(rows),
    )


def weights_id(weights: Path | None = None) -> str:
    """`file_id` of a weights file (default: of the shipped one)."""
    return file_id(weights or asset(WEIGHTS))


def same_weights(result: ExperimentResult) -> bool:
    """Whether a result was measured with the shipped weights."""
    return str(result.config.get("weights")) == weights_id()


def file_id(file: Path) -> str:
    """The first ten digits of a file's SHA-256."""
    return hashlib.sha256(file.read_bytes()).hexdigest()[:10]


def spread(values: Any) -> dict[str, float]:
    """Mean, standard deviation, median and quartiles of the finite values; NaN if there are none."""
    x = np.asarray(values, dtype=float)
    x = x[np.isfinite(x)]
    if not x.size:
        return dict.fromkeys(("mean", "std", "median", "q25", "q75"), math.nan)
    q25, median, q75 = np.quantile(x, [0.25, 0.5, 0.75])
    return {"mean": float(x.mean()), "std": float(x.std()), "median": float(median), "q25": q25, "q75": q75}


def over_seeds(measure: str, name: str, values: Any) -> dict[str, float]:
    """Metrics MEASURE_NAME (mean) and MEASURE_std_NAME of one value per seed.

    They are infinite if a value is. They are absent if no value is a number.
    """
    x = np.asarray(values, dtype=float)
    x = x[~np.isnan(x)]
    if not x.size:
        return {}
    std = float(x.std()) if np.isfinite(x).all() else math.inf
    return {f"{measure}_{name}": float(x.mean()), f"{measure}_std_{name}": std}


def as_json(result: ExperimentResult) -> bytes:
    """The content of a result's file."""
    return (result.model_dump_json(indent=1) + "\n").encode()


def write_result(path: Path, result: ExperimentResult) -> None:
    """Write the JSON file atomically."""
    write_whole(path, as_json(result))


def read_result(path: Path, command: str = "shmoo experiment --json") -> ExperimentResult:
    """Read a result from its JSON file, compressed or not.

    Args:
        path: the file.
        command: command that writes such files, for the error message.

    Raises:
        ShmooError: the file is not a result.
    """
    try:
        data = path.read_bytes()
        text = (gzip.decompress(data) if path.suffix == ".gz" else data).decode()
        return ExperimentResult.model_validate(json.loads(text))
    except (json.JSONDecodeError, UnicodeDecodeError, EOFError, zlib.error, gzip.BadGzipFile) as error:
        raise ShmooError(f"{path}: is not JSON ({error}); give a file that {command} wrote.") from None
    except ValidationError as error:
        first = error.errors()[0]
        field = ".".join(map(str, first["loc"]))
        raise ShmooError(f"{path}: {field}: {first['msg']}; give a file that {command} wrote.") from None


def table(result: ExperimentResult) -> str:
    """The metrics and the paper's values as a text table."""
    labels = {name: _label(name) for name in result.metrics}
    width = max(map(len, labels.values()), default=0)
    lines = [f"{'metric':{width}}  {'ours':>10}  {'paper':>10}"]
    for name, value in result.metrics.items():
        ours = "-" if value is None else f"{value:.4g}"
        paper = f"{result.paper[name]:.4g}" if name in result.paper else ""
        lines.append(f"{labels[name]:{width}}  {ours:>10}  {paper:>10}".rstrip())
    return "\n".join(lines)


def _label(name: str) -> str:
    """A metric's name in words with its unit at the end: "time_s_low" becomes "time low [s]"."""
    words = name.split("_")
    units = [i for i, word in enumerate(words) if i and word in _UNITS and not words[i - 1].isdigit()]
    unit = f" [{words.pop(units[-1])}]" if units else ""
    return " ".join(words) + unit


def _plain(value: Any) -> Any:
    """The value with all parts converted to JSON types."""
    if isinstance(value, dict):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(v) for v in value]
    if hasattr(value, "tolist"):
        return _plain(value.tolist())
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if value is None or isinstance(value, bool | int | str):
        return value
    return str(value)
