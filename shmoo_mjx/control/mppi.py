"""Model predictive path integral control (Sec. III-E; Williams et al. 2017) for any model and cost.

Model and cost are arguments, so the model can be a learned model, a hand-written one or a simulator. All functions are
pure. ``jax.jit(partial(plan, cfg, rollout_fn, cost_fn))`` compiles once per configuration. ``jax.vmap`` of it over
``x0`` and the state plans a batch of problems in one call; `sharding.each_problem` is faster on a CPU.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from shmoo_mjx.arrays import Array, Bool, Float, Int, Key
from shmoo_mjx.control import noise
from shmoo_mjx.control.mppi_config import MppiConfig as MppiConfig
from shmoo_mjx.errors import ShmooError

RolloutFn = Callable[[Any, Float[Array, "S T m"]], Any]
"""Function from (x0, U) to a trajectory, a pytree of arrays ``[S, T, ...]`` with the states *after* each control."""
CostFn = Callable[[Any, Float[Array, "S T m"], Float[Array, "m"]], Float[Array, "S"]]
"""Function from (trajectory, U, last applied u) to the total cost of each roll-out."""
Evaluation = Callable[[Float[Array, "S T m"]], Any]
"""Function from U to a pytree of arrays ``[S, ...]``."""


class MppiState(NamedTuple):
    """Warm start and random key of the next plan."""

    nominal: Float[Array, "T m"]
    """Warm start, already shifted to the next time step."""
    last_u: Float[Array, "m"]
    """The last applied control. Replace it if the robot received a control other than the plan's."""
    key: Key[Array, ""]
    """Random key, consumed by the next plan."""


class Plan(NamedTuple):
    """A plan with its roll-outs, which the object planner (Algorithm 1) uses."""

    controls: Float[Array, "S T m"]
    """Sampled controls, within the bounds."""
    trajectories: Any
    """Roll-outs from the model, pytree ``[S, T, ...]``."""
    costs: Float[Array, "S"]
    """Costs from the cost function. They can be NaN or inf for invalid roll-outs."""
    weights: Float[Array, "S"]
    """Importance weights. They sum to 1, or are all 0 if no roll-out is valid."""
    nominal: Float[Array, "T m"]
    """Updated control sequence, not yet shifted."""
    invalid: Int[Array, ""]
    """Number of ignored roll-outs, those with a non-finite state or cost."""
    ok: Bool[Array, ""]
    """True if at least one roll-out is valid. Otherwise the nominal is the safe zero control."""


def init(cfg: MppiConfig, key: Key[Array, ""], u0: Float[Array, "m"] | None = None) -> MppiState:
    """State before the first plan. ``u0`` is the last applied control and the warm start, by default zero."""
    u0 = jnp.zeros(cfg.controls) if u0 is None else jnp.asarray(u0, dtype=float)
    return MppiState(jnp.broadcast_to(_clip(cfg, u0), (cfg.horizon, cfg.controls)), u0, key)


def plan(
    cfg: MppiConfig,
    rollout_fn: RolloutFn,
    cost_fn: CostFn,
    x0: Any,
    *,
    state: MppiState,
    share: Callable[[Evaluation], Evaluation] | None = None,
) -> tuple[Float[Array, "m"], MppiState, Plan]:
    """The control to apply now, the state for the next call, and the plan (Sec. III-E).

    If every roll-out is invalid, the control and the next warm start are zero (clipped to the bounds) and ``Plan.ok``
    is False. The arguments are those of `update`; ``state`` holds the nominal, the last control and the key.
    """
    key, use = jax.random.split(state.key)
    updated = update(cfg, rollout_fn, cost_fn, x0, nominal=state.nominal, last_u=state.last_u, key=use, share=share)
    nominal = updated.nominal
    return nominal[0], MppiState(shift(nominal), nominal[0], key), updated


