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

from shmoo_mjx.errors import ShmooError

__all__ = ["Array", "Bool", "Float", "Int", "Key", "Numbers", "Scalar", "Shaped", "finite_numbers"]

if TYPE_CHECKING:
    # What both have in common can't be said to a type checker.
    Array = Any
    Scalar = Any
else:
    Array = np.ndarray | jax.Array
    Scalar = float | int | np.generic | Shaped[Array, ""]

Numbers = Sequence[Scalar]
"""A point, a pose or sizes written out, as in ``(1.0, 2.0)``."""


def finite_numbers(what: str, given: Any, names: str) -> Float[np.ndarray, "n"]:
    """A point or pose that a user gave, as an array of doubles with one number for each of the ``names`` "x, y".

    Raises:
        ShmooError: it has another length, or a value that is no finite number; ``what`` says whose it is.
    """
    try:
        numbers = np.asarray(given, dtype=float)
    except (TypeError, ValueError):
        numbers = np.zeros(0)
    count = len(names.split(", "))
    if numbers.shape != (count,) or not np.isfinite(numbers).all():
        raise ShmooError(f"{what} must be {count} finite numbers ({names}), not {given!r}.")
    return numbers
