"""Model predictive path integral control (Sec. III-E; Williams et al. 2017), knowing nothing of robots or objects.

The model and the cost are arguments, so a learned model, a hand-written one and a simulator stand in the same place.
Everything is pure: ``jax.jit(partial(plan, cfg, rollout_fn, cost_fn))`` compiles once per configuration, and
``jax.vmap`` of it over ``x0`` and the state plans a batch of problems in one call.

XLA runs small matrix products on one core. Where JAX was started with several CPU devices (`sample_mesh`), ``plan`` and
``update`` take a mesh and share the samples out among them, and ``compiled`` jits a function that does.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec

__all__ = [
    "MppiConfig",
    "MppiState",
    "Plan",
    "compiled",
    "importance_weights",
    "init",
    "plan",
    "replicated",
    "sample_controls",
    "sample_mesh",
    "shift",
    "update",
]

Array = Any
RolloutFn = Callable[[Any, Array], Any]
"""(x0, U ``[S, T, m]``) -> trajectory, a pytree of arrays ``[S, T, ...]``: the states *after* each control."""
CostFn = Callable[[Any, Array, Array], Array]
"""(trajectory, U ``[S, T, m]``, last applied u ``[m]``) -> total cost of each sample ``[S]``."""


_AXIS = "samples"
_SPARE = 4096
"""By how many sequences the list of noise is longer than what a plan takes of it."""


@dataclass(frozen=True)
class MppiConfig:
    """Static (hashable) settings; defaults are the paper's where it gives them. Control units are the caller's."""

    samples: int = 500
    """S, roll-outs per plan."""
    horizon: int = 30
    """T, samples per roll-out (3 s at 10 Hz)."""
    temperature: float = 0.7
    """lambda, in the units of ``cost_scale`` x cost."""
    cost_scale: float = 1.0
    """Factor on every cost before the temperature acts. Costs are not normalised in any other way; at 1 the temperature
    is the paper's. With a cost in metres, 0.7 hardly tells roll-outs apart that end 0.1 m from each other."""
    sigma: tuple[float, ...] = (0.06, 0.06, 0.15)
    """Standard deviation of the control noise per channel (phi_x, phi_y, gamma) [rad]; 0 freezes a channel."""
    low: tuple[float, ...] = (-0.2, -0.2, -0.5)
    """Lower bound per channel [rad]."""
    high: tuple[float, ...] = (0.2, 0.2, 0.5)
    """Upper bound per channel [rad]."""
    noise_correlation: float = 0.8
    """Correlation of the noise from one time step to the next, in [0, 1): a stationary AR(1) process whose standard
    deviation stays ``sigma``. 0 is Williams' white noise; near 1 each roll-out holds one perturbation throughout."""
    control_cost: float = 0.0
    """gamma / lambda of Williams 2017, in [0, 1]: weight of the term lambda u^T Sigma^-1 eps that keeps the plan near
    zero control. 0 (as in Eq. 9, which has its own effort term) minimises the cost alone."""
    include_nominal: bool = True
    """Sample 0 is the unperturbed warm start."""
    include_zero: bool = True
    """Sample 1 is zero control (clipped to the bounds)."""

    def __post_init__(self) -> None:
        if not len(self.sigma) == len(self.low) == len(self.high):
            raise ValueError("sigma, low and high need one entry per control channel")
        if self.samples < 2 or self.horizon < 1:
            raise ValueError("MPPI needs at least 2 samples and a horizon of 1")
        if not self.temperature > 0 or not self.cost_scale > 0:
            raise ValueError("temperature and cost_scale must be positive")
        if not 0 <= self.noise_correlation < 1:
            raise ValueError("noise_correlation must lie in [0, 1)")
        if min(self.sigma) < 0 or any(lo > hi for lo, hi in zip(self.low, self.high, strict=True)):
            raise ValueError("sigma must not be negative and low must not exceed high")

    @property
    def controls(self) -> int:
        """m, number of control channels."""
        return len(self.sigma)


class MppiState(NamedTuple):
    """What one plan hands to the next."""

    nominal: Array
    """``[T, m]`` warm start, already shifted to the next time step."""
    last_u: Array
    """``[m]`` the control applied last; replace it when the robot was given another one than the plan's."""
    key: Array
    """Random key, consumed by the next plan."""


