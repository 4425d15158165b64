"""Condition c of an object (Sec. III): all object properties that affect pushing."""

from __future__ import annotations

import dataclasses
import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

GRAVITY = 9.81
"""Gravitational acceleration [m/s^2]."""


def is_custom(family: str) -> bool:
    """Whether the family is the path of a custom object file (``*.json``) instead of a built-in family."""
    return family.endswith(".json")


@dataclass(frozen=True)
class Condition:
    """Fixed dynamic properties of one object (condition c of Sec. III). SI units."""

    family: str
    """Built-in object family, or the path of a custom object file."""
    seed: int
    """Seed from which the properties are drawn."""
    size: tuple[float, float, float]
    """Length (x of {O}), width and height of the hull [m]."""
    mass: float
    """Mass of the empty object, without wheels and forks [kg]."""
    payload: float
    """Mass of the load [kg]."""
    payload_x: float
    """Offset of the load from the centre of {O} along x [m]."""
    payload_y: float
    """Offset of the load from the centre of {O} along y [m]."""
    friction: float
    """Coulomb friction coefficient mu between the floor and the sole or the wheels."""
    rolling: tuple[float, ...] = ()
    """Rolling resistance coefficient sigma (C_rr) of each wheel: resisting force divided by wheel load."""
    swivel_friction: float = 0.0
    """Dry friction torque of each caster's swivel [N m]."""
    locked: tuple[bool, ...] = ()
    """Whether each wheel's brake is on."""
    caster_angle: tuple[float, ...] = ()
    """Initial angle of each caster [rad]."""

    @property
    def half_extents(self) -> tuple[float, float]:
        """Half length and half width of the footprint [m]."""
        return self.size[0] / 2, self.size[1] / 2

    @property
    def total_mass(self) -> float:
        """Mass of the empty object and its load, without wheels [kg]."""
        return self.mass + self.payload

    @property
    def resistance(self) -> float:
        """Force that keeps the object in straight motion [N].

        It is the sole's friction force, or that of wheels that carry equal loads.
        """
        if not self.rolling:
            return self.friction * self.total_mass * GRAVITY
        share = [self.friction if locked else sigma for sigma, locked in zip(self.rolling, self.locked, strict=True)]
        return float(np.mean(share)) * self.total_mass * GRAVITY

    def to_dict(self) -> dict[str, Any]:
        """Plain data from which :meth:`from_dict` restores an equal condition."""
        return dataclasses.asdict(self)

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Condition:
        """Restore a condition from the output of :meth:`to_dict`, also after JSON serialisation."""
        tuples: dict[str, Any] = {k: tuple(v) if isinstance(v, list | tuple) else v for k, v in data.items()}
        return cls(**tuples)

    def fingerprint(self) -> str:
        """Hash of all properties, the same on every machine.

        For a custom object, the file's content is hashed, not its path.
        """
        values = self.to_dict()
        if is_custom(self.family):
            values["family"] = hashlib.sha256(Path(self.family).read_bytes()).hexdigest()
        return hashlib.sha256(json.dumps(values, sort_keys=True).encode()).hexdigest()[:16]

    def describe(self) -> str:
        """One-line description of the condition, for people."""
        names = {
            "cart": ("front left", "front right", "rear left", "rear right"),
            "wheelchair": ("rear left", "rear right", "front left", "front right"),
        }.get(self.family, tuple(f"wheel {i}" for i in range(len(self.locked))))
        size = " x ".join(f"{s:.2f}" for s in self.size)
        text = f"{Path(self.family).stem} {size} m, {self.mass:.1f} kg"
        if self.payload > 0:
            text += f" + {self.payload:.1f} kg at ({self.payload_x:+.2f}, {self.payload_y:+.2f}) m"
        text += f", mu {self.friction:.2f}"
        if self.rolling:
            text += f", rolling resistance {min(self.rolling):.3f} to {max(self.rolling):.3f}"
        locked = [name for name, on in zip(names, self.locked, strict=False) if on]
        return text + (f", locked: {', '.join(locked)}" if locked else "")
