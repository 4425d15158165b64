"""The sweep file: which parameters vary, over how many worlds, for which object families and controllers.

question: Over which mass and friction does one push succeed?
worlds: 512                       # per family and controller
families: [box]
controllers:
  ours: {kind: mppi}
  quasi_static: {kind: quasi_static}
vary:
  object.mass: {log_uniform: [2, 60]}
  object.friction: {uniform: [0.1, 0.9]}
map: [object.mass, object.friction]   # axes of the map of success rates
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field, field_validator, model_validator

from shmoo_mjx.base.fingerprints import fingerprint
from shmoo_mjx.base.options import SensesName
from shmoo_mjx.base.schema import Number, WholeNumber, closest_name, validated
from shmoo_mjx.base.seeds import MAX_SEED, UNSEEN_SEED
from shmoo_mjx.base.yaml_input import read_mapping
from shmoo_mjx.errors import ShmooError
from shmoo_mjx.plant.objects import FAMILIES
from shmoo_mjx.sweep.parameters import PARAMETERS

_KINDS = ("fixed", "uniform", "log_uniform", "normal", "choice")


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class Draw(_Strict):
    """Distribution of a parameter. A plain number gives the same value in every world."""

    fixed: Number | None = None
    uniform: tuple[Number, Number] | None = None
    log_uniform: tuple[Number, Number] | None = None
    normal: tuple[Number, Number] | None = None
    """Mean and standard deviation of a normal distribution, clipped to the parameter's bounds."""
    choice: tuple[Number, ...] | None = None

    @model_validator(mode="before")
    @classmethod
    def _number(cls, value: object) -> object:
        return {"fixed": value} if isinstance(value, int | float) and not isinstance(value, bool) else value

    @model_validator(mode="after")
    def _one_kind(self) -> Draw:
        kinds = [kind for kind in _KINDS if getattr(self, kind) is not None]
        if len(kinds) != 1:
            raise ValueError(f"needs a number or one of {', '.join(_KINDS[1:])}.")
        kind, value = kinds[0], getattr(self, kinds[0])
        if kind in ("uniform", "log_uniform") and not value[0] < value[1]:
            raise ValueError(f"has {kind} from {value[0]:g} to {value[1]:g}; give the smaller number first.")
        if kind == "log_uniform" and not value[0] > 0:
            raise ValueError("has a log_uniform that is not above zero; use uniform.")
        if kind == "normal" and not value[1] > 0:
            raise ValueError("has a normal without spread; give [mean, standard deviation above zero].")
        if kind == "choice" and not value:
            raise ValueError("has an empty choice; give at least one number.")
        return self

    @property
    def values(self) -> tuple[float, ...]:
        """The numbers of the distribution that must lie within the parameter's bounds."""
        one = (self.fixed,) if self.fixed is not None else self.normal[:1] if self.normal else None
        values = one or self.uniform or self.log_uniform or self.choice
        assert values is not None
        return values

    def at(self, rng: Any, low: float, high: float) -> float:
        """Sample one value.

        Args:
            rng: NumPy generator.
            low: lower bound, for a normal distribution.
            high: upper bound, for a normal distribution.
        """
        if self.fixed is not None:
            return self.fixed
        if self.uniform:
            return float(rng.uniform(*self.uniform))
        if self.log_uniform:
            return math.exp(rng.uniform(math.log(self.log_uniform[0]), math.log(self.log_uniform[1])))
        if self.normal:
            return min(max(float(rng.normal(*self.normal)), low), high)
        assert self.choice is not None
        return self.choice[int(rng.integers(len(self.choice)))]


class Controller(_Strict):
    """Settings of one controller. All controllers of a sweep run in the same worlds."""

    kind: Literal["mppi", "quasi_static"] = "mppi"
    """mppi (the pushing controller) or quasi_static (a baseline without a model, control/quasi_static.py)."""
    samples: WholeNumber = Field(default=500, ge=16, le=100_000)
    """Number of MPPI roll-outs S."""
    horizon: WholeNumber = Field(default=30, ge=1, le=200)
    """Number of MPPI steps T of 0.1 s."""
    temperature: Number = Field(default=0.7, gt=0)
    """MPPI temperature lambda. Larger values average over more roll-outs."""
    adapts: bool = True
    """Whether the estimate of the object adapts. If not, it stays at the prior."""
    governor: Number = Field(default=0.25, ge=0)
    """Gain of the governor from speed error to lean [rad s/m]; 0 switches the governor off."""
    speed_limit: Number = Field(default=0.16, gt=0, le=1)
    """Speed of the robot above which the MPPI cost grows [m/s]."""


