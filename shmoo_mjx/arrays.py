"""Arrays in annotations: ``Float[Array, "N 3"]`` is an array of NumPy or JAX with that shape.

Names of axes stand for one size within a signature, ``...`` for any leading axes, ``*batch`` for named leading axes.
Checked in tests: ``pytest --jaxtyping-packages=shmoo_mjx.dynamics,beartype.beartype``.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from typing import TYPE_CHECKING, Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int, Key, Shaped

from shmoo_mjx.errors import ShmooError

__all__ = [
    "Array", "ArrayT", "Bool", "Float", "Int", "Key", "Numbers", "Scalar", "ScalarT", "Shaped", "finite_numbers",
    "single_precision",
]  # fmt: skip

Array = np.ndarray | jax.Array
if TYPE_CHECKING:
    # For a type checker np.float64 is a float; its shape and NumPy's other scalars are checked in tests.
    Scalar = float | Array
else:
    Scalar = float | int | np.generic | Shaped[Array, ""]

ArrayT = TypeVar("ArrayT", bound=Array)
"""The kind of array that a function takes and returns: NumPy's in, NumPy's out."""
ScalarT = TypeVar("ScalarT", bound=Scalar | Array)
"""The same for functions that take numbers too."""

Numbers = Sequence[Scalar]
"""A point, a pose or sizes written out, as in ``(1.0, 2.0)``."""


def single_precision[**P, R](function: Callable[P, R]) -> Callable[P, R]:
    """``function`` computed in float32 and int32 with JAX's own promotion rules, whatever the process has set.

    The weights are single precision, and MJX creates arrays of JAX's default type. With ``JAX_ENABLE_X64`` (or another
    library's ``jax.config.update``) both would mix with float64, which ends in a TypeError at the first loop. Entry
    points are decorated, so the flag changes neither the types nor the numbers they return. JAX arrays of 64 bits among
    the arguments are rounded first.
    """

    @functools.wraps(function)
    def run(*args: P.args, **kwargs: P.kwargs) -> R:
        config = jax.config
        wide = config.jax_enable_x64
        if not wide and config.jax_numpy_dtype_promotion == "standard" and config.jax_numpy_rank_promotion == "allow":
            return function(*args, **kwargs)
        if wide:
            args, kwargs = _narrow((args, kwargs))
        with ExitStack() as settings:
            settings.enter_context(jax.enable_x64(False))
            settings.enter_context(jax.numpy_dtype_promotion("standard"))
            settings.enter_context(jax.numpy_rank_promotion("allow"))
            return function(*args, **kwargs)

    return run


def _narrow(tree: Any) -> Any:
    """Its JAX arrays of 64 bits as ones of 32 bits, the rest as it is. JAX rounds NumPy arrays by itself."""
    return jax.tree.map(_narrow_leaf, tree, is_leaf=lambda x: isinstance(x, dict))


def _narrow_leaf(x: Any) -> Any:
    if isinstance(x, dict):  # JAX would sort its keys, and a caller's order counts
        return {key: _narrow(value) for key, value in x.items()}
    if not isinstance(x, jax.Array) or jnp.issubdtype(x.dtype, jax.dtypes.extended) or x.dtype.itemsize < 8:
        return x
    kinds = {"f": jnp.float32, "i": jnp.int32, "u": jnp.uint32}
    return x.astype(kinds[x.dtype.kind]) if x.dtype.kind in kinds else x


def finite_numbers(what: str, value: Any, names: str) -> Float[np.ndarray, "n"]:
    """A point or pose that a user gave, as an array of doubles with one number for each of the ``names`` "x, y".

    Raises:
        ShmooError: it has another length, or a value that is no finite number; ``what`` says whose it is.
    """
    try:
        numbers = np.asarray(value, dtype=float)
    except (TypeError, ValueError):
        numbers = np.zeros(0)
    count = len(names.split(", "))
    if numbers.shape != (count,) or not np.isfinite(numbers).all():
        raise ShmooError(f"{what} must be {count} finite numbers ({names}), not {value!r}.")
    return numbers
