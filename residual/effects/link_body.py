"""A body on a link that the model lacks: a valve block, a dress pack."""

from residual.effects import _body
from residual.effects.base import Effect, EffectTrait, ExportedLaw


def _joint():
    """The frame in which it is stated: the axes of its link's joint."""
    import pinocchio as pin

    return pin.SE3.Identity()


EFFECT = Effect(
    name="link_body",
    noun="a body",
    place="on {links}",
    sentence="a body on a link that the model does not have",
    equation="tau = Y_link(q, qd, qdd) * (mass, mass * com, inertia about the joint)",
    parameters=_body.PARAMETERS,
    columns=_body.columns,
    scope="link",
    outermost=2,  # a body on the wrist is reported as a load
    values=lambda theta, shape, robot: _body.values_in(_joint(), theta),
    from_values=lambda values, robot: _body.theta_from(_joint(), values),
    traits=EffectTrait.PARAMETER | EffectTrait.IN_EVERY_MODEL | EffectTrait.BODY,
    prior_sd=_body.prior_sd,
    unit_directions=lambda states, joints: _body.usual_in(_joint()),
    reports=_body.is_parameter_reportable,
    variable=None,
    # Also negative: a body in the model that has been removed from the link.
    possible=lambda theta, shape, limits: _body.possible(theta, limits, -limits.weight),
    portable=ExportedLaw(bodies=_body.bodies),
    frame="in the axes of the joint that moves the link, from its origin",
)
