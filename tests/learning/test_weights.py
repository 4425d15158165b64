"""The weights file: complete, checked, and refused in one sentence when damaged."""

from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from safetensors.numpy import save_file

from shmoo_mjx.dynamics import CoreConfig, ObjectConfig, RobotConfig
from shmoo_mjx.errors import ShmooError
from shmoo_mjx.learning import daiml, robot_fit, serialisation, weights

CONFIG = CoreConfig(robot=RobotConfig(hidden=(8, 8)), object=ObjectConfig(hidden=(8,), per_axis=True), open_gap=0.05)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    path = tmp_path / "w.safetensors"
    weights.save_weights(path, weights.untrained(CONFIG)._replace(info={"seed": 3}))
    return path


def test_round_trip(path: Path) -> None:
    found, made = weights.load_weights(path), weights.untrained(CONFIG)
    assert found.config == CONFIG and found.info == {"seed": 3}
    jax.tree.map(np.testing.assert_array_equal, found.params, made.params)
    assert [p.name for p in path.parent.iterdir()] == [path.name]


def test_parts_are_put_together() -> None:
    made, other = weights.untrained(CONFIG), weights.untrained(CONFIG, seed=1)
    mean = jnp.ones_like(other.params.coefficients)
    contact = daiml.ObjectFit(
        other.params.object, mean, 2 * jnp.eye(mean.size), 3 * jnp.eye(3), 0.2, [], other.contact_prior, CONFIG.object
    )
    robot = robot_fit.RobotFit(other.params.robot, 0.1, np.zeros(5), [])
    both = weights.with_robot(weights.with_object(made, contact), robot)
    assert both.info == {"object_score": 0.2, "robot_score": 0.1} and both.config == CONFIG
    np.testing.assert_array_equal(both.params.coefficients, 1.0)
    jax.tree.map(np.testing.assert_array_equal, both.params.robot, other.params.robot)


@pytest.mark.parametrize("keep", [0, 7, 200, -1])
def test_truncated(path: Path, keep: int) -> None:
    path.write_bytes(path.read_bytes()[:keep])
    with pytest.raises(ShmooError, match=r"w\.safetensors.*damaged"):
        weights.load_weights(path)


def test_garbled(path: Path) -> None:
    content = bytearray(path.read_bytes())
    content[-20] ^= 4
    path.write_bytes(content)
    with pytest.raises(ShmooError, match=r"w\.safetensors.*sha256"):
        weights.load_weights(path)


def test_missing_old_or_of_another_shape(path: Path) -> None:
    with pytest.raises(ShmooError, match="is no file"):
        weights.load_weights(path.parent)
    with pytest.raises(ShmooError, match="no such file"):
        weights.load_weights(path.with_name("x"))
    tree = {"params": weights.untrained(CONFIG).params}
    notes = serialisation.read_notes(path)
    serialisation.save_tree(path, tree, notes | {"schema_version": 0})
    with pytest.raises(ShmooError, match="schema_version"):
        weights.load_weights(path)
    serialisation.save_tree(path, tree, notes)
    with pytest.raises(ShmooError, match=r"'contact_prior' is missing"):
        weights.load_weights(path)
    wide = weights.untrained(CoreConfig(robot=RobotConfig(hidden=(10, 8)), object=CONFIG.object))
    whole = {k: getattr(wide, k) for k in ("params", "prior_covariance", "noise", "contact_prior")}
    serialisation.save_tree(path, whole, notes)
    with pytest.raises(ShmooError, match=r"has shape \(5,\) where \(4,\)"):
        weights.load_weights(path)


def test_values_that_no_training_gives_are_refused(tmp_path: Path) -> None:
    made = weights.untrained(CONFIG)
    thing = made.params.object
    broken = {
        "not finite": made._replace(noise=made.noise.at[0, 0].set(jnp.nan)),
        "label_scale": made._replace(
            params=made.params._replace(object=thing._replace(label_scale=-thing.label_scale))
        ),
        "negative eigenvalue": made._replace(prior_covariance=made.prior_covariance.at[0, 0].set(-1.0)),
    }
    for said, wrong in broken.items():
        weights.save_weights(tmp_path / "w.safetensors", wrong)
        with pytest.raises(ShmooError, match=said):
            weights.load_weights(tmp_path / "w.safetensors")


def test_another_programs_file_is_called_so(tmp_path: Path) -> None:
    save_file({"layer.weight": np.zeros((2, 2), np.float32)}, tmp_path / "w.safetensors")
    with pytest.raises(ShmooError, match="another program's"):
        weights.load_weights(tmp_path / "w.safetensors")


@pytest.mark.parametrize(
    ("part", "field", "value"), [("robot", "activation", "elu"), ("object", "activation", 3), ("robot", "hidden", [7])]
)
def test_a_config_that_no_network_has_is_refused(path: Path, part: str, field: str, value: object) -> None:
    notes = serialisation.read_notes(path)
    notes["config"][part][field] = value
    made = weights.load_weights(path)
    serialisation.save_tree(path, weights._arrays(made), notes)
    with pytest.raises(ShmooError, match="'config'"):
        weights.load_weights(path)