class SweepConfig(_Strict):
    """Content of a sweep file."""

    question: str = ""
    """The question that the sweep answers; title of figures and tables."""
    seed: WholeNumber = Field(default=0, ge=0, le=MAX_SEED)
    worlds: WholeNumber = Field(default=256, ge=1, le=10_000_000)
    """Number of worlds per family and controller. World i of a family is the same for all controllers."""
    families: tuple[str, ...] = Field(default=("box",), min_length=1)
    controllers: dict[str, Controller] = Field(default_factory=lambda: {"ours": Controller()}, min_length=1)
    vary: dict[str, Draw] = Field(default_factory=dict)
    first_object: WholeNumber = Field(default=UNSEEN_SEED, ge=0, le=MAX_SEED)
    """Object seed of world 0; world i uses this plus i. Training never uses seeds from 1,000,000 on."""
    seconds: WholeNumber = Field(default=20, ge=1, le=600)
    """Maximum duration of a push [s], including 1 s in which the arms extend."""
    face: WholeNumber = Field(default=0, ge=0, le=3)
    """Pushed face: 0 rear, 1 right, 2 front, 3 left."""
    tolerance_m: Number = Field(default=0.25, gt=0)
    """Maximum distance between the object's final position and its goal for a success [m]."""
    tolerance_deg: Number = Field(default=20.0, gt=0)
    """Maximum yaw error for a success [deg]."""
    senses: SensesName = "real"
    """Sensing: real (docs/sensing.md) or perfect (ground truth). Swept noise and delay apply to both."""
    shard: WholeNumber = Field(default=256, ge=1)
    """Number of worlds per results file. An interruption loses at most one such file."""
    map: tuple[str, str] | None = None
    """Two varied parameters, the axes of the map of success rates."""

    @field_validator("families")
    @classmethod
    def _existing_families(cls, value: tuple[str, ...]) -> tuple[str, ...]:
        for name in value:
            if name not in FAMILIES and not name.endswith(".json"):
                raise ValueError(f"has {name!r}, no object family; {closest_name(name, FAMILIES)}")
        if len({Path(name).stem for name in value}) < len(value):
            raise ValueError("has two families of one name; rows and files need different ones.")
        return value

    @field_validator("controllers")
    @classmethod
    def _plain_names(cls, value: dict[str, Controller]) -> dict[str, Controller]:
        for name in value:
            if not name.isidentifier():
                raise ValueError(f"has {name!r}; names are made of letters, digits and _, for they name files.")
        return value

    @field_validator("vary")
    @classmethod
    def _sensible_draws(cls, value: dict[str, Draw]) -> dict[str, Draw]:
        for name, draw in value.items():
            if name not in PARAMETERS:
                raise ValueError(f"has no parameter {name!r}; {closest_name(name, PARAMETERS)}")
            bounds = PARAMETERS[name]
            for number in draw.values:
                if not bounds.low <= number <= bounds.high:
                    limits = f"{bounds.low:g} and {bounds.high:g} {bounds.unit}"
                    raise ValueError(f"has {name} = {number:g}; it must lie between {limits}.")
        return value

    @model_validator(mode="after")
    def _axes_vary(self) -> SweepConfig:
        for name in self.map or ():
            if name not in self.varied:
                raise ValueError(f"'map' has {name!r}, which is not varied; {closest_name(name, self.varied)}")
        return self

    @property
    def varied(self) -> list[str]:
        """Names of the parameters that vary between worlds."""
        return [name for name, draw in self.vary.items() if draw.fixed is None]


def load_sweep(path: str | Path) -> SweepConfig:
    """Read a sweep file.

    Raises:
        ShmooError: the file is missing or not YAML, or an entry is unknown or out of range.
    """
    config = validated(SweepConfig, read_mapping(path, "sweep"), path)
    folder = Path(path).parent
    families = tuple(_own_file(name, folder, path) for name in config.families)
    return config.model_copy(update={"families": families})


def _own_file(name: str, folder: Path, path: str | Path) -> str:
    """The family's name, or the path of an object file, which the sweep file gives relative to itself."""
    if not name.endswith(".json"):
        return name
    file = folder / name
    if not file.is_file():
        raise ShmooError(f"{path}: 'families' has {name}, which is not there; give its path relative to this file.")
    return str(file)


def quick(config: SweepConfig) -> SweepConfig:
    """Short form of a sweep for a first try: at most 16 worlds, 128 roll-outs and 12 s."""
    fewer = {n: c.model_copy(update={"samples": min(c.samples, 128)}) for n, c in config.controllers.items()}
    sizes = {"worlds": min(config.worlds, 16), "seconds": min(config.seconds, 12)}
    return config.model_copy(update={"controllers": fewer, **sizes})


def sweep_fingerprint(config: SweepConfig, weights: Path) -> str:
    """Fingerprint of everything that determines a shard's rows. Folders with different ones hold different sweeps."""
    deciding = config.model_dump(exclude={"question", "map", "worlds"}, mode="json")
    own = [Path(f) for f in config.families if f.endswith(".json")]
    # The content of an object file counts, and its path does not.
    deciding["families"] = [Path(f).name for f in config.families]
    return fingerprint("shmoo_mjx.sweep.simulate", deciding, weights, *own)