def update(
    cfg: MppiConfig,
    rollout_fn: RolloutFn,
    cost_fn: CostFn,
    x0: Any,
    *,
    nominal: Float[Array, "T m"],
    last_u: Float[Array, "m"],
    key: Key[Array, ""],
    share: Callable[[Evaluation], Evaluation] | None = None,
) -> Plan:
    """One path-integral update of ``nominal`` from state ``x0``, without shifting it.

    Args:
        cfg: static settings.
        rollout_fn: the model, from (x0, U) to a trajectory pytree ``[S, T, ...]``.
        cost_fn: the cost, from (trajectory, U, last_u) to ``[S]``.
        x0: current state, any pytree.
        nominal: control sequence to update.
        last_u: last applied control, for costs on the change of control.
        key: random key.
        share: distributes the evaluation of the roll-outs over devices (`sharding.shared`). Each call of
            ``rollout_fn`` and ``cost_fn`` then gets a part of the roll-outs.

    Returns:
        The plan with its roll-outs.

    Raises:
        ShmooError: (during tracing) the first axis of the states is not the roll-outs, or the costs are not one number
            per roll-out.
    """

    def evaluate(controls: Array) -> tuple[Any, Array, Array]:
        trajectories = _checked_states(rollout_fn(x0, controls), len(controls))
        costs = _checked_costs(cost_fn(trajectories, controls, last_u), len(controls))
        return trajectories, costs, jnp.isfinite(costs) & _finite((trajectories, controls), len(controls))

    nominal = jnp.asarray(nominal)
    controls = sample_controls(cfg, key, nominal)
    trajectories, costs, valid = (share(evaluate) if share else evaluate)(controls)
    weights = importance_weights(cfg, costs, valid)
    mean = jnp.einsum("s,stm->tm", weights, jnp.where(valid[:, None, None], controls, 0.0))
    # Clip, because rounding can move the mean over a bound by one ulp, and the zero control of an invalid plan can lie
    # outside the bounds.
    better = _clip(cfg, mean.astype(nominal.dtype))
    return Plan(controls, trajectories, costs, weights, better, jnp.sum(~valid), jnp.any(valid))


def sample_controls(cfg: MppiConfig, key: Key[Array, ""], nominal: Float[Array, "T m"]) -> Float[Array, "S T m"]:
    """Controls around ``nominal`` with the noise of `noise.draw`, clipped to the bounds.

    The first sequence is the nominal itself, and the second is zero control.
    """
    nominal = jnp.asarray(nominal)
    controls = nominal + noise.draw(cfg, key, nominal.dtype).at[0].set(0.0)
    return _clip(cfg, controls).at[1].set(_clip(cfg, jnp.zeros_like(nominal)))


def importance_weights(cfg: MppiConfig, costs: Float[Array, "S"], valid: Bool[Array, "S"]) -> Float[Array, "S"]:
    """Normalised weights exp(-(S - min S) / lambda). Invalid roll-outs have weight 0.

    The minimum cost is subtracted before scaling, so large costs neither overflow nor underflow.
    """
    best = jnp.argmin(jnp.where(valid, costs, jnp.inf))
    excess = jnp.maximum(costs - costs[best], 0.0)
    raw = jnp.exp(-excess * (cfg.cost_scale / cfg.temperature))
    # The compiler can compute a cost twice with different rounding, for the minimum and for the difference. With large
    # costs the best roll-out could then have weight zero.
    raw = jnp.where(valid, jnp.where(jnp.arange(len(costs)) == best, 1.0, raw), 0.0)
    return raw / jnp.maximum(jnp.sum(raw), 1.0)


def shift(nominal: Float[Array, "T m"]) -> Float[Array, "T m"]:
    """``nominal`` advanced by one time step, with the last control repeated."""
    return jnp.concatenate([nominal[1:], nominal[-1:]])


def _clip(cfg: MppiConfig, u: Array) -> jax.Array:
    return jnp.clip(u, jnp.asarray(cfg.low, u.dtype), jnp.asarray(cfg.high, u.dtype))


def _checked_states(trajectories: Any, count: int) -> Any:
    for leaf in jax.tree.leaves(trajectories):
        if jnp.shape(leaf)[:1] != (count,):
            raise ShmooError(
                f"rollout_fn: the trajectory has an array of shape {jnp.shape(leaf)}; its first axis must be the "
                f"{count} roll-outs."
            )
    return trajectories


def _checked_costs(costs: Any, count: int) -> Array:
    # A cost that is also summed over the roll-outs would give all of them the same weight.
    if jnp.shape(costs) != (count,):
        raise ShmooError(
            f"cost_fn: the cost has shape {jnp.shape(costs)}; for {count} roll-outs it must have shape ({count},), one "
            "number each."
        )
    return jnp.asarray(costs)


def _finite(trees: Any, count: int) -> Array:
    """True for each of ``count`` roll-outs ``[S]`` whose arrays ``[S, ...]`` in ``trees`` are all finite."""
    leaves = [x for x in jax.tree.leaves(trees) if jnp.issubdtype(x.dtype, jnp.inexact)]
    # NaN or infinity times zero is NaN, so one sum per array detects non-finite numbers.
    checks = [jnp.sum(0.0 * x, axis=tuple(range(1, x.ndim))) == 0.0 for x in leaves]
    return jnp.all(jnp.stack([jnp.ones(count, bool), *checks]), axis=0)
