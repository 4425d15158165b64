"""Drawn bodies: each difference can be switched, and each does what it says."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from shmoo_mjx.plant.engine_mujoco import MujocoEngine
from shmoo_mjx.plant.perturbation import Perturbation, adjustment, draw_body
from shmoo_mjx.plant.scene import build_scene
from shmoo_mjx.plant.trials import drive

NONE = Perturbation.none()


def test_without_imperfections_it_is_the_training_plant() -> None:
    plain, other = build_scene().model, build_scene(adjust=adjustment(draw_body(NONE, 3))).model
    for name in ("body_mass", "body_ipos", "dof_damping", "dof_frictionloss", "actuator_gear"):
        np.testing.assert_array_equal(getattr(plain, name), getattr(other, name), err_msg=name)


def test_other_bodies_still_balance() -> None:
    scenes = [build_scene(adjust=adjustment(draw_body(Perturbation(), seed))) for seed in range(3)]
    engine = MujocoEngine(scenes)
    _, fallen = drive(engine, seconds=2.0, velocity=lambda time: (0.3, 0.0))
    engine.close()
    assert not fallen.any()


def test_motor_lag_is_a_first_order_filter() -> None:
    perturbation = dataclasses.replace(NONE, motor_lag=0.05)
    scene = build_scene(adjust=adjustment(draw_body(perturbation, 0)))
    assert scene.model.na == 9
    np.testing.assert_allclose(scene.model.actuator_dynprm[:, 0], 0.05)
    assert build_scene(adjust=adjustment(draw_body(NONE, 0))).model.na == 0


def test_drawn_bodies_differ_within_their_ranges() -> None:
    bodies = [draw_body(Perturbation(), seed) for seed in range(50)]
    masses = np.array([b.mass for b in bodies])
    assert masses.min() > 0.85 and masses.max() < 1.15 and masses.std() > 0.05
    assert {round(b.delay, 3) for b in bodies} == {0.02, 0.03, 0.04}
    model = build_scene(adjust=adjustment(bodies[0])).model
    assert model.body("robot/torso").mass[0] == pytest.approx(32.0 * bodies[0].mass)
    assert model.body("robot/torso").ipos[2] == pytest.approx(0.5 + bodies[0].com[2])
    assert model.joint("robot/ball").damping[0] == pytest.approx(0.6 * bodies[0].drive_friction)
