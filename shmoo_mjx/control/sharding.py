"""Distribution of roll-outs over several CPU devices.

XLA runs small matrix products on one core. If JAX has several CPU devices (`rollout_mesh`),
:func:`~shmoo_mjx.control.mppi.plan` can evaluate a part of its roll-outs on each (``share=partial(shared, mesh)``).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec

from shmoo_mjx.control.mppi import Evaluation

_AXIS = "rollouts"
_PROBLEMS = "problems"


def each_problem(function: Callable[..., Any], count: int) -> Callable[..., Any]:
    """``function(params, *one)`` batched over ``count`` problems, with arrays ``[count, ...]``; to be jitted.

    Every CPU device solves its own problems one after another. No device waits for another within a problem, and the
    arrays of a problem stay in the cache. This takes 0.65 (64 problems) to 0.9 of the time of a vmap. Other devices use
    a vmap.
    """
    devices = jax.devices()
    if devices[0].platform != "cpu":
        return lambda params, *many: jax.vmap(lambda *one: function(params, *one))(*many)
    use = max(n for n in range(1, len(devices) + 1) if count % n == 0)

    def in_turn(params: Any, *many: Any) -> Any:
        return jax.lax.map(lambda one: function(params, *one), many)

    def parted(params: Any, *many: Any) -> Any:
        each, same = PartitionSpec(_PROBLEMS), PartitionSpec()
        mesh = Mesh(np.asarray(devices[:use]), (_PROBLEMS,))
        specs = (same, *(each for _ in many))
        return jax.shard_map(in_turn, mesh=mesh, in_specs=specs, out_specs=each, check_vma=False)(params, *many)

    return parted if use > 1 else in_turn


def rollout_mesh(num_rollouts: int) -> Mesh | None:
    """CPU devices over which ``num_rollouts`` can be distributed evenly; None for one device or no CPU.

    The command line sets the number of CPU devices with ``JAX_NUM_CPU_DEVICES``. The plan does not depend on it except
    for rounding.
    """
    devices = jax.devices()
    if devices[0].platform != "cpu":
        return None
    count = max(n for n in range(1, len(devices) + 1) if num_rollouts % n == 0)
    return Mesh(np.asarray(devices[:count]), (_AXIS,)) if count > 1 else None


def replicated(mesh: Mesh | None, tree: Any) -> Any:
    """The arrays of ``tree`` copied to every device of ``mesh``, so that later calls need no transfer."""
    return tree if mesh is None else jax.device_put(tree, NamedSharding(mesh, PartitionSpec()))


def compiled(function: Callable[..., Any], mesh: Mesh | None) -> Callable[..., Any]:
    """``jax.jit`` of a function whose arguments are replicated on all devices of ``mesh``.

    The explicit placement avoids a second compilation when a result is passed as an argument.
    """
    return jax.jit(function) if mesh is None else jax.jit(function, in_shardings=NamedSharding(mesh, PartitionSpec()))


def on_all(mesh: Mesh | None, tree: Any) -> Any:
    """The arrays of ``tree`` replicated on every device; for use inside jit."""
    return tree if mesh is None else jax.lax.with_sharding_constraint(tree, NamedSharding(mesh, PartitionSpec()))


def shared(mesh: Mesh, function: Evaluation) -> Evaluation:
    """``function`` of an array, with the first axis distributed over the devices; for use inside jit."""
    spec = PartitionSpec(_AXIS)
    # The check is off because it would require every user's roll-out to mark its carry as varying over the devices.
    each = jax.shard_map(function, mesh=mesh, in_specs=spec, out_specs=spec, check_vma=False)
    return lambda x: each(jax.lax.with_sharding_constraint(x, NamedSharding(mesh, spec)))