class Plan(NamedTuple):
    """A plan with the evidence for it: the object planner (Algorithm 1) takes the roll-outs."""

    controls: Array
    """``[S, T, m]`` sampled controls, within the bounds."""
    trajectories: Any
    """Roll-outs as the model gave them, pytree ``[S, T, ...]``."""
    costs: Array
    """``[S]`` cost as the cost function gave it; may be NaN or inf where invalid."""
    weights: Array
    """``[S]`` importance weights: sum to 1, or all 0 when no roll-out is valid."""
    nominal: Array
    """``[T, m]`` improved control sequence, not yet shifted."""
    invalid: Array
    """int: roll-outs with a non-finite state or cost, which were ignored."""
    ok: Array
    """bool: at least one roll-out was valid. If not, the nominal is the safe zero control."""


def init(cfg: MppiConfig, key: Array, u0: Array | None = None) -> MppiState:
    """A fresh state. ``u0 [m]``, zero if not given, is the last applied control and fills the warm start."""
    u0 = jnp.zeros(cfg.controls) if u0 is None else jnp.asarray(u0, dtype=float)
    nominal = jnp.broadcast_to(_clip(cfg, u0), (cfg.horizon, cfg.controls))
    return MppiState(nominal, u0, key)


def sample_controls(cfg: MppiConfig, key: Array, nominal: Array) -> Array:
    """Controls ``[S, T, m]`` around ``nominal [T, m]``: coloured noise, clipped to the bounds.

    The noise is taken in a row from a list that is drawn once, the key says from where on, and each sequence comes with
    its mirror image: what happens to be on one side of zero in the list would else pull each plan there.
    """
    half = (cfg.samples + 1) // 2
    first = jax.random.randint(key, (), 0, _SPARE)
    noise = jax.lax.dynamic_slice_in_dim(jnp.asarray(_noises(cfg)), first, half)
    noise = jnp.concatenate([noise, -noise])[: cfg.samples]
    if cfg.include_nominal:
        noise = noise.at[0].set(0.0)
    controls = _clip(cfg, nominal + noise)
    if cfg.include_zero:
        controls = controls.at[1].set(_clip(cfg, jnp.zeros_like(nominal)))
    return controls


def importance_weights(cfg: MppiConfig, costs: Array, valid: Array) -> Array:
    """exp(-(S - min S) / lambda), normalised ``[S]``; invalid samples weigh 0, all of them 0 if none is valid.

    The least cost is taken off before scaling, so costs of any size, equal or far apart, neither overflow nor vanish.
    """
    best = jnp.min(jnp.where(valid, costs, jnp.inf))
    excess = jnp.where(valid, costs - jnp.where(jnp.isfinite(best), best, 0.0), jnp.inf)
    raw = jnp.where(valid, jnp.exp(-excess * (cfg.cost_scale / cfg.temperature)), 0.0)
    return raw / jnp.maximum(jnp.sum(raw), 1.0)  # the best sample alone gives 1, so a sum below 1 means none is valid


def sample_mesh(samples: int) -> Mesh | None:
    """The CPU devices among which ``samples`` can be shared out evenly; None if that is one, or not a CPU.

    There are as many as JAX was started with: ``JAX_NUM_CPU_DEVICES``, which the command line sets. Each count gives
    the same plan but for rounding.
    """
    devices = jax.devices()
    if devices[0].platform != "cpu":
        return None
    count = max(n for n in range(1, len(devices) + 1) if samples % n == 0)
    return Mesh(np.asarray(devices[:count]), (_AXIS,)) if count > 1 else None


def replicated(mesh: Mesh | None, tree: Any) -> Any:
    """The arrays of ``tree`` on every device of ``mesh``, so that no call has to bring them there."""
    return tree if mesh is None else jax.device_put(tree, NamedSharding(mesh, PartitionSpec()))


def compiled(function: Callable[..., Any], mesh: Mesh | None) -> Callable[..., Any]:
    """``jax.jit``, with every argument the same on all devices of ``mesh``.

    Naming the placement keeps it from compiling again when an answer comes back as an argument.
    """
    return jax.jit(function) if mesh is None else jax.jit(function, in_shardings=NamedSharding(mesh, PartitionSpec()))


