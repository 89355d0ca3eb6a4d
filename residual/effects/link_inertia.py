"""A link whose mass differs from the model, with centre and inertia in proportion."""

import numpy as np

from residual.effects.base import Effect, EffectTrait, ExportedLaw

# Limit relative to the body in the model: more is an additional body, and a flange nine
# times as heavy is a load.
MOST_LOAD = 10.0  # times the link of a single joint, which includes its load
MOST = 1.0


def _bodies_of(robot):
    from residual.robot.dynamics import read_inertial_parameters

    return read_inertial_parameters(robot.model)


def _columns(state, joints, shape):
    (link,) = joints
    own = slice(10 * link, 10 * link + 10)
    body = _bodies_of(state.robot)[own]
    return (state.regressor[:, :, own] @ body)[:, :, None]


def _bodies(theta, joints, robot):
    body = _bodies_of(robot).reshape(-1, 10)
    scale = np.zeros((robot.dof, 1))
    scale[list(joints)] = theta[0]
    return (scale * body).ravel()


def _possible(theta, shape, limits):
    """No mass is negative; the load of a single joint may have any mass."""
    if not limits.load_mass_seen:
        return bool(abs(theta[0]) < MOST_LOAD)
    return bool(-1 < theta[0] < MOST)


EFFECT = Effect(
    name="link_inertia",
    noun="the inertia",
    place="of {links}",
    sentence="a link that is heavier or lighter than in the model",
    equation=("tau = scale * (torque that the link's mass, centre and inertia need in the model)"),
    parameters={"scale": "1"},
    columns=_columns,
    scope="link",
    traits=EffectTrait.PARAMETER | EffectTrait.IN_EVERY_MODEL | EffectTrait.BODY,
    # The link of an arm of one joint is its load.
    prior_sd=lambda robot: np.array([0.3 if robot.dof > 1 else 1.0]),
    possible=_possible,
    variable=None,
    portable=ExportedLaw(bodies=_bodies),
    display=lambda values: {"mass and inertia": (100 * float(values[0]), "%")},
)
