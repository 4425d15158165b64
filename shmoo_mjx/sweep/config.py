"""The sweep file: what is varied over how many worlds, for which families and controllers.

question: Over which mass and friction does one push succeed?
worlds: 512                       # per family and controller
families: [box]
controllers:
  ours: {kind: mppi}
  quasi_static: {kind: quasi_static}
vary:
  object.mass: {log_uniform: [2, 60]}
  object.friction: {uniform: [0.1, 0.9]}
map: [object.mass, object.friction]   # axes of the map of successes
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
    """How a parameter is drawn; a bare number is the same in every world."""

    fixed: Number | None = None
    uniform: tuple[Number, Number] | None = None
    log_uniform: tuple[Number, Number] | None = None
    normal: tuple[Number, Number] | None = None
    """Mean and standard deviation; cut off at the parameter's bounds."""
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
        """Numbers that must lie within a parameter's bounds."""
        one = (self.fixed,) if self.fixed is not None else self.normal[:1] if self.normal else None
        values = one or self.uniform or self.log_uniform or self.choice
        assert values is not None
        return values

    def at(self, rng: Any, low: float, high: float) -> float:
        """One value, drawn with a NumPy generator."""
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
    """One of the controllers that are compared on the same worlds."""

    kind: Literal["mppi", "quasi_static"] = "mppi"
    """The pushing controller of the paper, or the pusher without a model (control/quasi_static.py)."""
    samples: WholeNumber = Field(default=500, ge=16, le=100_000)
    """S of MPPI."""
    horizon: WholeNumber = Field(default=30, ge=1, le=200)
    """T of MPPI."""
    temperature: Number = Field(default=0.7, gt=0)
    """lambda of MPPI."""
    adapts: bool = True
    """False leaves what is known of the object at the prior."""
    governor: Number = Field(default=0.25, ge=0)
    """Gain of the governor on the lean [rad s/m]; 0 switches it off."""
    speed_limit: Number = Field(default=0.16, gt=0, le=1)
    """Speed of the robot that is free of charge [m/s]."""


class SweepConfig(_Strict):
    """One sweep."""

    question: str = ""
    """What it is to answer; stands above figures and tables."""
    seed: WholeNumber = Field(default=0, ge=0, le=MAX_SEED)
    worlds: WholeNumber = Field(default=256, ge=1, le=10_000_000)
    """Worlds per family and controller; world i of a family is the same for each controller."""
    families: tuple[str, ...] = Field(default=("box",), min_length=1)
    controllers: dict[str, Controller] = Field(default_factory=lambda: {"ours": Controller()}, min_length=1)
    vary: dict[str, Draw] = Field(default_factory=dict)
    first_object: WholeNumber = Field(default=UNSEEN_SEED, ge=0, le=MAX_SEED)
    """Seed of world 0's object, world i has this plus i; those from 1,000,000 on take no part in training."""
    seconds: WholeNumber = Field(default=20, ge=1, le=600)
    """Longest push, with 1 s in which the arms unfold."""
    face: WholeNumber = Field(default=0, ge=0, le=3)
    """Pushed side: rear, right, front, left."""
    tolerance_m: Number = Field(default=0.25, gt=0)
    """A push succeeds if the object ends this near to its goal [m]."""
    tolerance_deg: Number = Field(default=20.0, gt=0)
    """Yaw error up to which such a push succeeds [deg]."""
    senses: SensesName = "real"
    """What the controller perceives: real senses (docs/sensing.md), or the truth; either with swept noise and delay."""
    shard: WholeNumber = Field(default=256, ge=1)
    """Worlds per file of results: what is lost if the machine stops."""
    map: tuple[str, str] | None = None
    """Two varied parameters over which successes are mapped."""

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
        """Parameters that differ between worlds by the file's wish."""
        return [name for name, draw in self.vary.items() if draw.fixed is None]


def load_sweep(path: str | Path) -> SweepConfig:
    """Read a sweep file.

    Raises:
        ShmooError: missing, no YAML, an unknown or impossible entry, or a shipped file that is meant by its name.
    """
    config = validated(SweepConfig, read_mapping(path, "sweep"), path)
    folder = Path(path).parent
    families = tuple(_own_file(name, folder, path) for name in config.families)
    return config.model_copy(update={"families": families})


def _own_file(name: str, folder: Path, path: str | Path) -> str:
    """A family, or the path of an object file that is given relative to the sweep file."""
    if not name.endswith(".json"):
        return name
    file = folder / name
    if not file.is_file():
        raise ShmooError(f"{path}: 'families' has {name}, which is not there; give its path relative to this file.")
    return str(file)


def quick(config: SweepConfig) -> SweepConfig:
    """A short form of the same shape: few worlds, few samples."""
    fewer = {n: c.model_copy(update={"samples": min(c.samples, 128)}) for n, c in config.controllers.items()}
    sizes = {"worlds": min(config.worlds, 16), "seconds": min(config.seconds, 12)}
    return config.model_copy(update={"controllers": fewer, **sizes})


def sweep_fingerprint(config: SweepConfig, weights: Path) -> str:
    """What decides about a shard's rows: a folder of results with another one belongs to another sweep."""
    deciding = config.model_dump(exclude={"question", "map", "worlds"}, mode="json")
    own = [Path(f) for f in config.families if f.endswith(".json")]
    # What an object file holds decides, not the path by which it is reached from here.
    deciding["families"] = [Path(f).name for f in config.families]
    return fingerprint("shmoo_mjx.sweep.simulate", deciding, weights, *own)
