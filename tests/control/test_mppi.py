"""MPPI against problems whose answer is known."""

from __future__ import annotations

import re
from dataclasses import replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from shmoo_mjx.control import mppi
from shmoo_mjx.errors import ShmooError

DT = 0.2
CFG = mppi.MppiConfig(
    num_rollouts=600,
    horizon=6,
    temperature=0.05,
    sigma=(0.3, 0.3, 0.3),
    low=(-5.0,) * 3,
    high=(5.0,) * 3,
    noise_correlation=0.5,
)
X0 = jnp.array([1.0, -0.5, 0.3])


def integrate(x0: Any, controls: Any) -> Any:
    """Single integrator in each channel, the plainest linear model: [S, T, 3]."""
    return x0 + DT * jnp.cumsum(controls, axis=-2)


def quadratic(traj: Any, controls: Any, last_u: Any) -> Any:
    return jnp.sum(traj**2, axis=(-2, -1)) + 0.1 * jnp.sum(controls**2, axis=(-2, -1))


def optimum() -> np.ndarray:
    """Minimiser [T, 3] of the quadratic cost."""
    steps = CFG.horizon
    sums = DT * np.tril(np.ones((steps, steps)))
    hessian = sums.T @ sums + 0.1 * np.eye(steps)
    return -np.linalg.solve(hessian, sums.T @ np.ones((steps, 1)) @ np.asarray(X0)[None])