def update(
    cfg: MppiConfig,
    rollout_fn: RolloutFn,
    cost_fn: CostFn,
    x0: Any,
    nominal: Array,
    last_u: Array,
    key: Array,
    mesh: Mesh | None = None,
) -> Plan:
    """One path-integral update of ``nominal [T, m]`` from state ``x0``, without shifting it.

    Args:
        cfg: static settings.
        rollout_fn: the model, (x0, U [S, T, m]) -> trajectory pytree [S, T, ...].
        cost_fn: (trajectory, U, last_u) -> cost [S].
        x0: present state, any pytree.
        nominal: control sequence to update.
        last_u: control applied last [m], for costs on the change of control.
        key: random key.
        mesh: devices to share the samples out among; both functions then see a part of the samples each time.

    Returns:
        The plan with its roll-outs.
    """

    def evaluate(controls: Array) -> tuple[Any, Array, Array, Array]:
        trajectories = rollout_fn(x0, controls)
        costs = cost_fn(trajectories, controls, last_u)
        total = costs
        if cfg.control_cost:
            total = costs + cfg.control_cost * cfg.temperature / cfg.cost_scale * _control_term(cfg, nominal, controls)
        return trajectories, costs, total, jnp.isfinite(total) & _finite((trajectories, controls), len(controls))

    controls = sample_controls(cfg, key, nominal)
    if mesh is not None:
        controls = jax.lax.with_sharding_constraint(controls, NamedSharding(mesh, PartitionSpec(_AXIS)))
        # The check would ask of every user's roll-out that it marks its carry as varying over the devices.
        evaluate = jax.shard_map(
            evaluate, mesh=mesh, in_specs=PartitionSpec(_AXIS), out_specs=PartitionSpec(_AXIS), check_vma=False
        )
    trajectories, costs, total, valid = evaluate(controls)
    weights = importance_weights(cfg, total, valid)
    mean = jnp.einsum("s,stm->tm", weights, jnp.where(valid[:, None, None], controls, 0.0))
    # The clip: rounding may carry the mean over a bound by one ulp, and zero, the mean of no sample, may lie outside.
    return Plan(controls, trajectories, costs, weights, _clip(cfg, mean), jnp.sum(~valid), jnp.any(valid))


def plan(
    cfg: MppiConfig, rollout_fn: RolloutFn, cost_fn: CostFn, x0: Any, state: MppiState, mesh: Mesh | None = None
) -> tuple[Array, MppiState, Plan]:
    """The control to apply now ``[m]``, the state for the next call, and the plan (Sec. III-E).

    If every roll-out is invalid the control is zero (clipped to the bounds), ``Plan.ok`` is False and the next warm
    start is zero control too. The arguments are those of `update`.
    """
    key, use = jax.random.split(state.key)
    result = update(cfg, rollout_fn, cost_fn, x0, state.nominal, state.last_u, use, mesh)
    nominal = result.nominal
    if mesh is not None:
        nominal = jax.lax.with_sharding_constraint(nominal, NamedSharding(mesh, PartitionSpec()))
    return nominal[0], MppiState(shift(nominal), nominal[0], key), result


def shift(nominal: Array) -> Array:
    """``nominal [T, m]`` one time step on; the last control is repeated."""
    return jnp.concatenate([nominal[1:], nominal[-1:]])


def _clip(cfg: MppiConfig, u: Array) -> Array:
    return jnp.clip(u, jnp.asarray(cfg.low), jnp.asarray(cfg.high))


@lru_cache(maxsize=8)
def _noises(cfg: MppiConfig) -> np.ndarray:
    """Coloured noise ``[(S + 1) // 2 + _SPARE, T, m]``: a tenth of a plan's time if drawn anew."""
    white = np.random.default_rng(0).standard_normal(((cfg.samples + 1) // 2 + _SPARE, cfg.horizon, cfg.controls))
    return np.asarray(np.einsum("tk,skm->stm", _noise_factor(cfg), white) * cfg.sigma, dtype=np.float32)


def _noise_factor(cfg: MppiConfig) -> np.ndarray:
    """L ``[T, T]`` with coloured = L white: the Cholesky factor of the AR(1) correlation rho^|i - j|."""
    rho, steps = cfg.noise_correlation, np.arange(cfg.horizon)
    factor = np.tril(rho ** np.maximum(steps[:, None] - steps[None, :], 0)) * math.sqrt(1 - rho**2)
    factor[:, 0] = rho**steps
    return factor


def _control_term(cfg: MppiConfig, nominal: Array, controls: Array) -> Array:
    """u^T Sigma^-1 eps ``[S]``, with Sigma the covariance of the coloured noise over time and channels."""
    sigma = jnp.asarray(cfg.sigma)
    inverse = jnp.asarray(np.linalg.inv(_noise_factor(cfg)))
    scale = jnp.where(sigma > 0, 1 / jnp.where(sigma > 0, sigma, 1.0), 0.0)
    u = inverse @ (nominal * scale)
    eps = jnp.einsum("tk,skm->stm", inverse, (controls - nominal) * scale)
    return jnp.einsum("tm,stm->s", u, eps)


def _finite(trajectories: Any, samples: int) -> Array:
    leaves = [x for x in jax.tree.leaves(trajectories) if jnp.issubdtype(x.dtype, jnp.inexact)]
    checks = [jnp.all(jnp.isfinite(x.reshape(samples, -1)), axis=-1) for x in leaves]
    return jnp.all(jnp.stack([jnp.ones(samples, bool), *checks]), axis=0)
