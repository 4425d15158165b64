"""Methods that the learned object model is compared with, all behind one protocol."""

from __future__ import annotations

from shmoo_mjx.evaluation.baselines import adaptive, networks, plain
from shmoo_mjx.evaluation.baselines.protocol import (
    Budget,
    Context,
    Job,
    Method,
    Predictor,
    Recordings,
    Setting,
    first_samples,
    recordings,
)

__all__ = [
    "METHODS",
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
_DAIML: tuple[Setting, ...] = ({}, {"one_step": 4.0}, {"functions": 6}, {"learning_rate": 8e-3})
# The residual is trained on single steps only, so it has no weight ``one_step`` to tune.
_ON_RESIDUAL: tuple[Setting, ...] = ({}, {"learning_rate": 1e-3}, {"functions": 6}, {"learning_rate": 8e-3})
_PAPER: tuple[Setting, ...] = ({}, {"learning_rate": 1e-3}, {"ridge": 3.0}, {"learning_rate": 8e-3})
_NETS = tuple({"learning_rate": rate, "decay": decay} for rate in (3e-3, 8e-3) for decay in (0.0, 0.1))

METHODS: dict[str, Method] = {
    method.name: method
    for method in (
        Method("ours", adaptive.ours, _DAIML),
        Method("ours_paper", adaptive.paper_form, _PAPER),
        Method("trigonometric", plain.trigonometric, _RIDGES, trained=False),
        Method("residual", adaptive.residual, _ON_RESIDUAL),
        Method("gru", networks.gru, _NETS),
        Method("mlp", networks.mlp, _NETS),
        Method("constant_velocity", plain.constant_velocity, ({},), trained=False),
    )
}
"""Methods by the name in their metrics. Like ours, the residual and the GRU see the contact model."""
