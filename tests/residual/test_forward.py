"""Torque in, motion out, against Pinocchio's own algorithm and an integrator of SciPy.

What is independent here: forward dynamics by the articulated-body algorithm with the
load welded to the flange and the rotors as armature, friction and spring by hand, and
Dormand and Prince's method of eighth order.
"""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from scipy.integrate import solve_ivp

from residual.effects import load_effects
from residual.model.dynamics import compute_acceleration, compute_model_mass_matrix
from residual.model.model import Model, Term
from residual.recording import Recording
from residual.robot.dynamics import find_flange_placement, read_inertial_parameters
from residual.robot.robot import load_robot
from residual.signals.track import StandstillFriction, build_tracks

ROBOT = load_robot("irb140")
MASS, LEVER = 2.0, np.array([0.05, 0.02, 0.08])  # of a load on the flange [kg, m]
OWN = np.diag([0.004, 0.005, 0.006])  # about its own centre [kg m^2]
COULOMB = np.array([4.0, 4.0, 3.0, 1.0, 1.0, 0.5])
VISCOUS = np.array([3.0, 3.0, 2.0, 0.5, 0.5, 0.2])
ROTOR = np.array([3.4, 3.4, 1.15, 0.13, 0.13, 0.05])
STIFF, RUB, WIDTH = 40.0, 0.03, 0.05  # N m/rad, 1, rad/s
AMPLITUDE, OMEGA = np.array([9.0, 8, 5, 1.5, 1.2, 0.6]), np.array([5, 6, 7, 8, 9, 10.0])


def term(name, joint, *values):
    effect = load_effects()[name]
    theta, shape = effect.from_values(np.array(values), ROBOT)
    joints = (joint,) if joint is not None else ()
    return Term(effect, joints, tuple(shape), np.asarray(theta, float))


def load():
    body = find_flange_placement(ROBOT.model).act(pin.Inertia(MASS, LEVER, OWN))
    return Term(load_effects()["payload"], (5,), (), body.toDynamicParameters())


def model(*more):
    terms = [
        term(name, j, values[j])
        for name, values in (("coulomb", COULOMB), ("viscous", VISCOUS), ("rotor_inertia", ROTOR))
        for j in range(6)
    ]
    terms += [load(), term("spring", 2, STIFF, 0.0), *more]
    shapes = (StandstillFriction("smooth", 1.0),) * 6
    floor = np.full(6, WIDTH)
    return Model(ROBOT, read_inertial_parameters(ROBOT.model), tuple(terms), floor, shapes)


def drive(t, q, qd):
    hold = pin.computeGeneralizedGravity(ROBOT.model, ROBOT.model.createData(), q)
    return hold + AMPLITUDE * np.sin(OMEGA * t) - 20.0 * qd


def welded():
    arm = pin.Model(ROBOT.model)
    arm.appendBodyToJoint(6, pin.Inertia(MASS, LEVER, OWN), find_flange_placement(ROBOT.model))
    arm.armature = ROTOR
    return arm


def rate(arm, data, rubs):
    def of(t, x):
        q, qd = x[:6], x[6:]
        turn = np.tanh(qd / WIDTH)
        torque = drive(t, q, qd) - COULOMB * turn - VISCOUS * qd
        torque[2] -= STIFF * q[2]
        qdd = pin.aba(arm, data, q, qd, torque)
        if rubs:
            # Load friction turns with the acceleration that it makes: to a fixed point.
            bare = pin.Model(arm)
            bare.armature = np.zeros(6)
            for _ in range(25):
                load = np.abs(pin.rnea(bare, bare.createData(), q, qd, qdd)[1])
                less = torque.copy()
                less[1] -= RUB * load * turn[1]
                qdd = pin.aba(arm, data, q, qd, less)
        return np.concatenate([qd, qdd])

    return of


def integrated(t):
    arm = welded()
    start = np.concatenate([[0.2, 0.4, 0.3, 0.1, 0.6, 0.0], np.zeros(6)])
    done = solve_ivp(
        rate(arm, arm.createData(), False), (t[0], t[-1]), start, "DOP853", t, rtol=1e-9, atol=1e-10
    )
    return done.y[:6].T, done.y[6:].T


@pytest.mark.parametrize("rubs", [False, True])
def test_the_acceleration_of_a_torque_is_that_of_an_independent_integration(rubs):
    t = np.arange(150) / 500
    q, qd = integrated(t)
    arm, tau = welded(), np.array([drive(*x) for x in zip(t, q, qd, strict=True)])
    of = rate(arm, arm.createData(), rubs)
    wanted = np.array([of(*x)[6:] for x in zip(t, np.hstack([q, qd]), strict=True)])
    whole = model(*((term("load_friction", 1, RUB),) if rubs else ()))
    # |rigid| of this effect is of the arm without its load: so is it given here.
    if rubs:
        bare = whole.inertial.copy()
        bare[-10:] += load().theta
        kept = tuple(x for x in whole.terms if x.effect.name != "payload")
        whole = replace(whole, inertial=bare, terms=kept)
    (track,), _ = build_tracks([Recording("", "irb140", t, q, tau)], whole.filters, None, True)
    rows = [np.abs(t - each).argmin() for each in track.t]
    track = replace(track, q=q[rows], qd=qd[rows], qdd=0 * q[rows])
    got = compute_acceleration(whole, track, tau[rows])
    assert np.abs(wanted).max() > 1.0
    np.testing.assert_allclose(got, wanted[rows], atol=1e-6)


def test_the_mass_matrix_has_the_load_and_the_rotors():
    q = np.random.default_rng(0).uniform(-1, 1, (20, 6))
    arm = welded()
    got = compute_model_mass_matrix(model(), q)
    for each, pose in zip(got, q, strict=True):
        upper = np.triu(pin.crba(arm, arm.createData(), pose))
        np.testing.assert_allclose(each, upper + np.triu(upper, 1).T, atol=1e-9)