def converge(cfg: mppi.MppiConfig, sweeps: int = 300) -> np.ndarray:
    def sweep(nominal: Any, key: Any) -> tuple[Any, Any]:
        better = mppi.update(cfg, integrate, quadratic, X0, nominal=nominal, last_u=jnp.zeros(3), key=key).nominal
        return better, better

    keys = jax.random.split(jax.random.key(0), sweeps)
    _, trail = jax.jit(partial(jax.lax.scan, sweep))(jnp.zeros((cfg.horizon, 3)), keys)
    return np.asarray(trail[sweeps // 2 :]).mean(axis=0)  # average over sweeps: sampling noise remains in each


def test_reaches_the_linear_quadratic_optimum() -> None:
    assert np.abs(optimum()).max() > 0.5
    np.testing.assert_allclose(converge(CFG), optimum(), atol=0.04)


def test_noise_has_the_stated_deviation_and_correlation() -> None:
    cfg = replace(CFG, num_rollouts=20_000, horizon=4, sigma=(0.1, 0.2, 0.0), noise_correlation=0.8)
    noise = np.asarray(mppi.sample_controls(cfg, jax.random.key(1), jnp.zeros((4, 3))))
    np.testing.assert_allclose(noise[:, 0].std(axis=0), cfg.sigma, atol=3e-3)
    np.testing.assert_allclose(noise[:, 3].std(axis=0), cfg.sigma, atol=3e-3)
    assert abs(np.corrcoef(noise[:, 1, 0], noise[:, 2, 0])[0, 1] - 0.8) < 0.02
    assert abs(np.corrcoef(noise[:, 0, 1], noise[:, 3, 1])[0, 1] - 0.8**3) < 0.03


@given(
    costs=st.lists(
        st.floats(allow_nan=True, allow_infinity=True, width=32) | st.floats(-1, 1, width=32), min_size=4, max_size=4
    ),
    temperature=st.sampled_from([1e-6, 0.7, 1e6]),
)
@settings(max_examples=60, deadline=None)
def test_weights_sum_to_one_whatever_the_costs(costs: list[float], temperature: float) -> None:
    c = jnp.asarray(costs, dtype=jnp.float32)
    valid = jnp.isfinite(c)
    weights = np.asarray(mppi.importance_weights(replace(CFG, temperature=temperature), c, valid))
    assert np.isfinite(weights).all() and (weights >= 0).all()
    assert (weights[~np.asarray(valid)] == 0).all()
    assert weights.sum() == pytest.approx(1.0 if np.asarray(valid).any() else 0.0, abs=1e-5)


@pytest.mark.parametrize("scale", 10.0 ** np.arange(-3, 10))
def test_under_jit_costs_of_any_size_choose_the_control_that_they_choose_eagerly(scale: float) -> None:
    """A compiler may round a cost otherwise where it takes the minimum than where it takes the difference."""
    cfg = replace(CFG, num_rollouts=64, horizon=10, sigma=(1.0,) * 3, temperature=0.7)

    def cost(traj: Any, controls: Any, last_u: Any) -> Any:
        return scale * jnp.sum((traj - 1) ** 2, axis=(-2, -1))

    plan = partial(mppi.plan, cfg, integrate, cost, X0, state=mppi.init(cfg, jax.random.key(0)))
    (u, _, jitted), (expected, _, eager) = jax.jit(plan)(), plan()
    for found in (jitted, eager):
        assert bool(found.ok) and float(found.weights.sum()) == pytest.approx(1.0, abs=1e-5)
        assert float(found.weights[jnp.argmin(found.costs)]) == float(found.weights.max()) > 0
    np.testing.assert_allclose(u, expected, atol=1e-3)


@pytest.mark.parametrize(
    ("cost", "shape"),
    [
        (lambda t, c, last: jnp.sum(t**2), "()"),
        (lambda t, c, last: jnp.sum(t**2)[None], "(1,)"),
        (lambda t, c, last: jnp.sum(t**2, axis=-1), "(600, 6)"),
        (lambda t, c, last: 1.0, "()"),
    ],
)
def test_a_cost_that_is_not_one_number_per_rollout_is_refused(cost: Any, shape: str) -> None:
    run = partial(mppi.plan, CFG, integrate, cost, X0)
    with pytest.raises(ShmooError, match=re.escape(shape)) as refused:
        jax.jit(run).lower(state=mppi.init(CFG, jax.random.key(0)))
    assert "(600,)" in str(refused.value) and "cost_fn" in str(refused.value)


def test_a_trajectory_without_the_rollouts_first_is_refused() -> None:
    run = partial(mppi.plan, CFG, lambda x0, c: jnp.swapaxes(integrate(x0, c), 0, 1), quadratic, X0)
    with pytest.raises(ShmooError, match="rollout_fn"):
        run(state=mppi.init(CFG, jax.random.key(0)))


def test_lists_and_arrays_make_the_config_that_tuples_make() -> None:
    assert replace(CFG, sigma=[0.3] * 3, low=np.full(3, -5.0), high=[5] * 3) == CFG
    assert len({replace(CFG, sigma=[0.3] * 3), CFG}) == 1


def test_temperature_limits_and_cost_scale() -> None:
    costs = jnp.array([3.0, 1.0, 2.0])
    weigh = partial(mppi.importance_weights, costs=costs, valid=jnp.ones(3, bool))
    np.testing.assert_allclose(weigh(replace(CFG, temperature=1e-4)), [0, 1, 0], atol=1e-6)
    np.testing.assert_allclose(weigh(replace(CFG, temperature=1e6)), np.full(3, 1 / 3), atol=1e-5)
    expected = np.exp(-np.array([2.0, 0.0, 1.0]) / 0.7)
    np.testing.assert_allclose(weigh(replace(CFG, temperature=0.7)), expected / expected.sum(), rtol=1e-5)
    np.testing.assert_allclose(
        weigh(replace(CFG, temperature=7.0, cost_scale=10.0)), expected / expected.sum(), rtol=1e-5
    )


@pytest.mark.parametrize("scale", [1e-30, 1.0, 1e30])
def test_equal_costs_weigh_the_same_and_scales_do_not_break(scale: float) -> None:
    weigh = partial(mppi.importance_weights, CFG, valid=jnp.ones(4, bool))
    np.testing.assert_allclose(weigh(jnp.full(4, scale)), np.full(4, 0.25), rtol=1e-6)
    spread = np.asarray(weigh(scale * jnp.array([3.0, 1.0, 2.0, 1.0])))
    assert spread.sum() == pytest.approx(1.0, abs=1e-6)
    expected = [0.25] * 4 if scale < 1 else [0.0, 0.5, 0.0, 0.5]  # far below and far above the temperature of 0.05
    np.testing.assert_allclose(spread, expected, atol=1e-6)


def test_one_nan_rollout_changes_nothing_but_its_own_weight() -> None:
    def plan(bad: bool) -> mppi.Plan:
        def cost(traj: Any, controls: Any, last_u: Any) -> Any:
            costs = quadratic(traj, controls, last_u)
            return costs.at[7].set(jnp.nan if bad else 1e6)  # a roll-out so dear weighs nothing either

        return mppi.update(
            CFG, integrate, cost, X0, nominal=jnp.zeros((6, 3)), last_u=jnp.zeros(3), key=jax.random.key(2)
        )

    clean, broken = plan(False), plan(True)
    assert int(clean.invalid) == 0 and int(broken.invalid) == 1 and bool(broken.ok)
    assert float(broken.weights[7]) == 0.0
    np.testing.assert_allclose(broken.weights, clean.weights, atol=1e-7)
    np.testing.assert_allclose(broken.nominal, clean.nominal, atol=1e-6)


def test_invalid_rollouts_are_ignored_and_counted() -> None:
    def broken(x0: Any, controls: Any) -> Any:
        # The state blows up wherever the first control is positive; the cost below does not look at it.
        seen = integrate(x0, controls)
        return {"seen": seen, "hidden": jnp.where(controls[:, :1, :1] > 0, jnp.nan, seen)}

    plan = mppi.update(
        CFG,
        broken,
        lambda t, c, last: quadratic(t["seen"], c, last),
        X0,
        nominal=jnp.zeros((6, 3)),
        last_u=jnp.zeros(3),
        key=jax.random.key(2),
    )
    positive = np.asarray(plan.controls[:, 0, 0] > 0)
    assert int(plan.invalid) == positive.sum() > 100
    assert bool(plan.ok)
    assert (np.asarray(plan.weights)[positive] == 0).all()
    assert float(plan.nominal[0, 0]) < 0


def test_no_valid_rollout_gives_the_safe_action() -> None:
    state = mppi.init(CFG, jax.random.key(3), jnp.ones(3))
    u, after, plan = mppi.plan(
        CFG, lambda x0, c: integrate(x0, c) * jnp.nan, lambda t, c, last: jnp.sum(t, axis=(-2, -1)), X0, state=state
    )
    assert not bool(plan.ok) and int(plan.invalid) == CFG.num_rollouts
    np.testing.assert_array_equal(u, np.zeros(3))
    np.testing.assert_array_equal(after.nominal, np.zeros((6, 3)))
    np.testing.assert_array_equal(plan.weights, np.zeros(CFG.num_rollouts))


def test_recovers_from_a_broken_warm_start() -> None:
    state = mppi.init(CFG, jax.random.key(3))._replace(nominal=jnp.full((6, 3), jnp.nan))
    u, after, plan = mppi.plan(CFG, integrate, lambda t, c, last: jnp.zeros(len(c)), X0, state=state)
    assert bool(plan.ok)
    np.testing.assert_array_equal(u, np.zeros(3))
    assert np.isfinite(after.nominal).all()


def test_warm_start_shifts_by_one_step() -> None:
    state = mppi.init(CFG, jax.random.key(4))
    u, after, plan = mppi.plan(CFG, integrate, quadratic, X0, state=state)
    np.testing.assert_array_equal(u, plan.nominal[0])
    np.testing.assert_array_equal(after.last_u, u)
    np.testing.assert_array_equal(after.nominal[:-1], plan.nominal[1:])
    np.testing.assert_array_equal(after.nominal[-1], plan.nominal[-1])
    np.testing.assert_array_equal(plan.controls[0], state.nominal)


def test_last_applied_control_reaches_the_cost() -> None:
    state = mppi.init(CFG, jax.random.key(4), jnp.array([0.1, 0.2, 0.3]))
    _, _, plan = mppi.plan(CFG, integrate, lambda t, c, last: jnp.full(len(c), last.sum()), X0, state=state)
    np.testing.assert_allclose(plan.costs, 0.6, rtol=1e-6)


def test_controls_stay_within_bounds() -> None:
    cfg = replace(CFG, low=(-0.2, -0.1, 0.05), high=(0.2, 0.3, 0.4), sigma=(1.0, 1.0, 1.0))
    u, _, plan = mppi.plan(cfg, integrate, quadratic, 10 * X0, state=mppi.init(cfg, jax.random.key(5), 9 * jnp.ones(3)))
    for controls in (np.asarray(plan.controls), np.asarray(plan.nominal), np.asarray(u)):
        assert (controls >= np.array(cfg.low, np.float32)).all() and (controls <= np.array(cfg.high, np.float32)).all()
    np.testing.assert_allclose(plan.controls[1], np.broadcast_to([0.0, 0.0, 0.05], (6, 3)), rtol=1e-6)


def test_same_key_same_plan_other_key_other_plan() -> None:
    run = partial(mppi.plan, CFG, integrate, quadratic, X0)
    first, second = run(state=mppi.init(CFG, jax.random.key(6))), run(state=mppi.init(CFG, jax.random.key(6)))
    jax.tree.map(np.testing.assert_array_equal, first[2], second[2])
    third = run(state=mppi.init(CFG, jax.random.key(7)))
    assert np.abs(first[2].controls - third[2].controls).max() > 0.1
    # The key moves on: planning again from the returned state draws other samples.
    again = run(state=first[1])
    noise = [r[2].controls[2] - start for r, start in ((first, jnp.zeros((6, 3))), (again, first[1].nominal))]
    assert np.abs(noise[0] - noise[1]).max() > 0.05


def test_batch_equals_one_by_one_and_compiles_once() -> None:
    traces = []

    def counted(x0: Any, controls: Any) -> Any:
        traces.append(1)
        return integrate(x0, controls)

    run = jax.jit(partial(mppi.plan, CFG, counted, quadratic))
    starts = jnp.stack([X0, -X0, 2 * X0])
    states = [mppi.init(CFG, k) for k in jax.random.split(jax.random.key(8), 3)]
    single = [run(x, state=s) for x, s in zip(starts, states, strict=True)]
    assert len(traces) == 1
    batch = jax.vmap(run)(starts, state=jax.tree.map(lambda *x: jnp.stack(x), *states))
    for i, (u, state, plan) in enumerate(single):
        np.testing.assert_allclose(batch[0][i], u, atol=1e-5)
        np.testing.assert_allclose(batch[1].nominal[i], state.nominal, atol=1e-5)
        np.testing.assert_allclose(batch[2].costs[i], plan.costs, rtol=1e-4)


@pytest.mark.parametrize(
    "bad",
    [
        {"temperature": 0.0},
        {"temperature": np.nan},
        {"num_rollouts": 2},
        {"num_rollouts": 20.5},
        {"horizon": 0},
        {"noise_correlation": 1.0},
        {"noise_correlation": np.nan},
        {"sigma": (0.1, -0.1, 0.1)},
        {"sigma": (0.1, np.nan, 0.1)},
        {"sigma": 0.1},
        {"sigma": ()},
        {"low": (6.0, 0.0, 0.0)},
        {"low": (-1.0,)},
        {"low": (np.nan, -1.0, -1.0)},
        {"high": (np.inf, 1.0, 1.0)},
        {"high": [1.0, 1.0]},
        {"cost_scale": -1.0},
        {"cost_scale": np.inf},
    ],
)
def test_config_names_the_field_that_is_wrong(bad: dict[str, Any]) -> None:
    with pytest.raises(ShmooError, match=next(iter(bad))):
        replace(CFG, **bad)


def test_sigma_of_another_length_than_the_bounds_is_refused() -> None:
    with pytest.raises(ShmooError, match="sigma"):
        replace(CFG, sigma=(0.1,))


def test_three_rollouts_are_the_least_and_do_sample() -> None:
    _, _, plan = mppi.plan(
        replace(CFG, num_rollouts=3), integrate, quadratic, X0, state=mppi.init(CFG, jax.random.key(0))
    )
    assert np.abs(plan.controls[2]).max() > 0.01
