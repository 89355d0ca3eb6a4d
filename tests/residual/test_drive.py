"""The drive of a joint: torque from goal and position."""

from dataclasses import replace

import numpy as np
import pytest

from residual.check.check import check_logs
from residual.diagnosis.candidates import build_candidates
from residual.diagnosis.diagnose import diagnose
from residual.drive import Drive, compute_drive_torque, limit_goal
from residual.effects.base import MotionSpan
from residual.evidence.design import Design
from residual.evidence.fit import build_fitted_model, fit_nominal
from residual.evidence.priors import build_relative_prior
from residual.identification.identify import identify
from residual.model.nominal import DEFAULT_DECLARED, build_free_nominal, prepare_fit_logs
from residual.recording import Recording, apply_drive
from residual.robot.dynamics import compute_inverse_dynamics, replace_inertial_parameters
from residual.signals.track import FilterSettings
from residual.verdict.diagnosis import add_motor_class
from residual.verdict.result import Place
from tests import plain_arm
from tests.residual.arms import arm, plain_logs
from tests.residual.driven import DAMPING, DRIVE, ONE, drive_log, pendulum

T = np.arange(0, 2, 0.01)
ROTOR = 2.0  # kg m^2
STEP = np.where(T < 0.5, 0.0, 1.0)[:, None]


def test_an_ideal_drive_is_a_spring_to_the_goal():
    tau, at_limit = compute_drive_torque(Drive(gain=(3.0,)), STEP, 0.25 * STEP, T)
    np.testing.assert_allclose(tau, 3.0 * 0.75 * STEP)
    assert not at_limit.any()


def test_a_goal_travels_at_its_speed_and_arrives_late():
    drive = Drive(goal_speed=(2.0,), delay=(0.1,))
    goal = limit_goal(drive, STEP, T)[:, 0]
    expected = np.clip(2.0 * (T - 0.49 - 0.1), 0, 1)  # it sets off a sample before
    np.testing.assert_allclose(goal, expected, atol=1e-9)


def test_a_drive_gives_its_limit_and_nothing_when_it_is_off():
    drive = Drive(gain=(3.0,), limit=(2.0,))
    tau, at_limit = compute_drive_torque(drive, STEP, 0 * STEP, T, T < 1)
    assert set(tau[T >= 0.5, 0]) == {2.0, 0.0}
    np.testing.assert_array_equal(at_limit[:, 0], (T >= 0.5) & (T < 1))


def noisy_logs(robot, gain: float) -> list[Recording]:
    """Return four logs of an arm with a rotor that its file lacks, and noisy angles."""
    t, out = np.arange(0, 20, 0.01), []
    speed, size = 2 * np.pi * np.array([0.2, 0.5, 0.9, 1.4]), [0.5, 0.2, 0.1, 0.05]
    for seed in range(4):
        rng = np.random.default_rng(seed)
        waves = size * np.exp(1j * (np.outer(t, speed) + rng.uniform(0, 6, 4)))
        turned = (waves * (1j * speed) ** k for k in range(3))
        q, qd, qdd = (x.sum(axis=1).imag[:, None] for x in turned)
        tau = compute_inverse_dynamics(robot.model, q, qd, qdd) + ROTOR * qdd
        read = q + 5e-4 * rng.normal(size=q.shape)
        log = Recording(f"log {seed}", robot.name, t, read, 0 * q, q_ref=q + tau / gain)
        out.append(apply_drive(log, Drive(gain=(gain,))))
    return out


