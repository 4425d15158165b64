"""Predicts where pushes lead, by roll-outs of the dynamics core over posterior samples of an object's dynamics.

An option is a push on a face towards a goal with the control law of `quasi_static`. One batch rolls out each option for
every posterior sample, so the outcome is a distribution.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache, partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from shmoo_mjx.arrays import Array, Float, Key, Scalar, single_precision
from shmoo_mjx.control import quasi_static
from shmoo_mjx.control.governor import static_lean
from shmoo_mjx.control.observation import ObjectObservation
from shmoo_mjx.control.presets import PushConfig
from shmoo_mjx.control.pushing import PushController
from shmoo_mjx.control.speed import SpeedProfile
from shmoo_mjx.dynamics import contact_model, core
from shmoo_mjx.dynamics.core import CoreConfig, Params
from shmoo_mjx.geometry import se2
from shmoo_mjx.geometry.faces import heading
from shmoo_mjx.geometry.hands import HAND_RADIUS, REACH
from shmoo_mjx.learning import estimate, online
from shmoo_mjx.learning.estimate import ObjectEstimate
from shmoo_mjx.learning.online import LearnerState
from shmoo_mjx.learning.weights import Weights, load_weights, prior_state
from shmoo_mjx.types import SystemState

SAMPLES = 16
"""Number of posterior samples for each option."""
STEPS = 120
"""Number of time steps of a roll-out: 12 s."""
_FAR = 2.5
"""Distance of the goal of an open-ended push [m], longer than most pushes."""
MOVES = 0.316
"""Distance along a push at which an object counts as movable [m]. It is what K = 0.3 m^2 requires of each of three
roll-outs, and the certificates use it too."""
TURNS = float(np.radians(30.0))
"""Rotation beyond which it does not count as movable [rad], because it turns away instead of moving along."""
_PRIOR_KEY = 55
"""Seed of the prior particles of untouched objects."""
_ONE = ObjectObservation._make((0, 0, 0, 0, 0, 0, 0, None, None))
"""vmap axes of the observation that the control law takes."""
_UNKNOWN = (0.02, 0.03, 0.25)
"""Standard deviations of a constant difference between the command and its effect [rad, rad, rad]. It models errors of
the robot's balance and steering, and of the model."""
_FAR_STEPS = 240
"""Number of time steps of an expected push: 24 s, or 3.5 m at the speed of pushing to a pose."""
_STRONGEST = quasi_static.LEAN_LIMIT / float(static_lean(1.0))
"""Force of the hands at the lean limit [N]. An object with more resistance along both axes does not move."""


class Options(NamedTuple):
    """O candidate pushes of one object, each from the middle of a face towards a goal."""

    face: Float[Array, "O 4"]
    """Faces as `faces_of` and `corners_of` return them."""
    goal: Float[Array, "O 3"]
    """Target pose of {O} in {W}."""


class Outcomes(NamedTuple):
    """Predicted poses for O pushes and S samples of an object's dynamics, at the end of each of T time steps."""

    object_pose: Float[Array, "O S T 3"]
    """Pose of the object in {W}."""
    robot_pose: Float[Array, "O S T 3"]
    """Pose of the robot in {W}."""


@single_precision
def reach(
    params: Params,
    samples: Float[Array, "S p"],
    key: Key[Array, ""],
    *,
    object_pose: Float[Array, "3"],
    half_extents: Float[Array, "2"],
    options: Options,
    config: CoreConfig,
    speed: SpeedProfile,
    steps: int,
) -> Outcomes:
    """Rolls out every option for every sample. At the start the hands touch the face and everything is at rest.

    Args:
        params: the learned model; the samples replace its contact parameters.
        samples: contact parameters, as `estimate.draw` returns them.
        key: random key of the differences between command and effect.
        object_pose: pose of {O} in {W}.
        half_extents: half sizes of the footprint [m].
        options: the candidate pushes.
        config: shapes of the model; static.
        speed: speed limits; static.
        steps: T; static.
    """
    start = _start(jnp.asarray(object_pose, jnp.float32), jnp.hypot(*jnp.asarray(half_extents, jnp.float32)), options)
    roll = partial(_roll, params=params, config=config, speed=speed, steps=steps, options=options, start=start)
    unknown = jnp.array(_UNKNOWN) * jax.random.normal(key, (len(samples), len(_UNKNOWN)))
    objects, robots = jax.vmap(roll)(jnp.asarray(samples, jnp.float32), unknown)
    return Outcomes(jnp.transpose(objects, (2, 0, 1, 3)), jnp.transpose(robots, (2, 0, 1, 3)))


