"""Where pushes lead: roll-outs of the dynamics core under a simple push, over samples of what is known of an object.

An option is a push on a face towards a goal, by the law of `quasi_static`. Each is rolled out for every sample of the
posterior in one batch, so that an outcome is a distribution.
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
"""Samples of the posterior that each option is rolled out for."""
STEPS = 120
"""Samples of time of a roll-out: 12 s."""
_FAR = 2.5
"""Distance of the goal of a push that is to go on [m]: farther than a push mostly goes."""
MOVES = 0.316
"""An object can be moved if it comes at least this far along a push [m]: what K = 0.3 m^2 asks of each of three
roll-outs, and what certificates call movable."""
TURNS = float(np.radians(30.0))
"""Unless it has turned this far by then [rad]: it turns away instead of going along."""
_PRIOR_KEY = 55
"""Seed of the particles of objects that nobody has touched."""
_ONE = ObjectObservation._make((0, 0, 0, 0, 0, 0, 0, None, None))
"""Axes of an observation that the law is mapped over."""
_UNKNOWN = (0.02, 0.03, 0.25)
"""Standard deviations of a constant difference between the command and what it does [rad, rad, rad]: robots balance and
steer otherwise than the model has it, and the model errs."""
_FAR_STEPS = 240
"""Samples of time of an expected push: 24 s, in which it comes 3.5 m at the speed of pushing to a pose."""
_STRONGEST = quasi_static.LEAN_LIMIT / float(static_lean(1.0))
"""Force of the hands at the lean limit [N]: what resists with more along both axes does not move."""


class Options(NamedTuple):
    """O pushes of one object, each from the middle of a face towards a goal."""

    face: Float[Array, "O 4"]
    """As `faces_of` and `corners_of` have them."""
    goal: Float[Array, "O 3"]
    """Pose of {O} in {W} that the push steers for."""


class Outcomes(NamedTuple):
    """Where O pushes lead for S samples of an object's dynamics, at the end of each of T samples of time."""

    object_pose: Float[Array, "O S T 3"]
    """In {W}."""
    robot_pose: Float[Array, "O S T 3"]
    """In {W}."""


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
    """Roll out every option for every sample, with hands that touch the face and everything at rest at the start.

    Args:
        params: the learned model; its contact parameters are replaced by the samples.
        samples: contact parameters, as `estimate.draw` gives them.
        key: of what differs between samples beside those.
        object_pose: of {O} in {W}.
        half_extents: of the footprint [m].
        options: what may be done.
        config: shapes of the model; static.
        speed: allowed; static.
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
    """Goal in {W} of a push on ``face`` of an object at ``pose``, along an arc to a place ``bearing`` [rad] to the left
    of straight ahead, ``distance`` [m] away."""
    ahead = heading(pose, face) + bearing
    return np.array([pose[0] + distance * np.cos(ahead), pose[1] + distance * np.sin(ahead), pose[2] + 2.0 * bearing])


def progress(
    poses: Float[np.ndarray, "*n T 3"], start: Float[np.ndarray, "3"], face: Float[np.ndarray, "4"]
) -> Float[np.ndarray, "*n T"]:
    """Way [m] that an object has come along a push on ``face`` at each of its ``poses``, all in {W}; ``start`` comes
    before the first. The direction of the push turns with the object."""
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
    """Probability that an object comes ``distance`` [m] along a push on ``face`` before it turns by ``turn`` [rad].

    It is the share of samples that do, of ``poses`` as in `Outcomes`, which begin at ``start``. A sample that diverges
    comes no farther.
    """
    within = np.logical_and.accumulate(~(np.abs(se2.wrap(poses[..., 2] - start[2])) > turn), axis=-1)
    return np.asarray(((progress(poses, start, face) >= distance) & within).any(axis=-1).mean(axis=-1))


def median_parameters(estimated: ObjectEstimate) -> Float[Array, "p"]:
    """Median of each contact parameter among the particles that a push can move, or among all if it can move none."""
    moves = contact_model.resistance(estimated.parameters).min(axis=-1) < _STRONGEST
    weight = jnp.where(moves | ~moves.any(), estimated.log_weight, -jnp.inf)
    return estimate.quantiles(estimated._replace(log_weight=weight), estimated.parameters, (0.5,))[0]


class Foresight:
    """`reach` for the weights and settings of one pushing controller, compiled once for all objects and maps."""

    def __init__(self, weights: Weights, config: PushConfig) -> None:
        shape = weights.config.object
        # Over many seconds the contact model alone predicts better than psi, which is trained on three.
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
        """Outcomes of as many options as ever, by what was learned of the object or, untouched, by its looks."""
        estimated = self._prior(kind) if adapt is None else adapt
        key = jax.random.key(seed)
        body = {"pose": np.asarray(pose, np.float32), "half_extents": np.asarray(half_extents, np.float32)}
        return jax.tree.map(np.asarray, self._run(estimated, key, Options(*map(np.asarray, options)), **body))

    @single_precision
    def median_poses(
        self, adapt: Any, kind: str | None, half_extents: tuple[float, float], options: Options
    ) -> Float[np.ndarray, "O T 3"]:
        """Poses of an object that begins at the origin, for the middle of what is known of it.

        One roll-out of each option: a straight push of a symmetric object stays straight. Where ``adapt`` is no
        posterior of the contact parameters, the prior of what the object looks like takes its place.
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
        """Probability that a push straight on moves the object (`probability_to_come`)."""
        pose, face = np.asarray(pose, float), np.asarray(face, float)
        poses = self.sampled_poses(adapt, kind, pose, half_extents, face=face, goal=goal_ahead(pose, face))
        return float(probability_to_come(poses, pose, face, distance=distance, turn=turn))


def foresight_of(controller: Any) -> Any:
    """What foresees where a controller's pushes lead: its `Foresight`, or a method ``foresee`` of its own like it."""
    return _of(controller) if isinstance(controller, PushController) else controller.foresee


def contact_foresight(controller: Any, config: PushConfig) -> Foresight:
    """The `Foresight` of a controller whose psi has the contact model, or else that of the shipped weights with
    ``config``: what learns otherwise, or not at all, is given the same choice of pushes."""
    if isinstance(controller, PushController) and controller.weights.config.object.contact_model:
        return _of(controller)
    return _shipped(config)


@lru_cache(maxsize=4)
def _of(controller: PushController) -> Foresight:
    return Foresight(controller.weights, controller.config)


@lru_cache(maxsize=2)
def _shipped(config: PushConfig) -> Foresight:
    return Foresight(load_weights(), config)
