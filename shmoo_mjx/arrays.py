"""Array types for annotations: ``Float[Array, "N 3"]`` is a NumPy or JAX array with that shape.

An axis name stands for the same size within a signature, ``...`` for any leading axes, ``*batch`` for named leading
axes. Tests check the shapes: ``pytest --jaxtyping-packages=shmoo_mjx.dynamics,beartype.beartype``.
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
    # A type checker sees np.float64 as a float. Tests check shapes and NumPy's other scalar types.
    Scalar = float | Array
else:
    Scalar = float | int | np.generic | Shaped[Array, ""]

ArrayT = TypeVar("ArrayT", bound=Array)
"""Array type of both arguments and result: NumPy in, NumPy out."""
ScalarT = TypeVar("ScalarT", bound=Scalar | Array)
"""Like `ArrayT`, for functions that also accept numbers."""

Numbers = Sequence[Scalar]
"""A point, pose or size as a sequence of numbers, such as ``(1.0, 2.0)``."""


def single_precision[**P, R](function: Callable[P, R]) -> Callable[P, R]:
    """Decorator that runs a function in float32 and int32 with JAX's default promotion rules, whatever JAX's settings.

    The weights are single precision, and MJX creates arrays of JAX's default type. With ``JAX_ENABLE_X64`` (or another
    library's ``jax.config.update``) both would mix with float64 and raise a TypeError in the first loop. With decorated
    entry points, the flag changes neither types nor values of the results. 64-bit JAX arrays among the arguments are
    rounded to 32 bits.
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
    """Convert the 64-bit JAX arrays of a tree to 32 bits. NumPy arrays need no conversion, JAX rounds them itself."""
    return jax.tree.map(_narrow_leaf, tree, is_leaf=lambda x: isinstance(x, dict))


def _narrow_leaf(x: Any) -> Any:
    if isinstance(x, dict):  # jax.tree.map would sort the keys, but their order must be kept
        return {key: _narrow(value) for key, value in x.items()}
    if not isinstance(x, jax.Array) or jnp.issubdtype(x.dtype, jax.dtypes.extended) or x.dtype.itemsize < 8:
        return x
    kinds = {"f": jnp.float32, "i": jnp.int32, "u": jnp.uint32}
    return x.astype(kinds[x.dtype.kind]) if x.dtype.kind in kinds else x


def finite_numbers(what: str, value: Any, names: str) -> Float[np.ndarray, "n"]:
    """Convert a user's point or pose to an array of doubles.

    Args:
        what: description of the value, for the error message.
        value: numbers given by the user.
        names: names of the expected numbers, such as "x, y".

    Raises:
        ShmooError: the length is wrong, or a value is not a finite number.
    """
    try:
        numbers = np.asarray(value, dtype=float)
    except (TypeError, ValueError):
        numbers = np.zeros(0)
    count = len(names.split(", "))
    if numbers.shape != (count,) or not np.isfinite(numbers).all():
        raise ShmooError(f"{what} must be {count} finite numbers ({names}), not {value!r}.")
    return numbers
