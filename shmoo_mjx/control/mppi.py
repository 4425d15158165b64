"""Model predictive path integral control (Sec. III-E; Williams et al. 2017) for any model and cost.

Both are arguments, so a learned model, a hand-written one and a simulator stand in the same place. Everything is pure:
``jax.jit(partial(plan, cfg, rollout_fn, cost_fn))`` compiles once per configuration; ``jax.vmap`` of it over ``x0`` and
the state plans a batch of problems in one call, and `sharding.each_problem` does so faster on a CPU.
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
"""(x0, U) -> trajectory, a pytree of arrays ``[S, T, ...]``: the states *after* each control."""
CostFn = Callable[[Any, Float[Array, "S T m"], Float[Array, "m"]], Float[Array, "S"]]
"""(trajectory, U, last applied u) -> total cost of each roll-out."""
Evaluation = Callable[[Float[Array, "S T m"]], Any]
"""U -> a pytree of arrays ``[S, ...]``."""


class MppiState(NamedTuple):
    """Warm start and random key for the next plan."""

    nominal: Float[Array, "T m"]
    """Warm start, already shifted to the next time step."""
    last_u: Float[Array, "m"]
    """The control applied last; replace it when the robot was given another one than the plan's."""
    key: Key[Array, ""]
    """Random key, consumed by the next plan."""


class Plan(NamedTuple):
    """A plan with the evidence for it: the object planner (Algorithm 1) takes the roll-outs."""

    controls: Float[Array, "S T m"]
    """Sampled controls, within the bounds."""
    trajectories: Any
    """Roll-outs as the model gave them, pytree ``[S, T, ...]``."""
    costs: Float[Array, "S"]
    """Cost as the cost function gave it; may be NaN or inf where invalid."""
    weights: Float[Array, "S"]
    """Importance weights: sum to 1, or all 0 when no roll-out is valid."""
    nominal: Float[Array, "T m"]
    """Updated control sequence, not yet shifted."""
    invalid: Int[Array, ""]
    """Roll-outs with a non-finite state or cost, which were ignored."""
    ok: Bool[Array, ""]
    """At least one roll-out was valid. If not, the nominal is the safe zero control."""


def init(cfg: MppiConfig, key: Key[Array, ""], u0: Float[Array, "m"] | None = None) -> MppiState:
    """State before the first plan; ``u0``, by default zero, is the control applied last and the warm start."""
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

    If every roll-out is invalid the control is zero (clipped to the bounds), ``Plan.ok`` is False and the next warm
    start is zero control too. The arguments are those of `update`.
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
        rollout_fn: the model, (x0, U) -> trajectory pytree ``[S, T, ...]``.
        cost_fn: (trajectory, U, last_u) -> cost.
        x0: present state, any pytree.
        nominal: control sequence to update.
        last_u: control applied last, for costs on the change of control.
        key: random key.
        share: spreads the evaluation of the roll-outs over devices (`sharding.shared`); both functions then see a
            part of the roll-outs each time.

    Returns:
        The plan with its roll-outs.

    Raises:
        ShmooError: while it is traced, if the states or the costs are not one row or number per roll-out.
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
    # The clip: rounding may carry the mean over a bound by one ulp, and zero, the mean of no sample, may lie outside.
    better = _clip(cfg, mean.astype(nominal.dtype))
    return Plan(controls, trajectories, costs, weights, better, jnp.sum(~valid), jnp.any(valid))


def sample_controls(cfg: MppiConfig, key: Key[Array, ""], nominal: Float[Array, "T m"]) -> Float[Array, "S T m"]:
    """Controls around ``nominal``: noise (`noise.draw`), clipped to the bounds.

    The first is the nominal itself, the second zero control.
    """
    nominal = jnp.asarray(nominal)
    controls = nominal + noise.draw(cfg, key, nominal.dtype).at[0].set(0.0)
    return _clip(cfg, controls).at[1].set(_clip(cfg, jnp.zeros_like(nominal)))


def importance_weights(cfg: MppiConfig, costs: Float[Array, "S"], valid: Bool[Array, "S"]) -> Float[Array, "S"]:
    """exp(-(S - min S) / lambda), normalised; invalid roll-outs weigh 0, all of them 0 if none is valid.

    The least cost is taken off before scaling, so costs of any size, equal or far apart, neither overflow nor vanish.
    """
    best = jnp.argmin(jnp.where(valid, costs, jnp.inf))
    excess = jnp.maximum(costs - costs[best], 0.0)
    raw = jnp.exp(-excess * (cfg.cost_scale / cfg.temperature))
    # A compiler may compute a cost twice, and round it otherwise for the minimum than for the difference from it. At
    # large costs not even the best would then weigh anything.
    raw = jnp.where(valid, jnp.where(jnp.arange(len(costs)) == best, 1.0, raw), 0.0)
    return raw / jnp.maximum(jnp.sum(raw), 1.0)


def shift(nominal: Float[Array, "T m"]) -> Float[Array, "T m"]:
    """``nominal`` one time step on; the last control is repeated."""
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
    # Summed over the roll-outs too, they would all weigh the same.
    if jnp.shape(costs) != (count,):
        raise ShmooError(
            f"cost_fn: the cost has shape {jnp.shape(costs)}; for {count} roll-outs it must have shape ({count},), one "
            "number each."
        )
    return jnp.asarray(costs)


def _finite(trees: Any, count: int) -> Array:
    """Which of ``count`` roll-outs ``[S]`` have no NaN and no infinity in any array ``[S, ...]`` of ``trees``."""
    leaves = [x for x in jax.tree.leaves(trees) if jnp.issubdtype(x.dtype, jnp.inexact)]
    # NaN or infinity times zero is NaN, and one sum over numbers finds it.
    checks = [jnp.sum(0.0 * x, axis=tuple(range(1, x.ndim))) == 0.0 for x in leaves]
    return jnp.all(jnp.stack([jnp.ones(count, bool), *checks]), axis=0)
