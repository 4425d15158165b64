"""The experiment `estimate`: roll-outs of draws from a posterior against where the object went."""

from __future__ import annotations

from dataclasses import replace

import jax
import numpy as np
import pytest

from shmoo_mjx.evaluation import estimate as experiment
from shmoo_mjx.learning import contact_prior, estimate
from shmoo_mjx.learning.estimate import EstimateConfig, ObjectEstimate
from shmoo_mjx.learning.weights import Weights, load_weights
from shmoo_mjx.plant.objects import draw_condition

EXACT = EstimateConfig(particles=64, force_error=(0.0, 0.0))
"""The sensed force is the true one."""
BOX = draw_condition("box", 3, {"mass": 6.0, "payload": 0.0, "payload_x": 0.0, "payload_y": 0.0, "friction": 0.4})
PUSH = np.tile([30.0, 0.0, 0.0], (31, 1)).astype(np.float32)
WENT = 0.5 * (30.0 / 6.0 - 0.4 * 9.81) * 3.0**2


@pytest.fixture(scope="module")
def weights() -> Weights:
    """The contact model without psi, whose answers can be told."""
    found = load_weights()
    core = found.config
    return found._replace(config=replace(core, object=replace(core.object, residual=False)))


def _state(*conditions: object) -> ObjectEstimate:
    """A posterior that holds these objects alike, all at rest at (0.5, 0, 90 deg)."""
    prior = np.stack([contact_prior.parameters_of(c) for c in conditions])  # type: ignore[arg-type]
    state = estimate.init(EXACT, prior.astype(np.float32), jax.random.key(0))
    return state._replace(pose=state.pose + np.array([0.5, 0.0, np.pi / 2], np.float32))


def test_draws_go_where_newton_says(weights: Weights) -> None:
    size = float(np.hypot(*BOX.half_extents))
    ends = np.asarray(
        experiment._roll_outs(
            EXACT, weights.config.object, weights.params, _state(BOX), wrenches=PUSH, size=np.float32(size)
        )
    )
    assert ends.shape == (32, 2)
    # In {W}, wherever the object looks.
    assert ends == pytest.approx(np.tile([0.5 + WENT, 0.0], (32, 1)), abs=0.03 * WENT)


def test_a_posterior_is_compared_with_its_prior_and_the_truth(weights: Weights) -> None:
    size = float(np.hypot(*BOX.half_extents))
    others = [replace(BOX, mass=mass) for mass in (4.0, 5.0, 7.0, 9.0)]
    prior = _state(*others).prior
    true = np.array([0.5 + WENT, 0.0])

    def row(*particles: object) -> dict[str, float]:
        return experiment._ahead(EXACT, weights, prior, _state(*particles), wrenches=PUSH, size=size, true=true)

    knows, unsure = row(BOX), row(*others)
    assert knows["ahead_error"] < 0.03 * WENT < knows["prior_ahead_error"]
    # A posterior that is as uncertain as its prior covers the truth; one far off does not.
    assert unsure["ahead_covered"] >= 0.5 and unsure["prior_ahead_error"] == knows["prior_ahead_error"]
    assert row(replace(BOX, mass=20.0))["ahead_covered"] <= 0.5


def test_a_recording_that_ends_early_counts_for_what_it_has() -> None:
    estimates = {f"{n}_{what}": 1.0 for n in ("friction", "mass") for what in ("error", "covered")}
    early = {"family": "box", "seed": 1, "contact_s": 10.0, "jumps": 0, **estimates}
    ends = {"ahead_error": 0.2, "ahead_covered": 0.5, "prior_ahead_error": 0.4, "prior_ahead_covered": 1.0}
    metrics = experiment._metrics([early, early | ends | {"seed": 2, "friction_error": 3.0}])
    assert metrics["friction_error_box_10s"] == 2.0 and metrics["ahead_error_box_10s"] == 0.2
    assert metrics["prior_ahead_coverage_box_10s"] == 1.0 and np.isnan(metrics["ahead_error_cart_1s"])
