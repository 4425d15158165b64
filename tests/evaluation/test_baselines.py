"""Each method of the comparison learns what it can: the synthetic objects obey a linear law with their own numbers."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

from shmoo_mjx.data import store
from shmoo_mjx.dynamics import object_model
from shmoo_mjx.dynamics.object_model import ObjectConfig
from shmoo_mjx.evaluation import scoring
from shmoo_mjx.evaluation.baselines import (
    METHODS,
    Budget,
    Job,
    Predictor,
    Recordings,
    first_samples,
    networks,
    recordings,
    sight,
)
from shmoo_mjx.evaluation.baselines.protocol import output_scale
from shmoo_mjx.learning import contact_prior, training_contacts
from shmoo_mjx.learning.samples import Samples

SHORT = {"horizon": 4, "learning_rate": 5e-3, "conditions": 6, "windows": 8, "adapt_samples": 32}
"""DAIML for few conditions and little time."""


@pytest.fixture(scope="module")
def job(synthetic_dataset: store.Dataset) -> Job:
    split = synthetic_dataset.split
    return Job(recordings(split("train")), recordings(split("validation")), {}, Budget(3, 80, 3), 0, 100)


@pytest.fixture(scope="module")
def unseen(synthetic_dataset: store.Dataset) -> Recordings:
    return recordings(synthetic_dataset.split("test"))


def unexplained(predictor: Predictor, recorded: Recordings, job: Job) -> float:
    return float(
        np.mean(scoring.score(predictor, recorded, output_scale(job.train.samples), 100, roll_outs=False)["fvu"])
    )


def with_context(recorded: Recordings, factor: float) -> Recordings:
    """The labels of the rows to adapt on multiplied."""
    labels = np.array(recorded.samples.labels)
    labels[:, :100] *= factor
    return recorded._replace(samples=recorded.samples._replace(labels=labels))


def fitted(name: str, job: Job, **setting: Any) -> Predictor:
    method = METHODS[name]
    return method.fit(replace(job, setting=method.settings[0] | setting))


def test_every_method_tries_as_many_settings() -> None:
    learn = [method for method in METHODS.values() if method.name != "constant_velocity"]
    assert all(len({str(s) for s in method.settings}) == len(method.settings) == 4 for method in learn)


@pytest.mark.slow
def test_time_alone_explains_nothing(job: Job, unseen: Recordings) -> None:
    assert unexplained(fitted("trigonometric", job), unseen, job) > 0.8


@pytest.mark.slow
def test_the_gru_uses_its_context(job: Job, unseen: Recordings) -> None:
    predictor = networks.gru(replace(job, setting={"learning_rate": 3e-3}))
    own = unexplained(predictor, unseen, job)
    assert own < 0.6
    assert unexplained(predictor, with_context(unseen, -1.0), job) > own + 0.02


@pytest.fixture
def contacts(monkeypatch: pytest.MonkeyPatch) -> None:
    """Contact parameters of conditions as drawn, not estimated, which would take a minute."""
    prior = contact_prior.draws(96)

    def drawn(config: Any, train: Samples, validation: Samples, **_: Any) -> training_contacts.Contacts:
        of_prior, of_training, of_validation = training_contacts.zeros(train, validation)
        spread = np.random.default_rng(0).normal(size=of_training.shape)
        own = jnp.asarray(prior.mean(0) + prior.std(0) * spread, jnp.float32)
        return of_prior, own, of_validation + prior.mean(0)

    monkeypatch.setattr(training_contacts, "estimated", drawn)


@pytest.mark.slow
def test_what_sees_the_contact_model_sees_what_psi_sees(contacts: None, job: Job) -> None:
    sees, plain = sight.sight(job), sight.sight(job, contact_model=False)
    context, contact = first_samples(job.train, 0, 50), sees.contacts[1][0, -1]
    config, scale = ObjectConfig(), jnp.asarray(output_scale(job.train.samples))
    raw = object_model.network_inputs(scale, jnp.asarray(context.inputs), config, contact)
    np.testing.assert_allclose(sees(context.inputs, contact) * sees.spread + sees.mean, raw, atol=1e-3)
    np.testing.assert_array_equal(sees.contact(context._replace(contact=contact)), contact)
    assert plain(context.inputs, contact).shape[-1] == context.inputs.shape[-1] and not plain.contact(context).any()


@pytest.mark.slow
@pytest.mark.parametrize("name", ["gru", "residual"])
def test_predictions_depend_on_the_contact_parameters_seen(name: str, contacts: None, job: Job) -> None:
    predictor = METHODS[name].fit(replace(job, setting=METHODS[name].settings[0], budget=Budget(2, 30, 2)))
    context, x = first_samples(job.validation, 0, 100), jnp.asarray(job.validation.samples.inputs[0, 100:150])
    prior = contact_prior.draws(96)
    one, other = (
        predictor.predict(predictor.adapt(context._replace(contact=jnp.asarray(contact))), x, jnp.zeros(50))
        for contact in (prior.mean(0), prior.mean(0) + prior.std(0))
    )
    assert bool(jnp.all(jnp.isfinite(one))) and float(jnp.max(jnp.abs(one - other))) > 1e-3


@pytest.mark.slow
def test_networks_without_a_context_do_not_care_for_it(job: Job, unseen: Recordings) -> None:
    predictor = fitted("mlp", job, learning_rate=3e-3)
    own = unexplained(predictor, unseen, job)
    assert own < 0.8
    assert unexplained(predictor, with_context(unseen, -1.0), job) == pytest.approx(own)


@pytest.mark.slow
def test_a_finished_training_is_read_back(job: Job, tmp_path: Path) -> None:
    kept = replace(job, setting={"learning_rate": 1e-3}, budget=Budget(2, 10, 2), directory=tmp_path)
    first = METHODS["mlp"].fit(kept)
    files = {p: p.stat().st_mtime_ns for p in tmp_path.rglob("*") if p.is_file()}
    assert files
    again = METHODS["mlp"].fit(kept)
    assert {p: p.stat().st_mtime_ns for p in tmp_path.rglob("*") if p.is_file()} == files
    x, context = jnp.asarray(job.train.samples.inputs[0, :5]), first_samples(job.train, 0, 20)
    np.testing.assert_array_equal(*(p.predict(p.adapt(context), x, jnp.zeros(5)) for p in (first, again)))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["ours", "ours_paper", "residual"])
def test_psi_adapts(name: str, job: Job, unseen: Recordings) -> None:
    predictor = METHODS[name].fit(replace(job, setting=SHORT))
    assert unexplained(predictor, unseen, job) < 0.5
    assert unexplained(METHODS[name].fit(replace(job, setting=SHORT)), unseen, job) == pytest.approx(
        unexplained(predictor, unseen, job)
    )