def test_what_noise_of_the_angles_leaves_is_noise_whatever_the_file_lacks():
    robot, gain = pendulum(), 2000.0
    logs = prepare_fit_logs(robot, noisy_logs(robot, gain), None, FilterSettings())
    # A drive computes its torque by the angles: it moves with their noise.
    shaken, track = logs.shaken[0], logs.tracks[0]
    moved = -gain * track.filter(shaken.q - track.q)
    np.testing.assert_allclose(shaken.tau - track.tau, moved, atol=0.02 * np.ptp(moved))
    nominal = build_free_nominal(logs, ("rotor_inertia",))
    design = Design(logs.tracks, nominal.model, shaken=logs.shaken)
    prior = build_relative_prior(design, nominal, 0.001)
    first = build_fitted_model(nominal, fit_nominal(design, prior))
    design.set_torque_model(first)
    fitted = fit_nominal(design, prior)
    left = design.residual(0, fitted.ids, fitted.theta)
    assert fitted.sse[0] == pytest.approx(left @ left, rel=0.02)
    sd = np.sqrt(fitted.covariance()[-1, -1])
    assert fitted.theta[-1] == pytest.approx(ROTOR, abs=3 * sd)


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"gain": (0.0,)}, "gain must be a list of positive numbers"),
        ({"delay": (-0.1,)}, "delay must be a list of positive numbers"),
        ({"gain": (1.0, 2.0), "limit": (1.0,)}, "expected one per joint"),
    ],
)
def test_a_drive_refuses_values_that_none_has(values, words):
    with pytest.raises(ValueError, match=words):
        Drive(**values)


def test_damping_of_a_drive_that_is_off_in_a_part_is_named():
    fit = [apply_drive(drive_log(s, off=(4.0, 6.5)), DRIVE) for s in (3, 4)]
    test = [apply_drive(drive_log(5, off=(4.0, 6.5)), DRIVE)]
    verdict = diagnose(pendulum(), fit, held_out=test, declared=("coulomb",))
    first = verdict.effects[0]
    assert "drive_damping" in {first.name, *(e.name for e in first.equivalent)}
    size = first.parameters["coefficient"]
    assert size.value == pytest.approx(DAMPING, rel=0.1)


def test_another_gain_is_named_with_its_size_and_nothing_beside_it():
    other = replace(DRIVE, gain=(4 * DRIVE.gain[0],))
    before, after = (
        [apply_drive(drive_log(s, 8.0, drive=drive), DRIVE) for s in seeds]
        for drive, seeds in ((DRIVE, (1, 2)), (other, (3, 4)))
    )
    declared = ("viscous", "coulomb", "rotor_inertia")
    (named,) = diagnose(pendulum(), after, before, declared=declared).verdict.effects
    assert named.name == "torque_gain"
    assert not {"payload", "link_inertia"} & {e.name for e in named.equivalent}
    assert named.parameters["gain"].value == pytest.approx(1 / 4 - 1, rel=0.1)


@pytest.mark.parametrize("axes", [ONE, ("0 1 0", "0 1 0")], ids=["one", "two"])
def test_an_arm_of_few_joints_runs_through_check_and_identification(axes):
    robot = arm(axes, "[declared.viscous]\n[declared.coulomb]\n")
    logs = plain_arm.logs(robot, robot.model, "ab", 5)
    assert not check_logs(robot, logs).certain
    found = identify(robot, logs).model
    tau = compute_inverse_dynamics(robot.model, *(3 * [0.3 * np.ones((1, robot.dof))]))
    own = replace_inertial_parameters(robot.model, found.inertial)
    again = compute_inverse_dynamics(own, *(3 * [0.3 * np.ones((1, robot.dof))]))
    np.testing.assert_allclose(again, tau, rtol=0.05)


def test_logs_of_one_drive_have_one_name_for_gain_motor_and_friction():
    still = np.zeros(1)
    span = MotionSpan(still, still, 0.0, 8.0, one_drive=True)
    place, load = Place("viscous", (2,)), Place("payload", (2,))
    both = Place("drive_damping", (2,)), Place("torque_gain", (2,))
    assert add_motor_class(place, [both[1]], span) == (both[1], both[0])
    assert add_motor_class(load, [], span) == ()
    # Off in a part it splits its damping from friction; measured torque splits all.
    off = replace(span, switched=(True,))
    assert add_motor_class(place, [], off) == (both[1],)
    assert add_motor_class(place, [], replace(span, one_drive=False)) == ()


def test_where_a_drive_is_stated_a_delay_is_of_its_chain_and_no_effect():
    logs = prepare_fit_logs(
        arm(), plain_logs(arm(), [0, 1], [0.0, 0.0], count=2), None, FilterSettings()
    )
    nominal = build_free_nominal(logs, DEFAULT_DECLARED)
    design = Design(logs.tracks, nominal.model)
    names = [
        {g.effect.name for g in build_candidates(design, nominal, span, False).groups}
        for span in (logs.span, replace(logs.span, one_drive=True))
    ]
    assert names[0] - names[1] == {"delay"}