def _start(object_pose: Array, size: Array, options: Options) -> SystemState:
    face = jnp.asarray(options.face, jnp.float32)
    count = len(face)
    in_face = jnp.array([-(REACH + HAND_RADIUS), 0.0, 0.0])
    poses = jnp.broadcast_to(object_pose, (count, 3))
    robot = se2.compose(poses, se2.compose(face[:, :3], in_face))
    none = jnp.zeros((count, 3))
    flat = none[:, :2]
    return SystemState(robot, none, flat, flat, poses, none, none, none, flat, none, face, jnp.full(count, size))


def _roll(
    contact: Array,
    unknown: Array,
    *,
    params: Params,
    config: CoreConfig,
    speed: SpeedProfile,
    steps: int,
    options: Options,
    start: SystemState,
) -> tuple[Array, Array]:
    """Poses ``[T, O, 3]`` of object and robot for one sample."""
    params = params._replace(contact=contact)

    def law(obs: ObjectObservation, integral: Array, face: Array, goal: Array) -> tuple[Array, Scalar]:
        return quasi_static.control(speed, obs, integral, face=face, goal=goal)

    def one(carry: tuple[SystemState, Array], _: None) -> tuple[tuple[SystemState, Array], tuple[Array, Array]]:
        state, integral = carry
        wrench = se2.rotate(state.last_wrench, state.object_pose[:, 2])
        obs = ObjectObservation(*state[:6], wrench)
        u, later = jax.vmap(law, in_axes=(_ONE, 0, 0, 0))(obs, integral, state.face, options.goal)
        state = core.step(params, state, u + unknown, config)[0]
        return (state, jnp.asarray(later)), (state.object_pose, state.robot_pose)

    begin: tuple[SystemState, Array] = (start, jnp.zeros(len(start.object_pose)))
    return jax.lax.scan(one, begin, None, length=steps)[1]


def goal_ahead(
    pose: Float[np.ndarray, "3"], face: Float[np.ndarray, "4"], bearing: float = 0.0, distance: float = _FAR
) -> Float[np.ndarray, "3"]:
    """Goal in {W} of a push on ``face`` of an object at ``pose`` along an arc.

    Args:
        pose: pose of the object in {W}.
        face: the face to push on.
        bearing: bearing of the goal, to the left of straight ahead [rad].
        distance: distance of the goal [m].
    """
    ahead = heading(pose, face) + bearing
    return np.array([pose[0] + distance * np.cos(ahead), pose[1] + distance * np.sin(ahead), pose[2] + 2.0 * bearing])


def progress(
    poses: Float[np.ndarray, "*n T 3"], start: Float[np.ndarray, "3"], face: Float[np.ndarray, "4"]
) -> Float[np.ndarray, "*n T"]:
    """Distance [m] that an object has moved along a push on ``face``, at each of its ``poses``.

    All poses are in {W}; ``start`` precedes the first. The push direction turns with the object.
    """
    before = np.concatenate([np.broadcast_to(start, poses[..., :1, :].shape), poses[..., :-1, :]], axis=-2)
    ahead, step = heading(before, face), poses[..., :2] - before[..., :2]
    return np.cumsum(step[..., 0] * np.cos(ahead) + step[..., 1] * np.sin(ahead), axis=-1)


def probability_to_come(
    poses: Float[np.ndarray, "*n S T 3"],
    start: Float[np.ndarray, "3"],
    face: Float[np.ndarray, "4"],
    *,
    distance: float,
    turn: float = np.inf,
) -> Float[np.ndarray, "*n"]:
    """Probability that an object moves ``distance`` [m] along a push on ``face`` before it turns by ``turn`` [rad].

    It is the share of the samples in ``poses`` (see `Outcomes`) that do so from ``start``. A sample that diverges stops
    moving.
    """
    within = np.logical_and.accumulate(~(np.abs(se2.wrap(poses[..., 2] - start[2])) > turn), axis=-1)
    return np.asarray(((progress(poses, start, face) >= distance) & within).any(axis=-1).mean(axis=-1))


def median_parameters(estimated: ObjectEstimate) -> Float[Array, "p"]:
    """Median of each contact parameter over the particles that a push can move, or over all if it can move none."""
    moves = contact_model.resistance(estimated.parameters).min(axis=-1) < _STRONGEST
    weight = jnp.where(moves | ~moves.any(), estimated.log_weight, -jnp.inf)
    return estimate.quantiles(estimated._replace(log_weight=weight), estimated.parameters, (0.5,))[0]


