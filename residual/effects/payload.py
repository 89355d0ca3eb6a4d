"""A load on the flange that is missing or wrong in the model."""

from residual.effects import _body
from residual.effects.base import Effect, EffectTrait, ExportedLaw


def _flange(robot):
    from residual.robot.dynamics import find_flange_placement

    return find_flange_placement(robot.model)


def _combined(theta, robot):
    """First moments about the last joint, which slow motion determines by gravity."""
    return {
        f"mass * centre_{axis} about the last joint": (float(theta[1 + i]), "kg m")
        for i, axis in enumerate("xyz")
    }


EFFECT = Effect(
    name="payload",
    noun="a payload",
    place="at the flange",
    sentence="a load on the flange that the model does not have",
    equation=("tau = Y_flange(q, qd, qdd) * (mass, mass * com, inertia about the flange)"),
    parameters=_body.PARAMETERS,
    columns=_body.columns,
    scope="flange",
    values=lambda theta, shape, robot: _body.values_in(_flange(robot), theta),
    from_values=lambda values, robot: _body.theta_from(_flange(robot), values),
    traits=EffectTrait.PARAMETER | EffectTrait.BODY,
    carries="body",
    prior_sd=_body.prior_sd,
    combined=_combined,
    unit_directions=lambda states, joints: _body.usual_in(_flange(states[0].robot)),
    reports=_body.is_parameter_reportable,
    variable=None,
    # No heavier than the arm, no lighter than the model's load removed, within reach.
    possible=lambda theta, shape, limits: _body.possible(
        theta, limits, -limits.nominal_coefficients[0] if len(limits.nominal_coefficients) else 0.0
    ),
    portable=ExportedLaw(bodies=_body.bodies),
    frame="in the axes of {flange}, from its origin; inertia about the centre",
)
