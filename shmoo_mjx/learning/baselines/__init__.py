"""The methods that the learned object model is compared with, all behind one protocol."""

from __future__ import annotations

from shmoo_mjx.learning.baselines import adaptive, fixed, linear, networks
from shmoo_mjx.learning.baselines.protocol import (
    Budget,
    Context,
    Job,
    Method,
    Predictor,
    Recordings,
    Setting,
    first_samples,
    recordings,
    with_setting,
)

__all__ = [
    "METHODS",
    "REFERENCES",
    "Budget",
    "Context",
    "Job",
    "Method",
    "Predictor",
    "Recordings",
    "first_samples",
    "recordings",
]

_RIDGES = tuple({"ridge": ridge} for ridge in (1.0, 0.001, 10.0, 100.0))
_PRIORS = tuple({"noise": noise, "coupled": coupled} for noise in (1.0, 4.0) for coupled in (True, False))
_DAIML: tuple[Setting, ...] = ({}, {"one_step": 4.0}, {"functions": 6}, {"learning_rate": 8e-3})
# Trained for one step alone, a residual has no weight between that and a roll-out to choose.
_ON_RESIDUAL: tuple[Setting, ...] = ({}, {"learning_rate": 1e-3}, {"functions": 6}, {"learning_rate": 8e-3})
_PAPER: tuple[Setting, ...] = ({}, {"learning_rate": 1e-3}, {"ridge": 3.0}, {"learning_rate": 8e-3})
_NETS = tuple({"learning_rate": rate, "decay": decay} for rate in (3e-3, 8e-3) for decay in (0.0, 0.1))

METHODS: dict[str, Method] = {
    method.name: method
    for method in (
        Method("ours", adaptive.ours, _DAIML),
        Method("ours_paper", adaptive.paper_form, _PAPER),
        Method("trigonometric", linear.trigonometric, _RIDGES, trained=False),
        Method("residual", adaptive.residual, _ON_RESIDUAL),
        Method("mlp", networks.mlp, _NETS),
        # With the identified contact model among what they see; the last one trained by psi's loss.
        Method("residual_body", with_setting(adaptive.residual, body=True), _ON_RESIDUAL),
        Method("linear_prior_body", with_setting(linear.linear_prior, body=True), _PRIORS, trained=False),
        Method("gru_body", with_setting(networks.gru, body=True), _NETS),
        Method("gru_fed_back", with_setting(networks.gru, body=True, feed_back=True), _NETS),
    )
}
"""Every method that is tuned, by the name its metrics carry."""

REFERENCES: dict[str, Method] = {
    method.name: method
    for method in (
        Method("zero", fixed.zero, ({},), trained=False),
        Method("constant_velocity", fixed.constant_velocity, ({},), trained=False),
    )
}
"""What learns nothing and has nothing to tune."""
