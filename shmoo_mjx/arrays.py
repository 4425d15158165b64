"""Arrays in annotations: ``Float[Array, "N 3"]`` is an array of NumPy or JAX with that shape.

Names of axes stand for one size within a signature, ``...`` for any leading axes, ``*batch`` for named leading axes.
Checked in tests: ``pytest --jaxtyping-packages=shmoo_mjx.dynamics,beartype.beartype``.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import jax
import numpy as np
from jaxtyping import Bool, Float, Int, Key, Shaped

__all__ = ["Array", "Bool", "Float", "Int", "Key", "Numbers", "Scalar", "Shaped"]

if TYPE_CHECKING:
    # What both have in common can't be said to a type checker.
    Array = Any
    Scalar = Any
else:
    Array = np.ndarray | jax.Array
    Scalar = float | int | np.generic | Shaped[Array, ""]

Numbers = Sequence[Scalar]
"""A point, a pose or sizes written out, as in ``(1.0, 2.0)``."""
