"""Networks without a preferred side, and the transition that is made of them."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from shmoo_mjx.dynamics import contact_model, core, features, fused, networks, object_model, robot_model
from shmoo_mjx.dynamics.core import CoreConfig
from shmoo_mjx.dynamics.object_model import ObjectConfig
from shmoo_mjx.learning import contact_prior

PER_AXIS = CoreConfig()
SHARED = CoreConfig(object=ObjectConfig(per_axis=False, last_wrench=False, functions=6, contact_model=False))


def trained(config: CoreConfig, symmetrical: bool = True) -> core.Params:
    """Parameters as a training might leave them: nothing is zero that a training may move."""
    params = core.init(jax.random.key(0), config)
    rng = np.random.default_rng(1)

    def moved(x: jax.Array) -> jax.Array:
        return jnp.asarray(x + 0.3 * rng.normal(size=x.shape), jnp.float32)

    inside, seen = features.reflection(features.ROBOT_INPUTS), object_model.reflections(config.object)[0]
    robot = params.robot.net._replace(layers=jax.tree.map(moved, params.robot.net.layers))
    robot = networks.with_normaliser(robot, jnp.asarray(rng.normal(size=(50, 28)) + 0.5), inside)
    net = params.object.net._replace(layers=jax.tree.map(moved, params.object.net.layers))
    net = networks.with_normaliser(net, jnp.asarray(rng.normal(size=(50, len(seen))) + 0.5), seen)
    signs = object_model.coefficient_signs(config.object)
    coefficients = jnp.asarray(rng.normal(size=signs.shape), jnp.float32)
    contact = contact_model.guess() + 0.1
    if symmetrical:
        coefficients, contact = (
            jnp.where(signs > 0, coefficients, 0.0),
            (contact + contact_prior.mirrored(np.asarray(contact))) / 2,
        )
    return core.Params(
        params.robot._replace(net=robot, output_mean=jnp.array([0.1, 0.0, 0.0, 2.0, 0.0])),
        params.object._replace(net=net, linear=moved(params.object.linear), label_scale=jnp.array([0.5, 0.4, 0.9])),
        coefficients,
        contact,
    )


@pytest.mark.parametrize("config", [PER_AXIS, SHARED], ids=["functions per axis", "shared functions"])
def test_psi_of_the_mirrored_push_is_psi_in_the_mirror(config: CoreConfig) -> None:
    params = trained(config)
    x = np.random.default_rng(2).normal(size=(40, 13)).astype(np.float32)
    axes = features.reflection(features.OBJECT_OUTPUTS)
    mirrored = x @ features.reflection(features.OBJECT_INPUTS)
    basis = jax.jit(lambda x: object_model.basis(params.object, x, config.object, params.contact))
    psi, other = basis(x), basis(mirrored)
    signs = object_model.coefficient_signs(config.object)
    # The body's feet are relaxed one after the other, which leaves a trace of their order.
    close = 2e-3 if config.object.contact_model else 1e-5
    scale = float(np.abs(psi).max())
    np.testing.assert_allclose(other, np.einsum("ij,njk->nik", axes, psi) * signs, atol=close * scale)
    assert scale > 0.1


def test_r_of_the_mirrored_input_is_r_in_the_mirror() -> None:
    params = trained(PER_AXIS)
    x = np.random.default_rng(2).normal(size=(40, 28)).astype(np.float32)
    mirrored = x @ robot_model.REFLECTIONS[0]
    said, other = (np.concatenate(robot_model.predict(params.robot, i, PER_AXIS.robot), -1) for i in (x, mirrored))
    np.testing.assert_allclose(other, said @ robot_model.REFLECTIONS[1], rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize("table", [features.ROBOT_INPUTS, features.OBJECT_INPUTS], ids=["R", "psi"])
def test_the_mirror_of_the_mirror_is_the_thing(table: tuple[features.Entry, ...]) -> None:
    matrix = features.reflection(table)
    assert (matrix @ matrix == np.eye(features.width(table))).all() and (matrix == matrix.T).all()


def test_odd_widths_are_refused() -> None:
    with pytest.raises(ValueError, match="even widths"):
        networks.init(networks.EquivariantMLP((7, 2), (np.eye(3), np.eye(2))), jax.random.key(0), 3)


def test_what_is_fused_says_the_same() -> None:
    rng, params = np.random.default_rng(3), trained(PER_AXIS)
    x = rng.normal(size=(6, 4, 28)).astype(np.float32)
    said = robot_model.normalised(params.robot.net, x, PER_AXIS.robot)
    ready = fused.fuse_equivariant(params.robot.net, robot_model.REFLECTIONS).forward(np.moveaxis(x, -1, 0), "relu")
    np.testing.assert_allclose(np.moveaxis(ready, 0, -1), said, rtol=1e-4, atol=1e-5)
    plain = networks.MLP((16, 8, 5), "tanh")
    net = networks.with_normaliser(networks.init(plain, jax.random.key(1), 28), x + 0.5)
    ready = fused.fuse(net).forward(np.moveaxis(x, -1, 0), "tanh")
    np.testing.assert_allclose(np.moveaxis(ready, 0, -1), networks.apply(plain, net, x), rtol=1e-4, atol=1e-5)


def test_no_layer_keeps_a_larger_norm_than_the_cap() -> None:
    net = networks.init(networks.MLP((32, 16, 4)), jax.random.key(0), 10)
    net = net._replace(layers=jax.tree.map(lambda x: 3.0 * x, net.layers))
    vectors = {name: jnp.ones(layer["kernel"].shape[1]) for name, layer in net.layers.items()}
    for _ in range(50):
        net, vectors = networks.cap_spectral_norm(net, vectors, 0.7)
    norms = [float(np.linalg.norm(layer["kernel"], 2)) for layer in net.layers.values()]
    np.testing.assert_allclose(norms, 0.7, rtol=1e-3)