class Foresight:
    """`reach` for the weights and settings of one pushing controller, compiled once for all objects and maps."""

    def __init__(self, weights: Weights, config: PushConfig) -> None:
        shape = weights.config.object
        # Over many seconds the contact model alone predicts better than with psi, which is trained on three.
        model = replace(weights.config, object=replace(shape, residual=not shape.contact_model))

        def run(adapt: LearnerState, key: Array, options: Options, *, pose: Array, half_extents: Array) -> Outcomes:
            params = online.learner(shape, config.estimate, config.adapt).params_for_rollout(adapt, weights.params)
            draw_key, own_key = jax.random.split(key)
            if isinstance(adapt, ObjectEstimate):
                samples = estimate.draw(adapt, draw_key, SAMPLES)
            else:
                samples = jnp.tile(params.contact, (SAMPLES, 1))
            return reach(
                params,
                samples,
                own_key,
                object_pose=pose,
                half_extents=half_extents,
                options=options,
                config=model,
                speed=config.speed,
                steps=STEPS,
            )

        def run_median(estimated: ObjectEstimate, half_extents: Array, options: Options) -> Array:
            begin = _start(jnp.zeros(3), jnp.hypot(*half_extents), options)
            objects, _ = _roll(
                median_parameters(estimated),
                jnp.zeros(len(_UNKNOWN)),
                params=weights.params,
                config=model,
                speed=config.speed,
                steps=_FAR_STEPS,
                options=options,
                start=begin,
            )
            return jnp.swapaxes(objects, 0, 1)

        self._run, self._run_median = jax.jit(run), jax.jit(run_median)
        self._prior = lru_cache(maxsize=8)(
            lambda kind: prior_state(weights, config.estimate, jax.random.key(_PRIOR_KEY), kind)
        )

    @single_precision
    def __call__(
        self,
        adapt: LearnerState | None,
        kind: str | None,
        pose: Float[Array, "3"],
        half_extents: Float[Array, "2"] | tuple[float, float],
        *,
        options: Options,
        seed: int,
    ) -> Outcomes:
        """Outcomes for the object's posterior or, before the first contact, for the prior of its kind.

        Keep the number of options constant, so that the function compiles once.
        """
        estimated = self._prior(kind) if adapt is None else adapt
        key = jax.random.key(seed)
        body = {"pose": np.asarray(pose, np.float32), "half_extents": np.asarray(half_extents, np.float32)}
        return jax.tree.map(np.asarray, self._run(estimated, key, Options(*map(np.asarray, options)), **body))

    @single_precision
    def median_poses(
        self, adapt: Any, kind: str | None, half_extents: tuple[float, float], options: Options
    ) -> Float[np.ndarray, "O T 3"]:
        """Poses of an object that starts at the origin, for the median of its estimated dynamics.

        One roll-out per option: a straight push of a symmetric object stays straight. If ``adapt`` is not a posterior
        of the contact parameters, the prior of the object's kind is used.
        """
        estimated = adapt if isinstance(adapt, ObjectEstimate) else self._prior(kind)
        poses = self._run_median(estimated, np.asarray(half_extents, np.float32), Options(*map(np.asarray, options)))
        return np.asarray(poses, float)

    def sampled_poses(
        self,
        adapt: LearnerState | None,
        kind: str | None,
        pose: Float[Array, "3"],
        half_extents: Float[Array, "2"] | tuple[float, float],
        *,
        face: Float[Array, "4"],
        goal: Float[Array, "3"],
    ) -> Float[np.ndarray, "S T 3"]:
        """Poses of the object in {W}, pushed on ``face`` towards ``goal``, for four times as many samples."""
        option = Options(np.asarray(face)[None], np.asarray(goal)[None])
        outcomes = [self(adapt, kind, pose, half_extents, options=option, seed=seed) for seed in range(4)]
        return np.concatenate([outcome.object_pose[0] for outcome in outcomes]).astype(float)

    def probability_to_move(
        self,
        adapt: LearnerState | None,
        kind: str | None,
        pose: Float[Array, "3"],
        half_extents: Float[Array, "2"] | tuple[float, float],
        *,
        face: Float[Array, "4"],
        distance: float = MOVES,
        turn: float = TURNS,
    ) -> float:
        """Probability that a straight push moves the object (`probability_to_come`)."""
        pose, face = np.asarray(pose, float), np.asarray(face, float)
        poses = self.sampled_poses(adapt, kind, pose, half_extents, face=face, goal=goal_ahead(pose, face))
        return float(probability_to_come(poses, pose, face, distance=distance, turn=turn))


def foresight_of(controller: Any) -> Any:
    """The predictor of where a controller's pushes lead: its own ``foresee``, or the `Foresight` of its settings."""
    return controller.foresee if hasattr(controller, "foresee") else _of(controller)


def contact_foresight(controller: Any, config: PushConfig) -> Foresight:
    """The `Foresight` of a controller whose psi has the contact model, or else of the shipped weights with ``config``.

    So controllers that learn otherwise, or not at all, get the same choice of pushes.
    """
    if isinstance(controller, PushController) and controller.weights.config.object.contact_model:
        return _of(controller)
    return _shipped(config)


@lru_cache(maxsize=4)
def _of(controller: PushController) -> Foresight:
    return Foresight(controller.weights, controller.config)


@lru_cache(maxsize=2)
def _shipped(config: PushConfig) -> Foresight:
    return Foresight(load_weights(), config)
