"""Signs, orders and units that cannot be are found by the physics of the motion."""

import pytest

from residual.check.check import check_logs
from residual.check.result import Repair
from sim.draw import draw
from sim.records import stream
from tests.residual.arms import arm
from tests.residual.check.damaged import clean_logs, edited, swapped, times, turned

DAMAGES = {
    "torque of one joint": ({"tau": turned(2)}, "torque_sign", (2,)),
    "all torques": ({"tau": times(-1)}, "torque_sign", (1, 2, 3)),
    "angle": ({"q": turned(2)}, "angle_sign", (2,)),
    "two joints": ({"q": swapped(2, 3), "tau": swapped(2, 3)}, "joint_order", (2, 3)),
    "two torques": ({"tau": swapped(1, 2)}, "joint_order", (1, 2)),
    "two angles": ({"q": swapped(2, 3)}, "joint_order", (2, 3)),
    "N mm": ({"tau": times(1e3)}, "torque_unit", ()),
    "kN m": ({"tau": times(1e-3)}, "torque_unit", ()),
    "all angles": ({"q": times(-1)}, "angle_sign", (1, 2, 3)),
    "degrees": ({"q": times(57.29578)}, "angle_unit", ()),
}


@pytest.mark.parametrize("damage", DAMAGES)
def test_a_wrong_column_map_is_certain_and_has_its_name_and_joints(damage):
    changes, kind, joints = DAMAGES[damage]
    robot, logs = clean_logs("small")
    (fault,) = check_logs(robot, edited(logs, **changes)).faults
    assert (fault.kind, fault.joints, fault.certain) == (kind, joints, True)


def test_an_industrial_arm_is_judged_as_well():
    robot, logs = clean_logs("irb140")
    both = {"tau": swapped(2, 3), "q": swapped(2, 3)}
    for changes, kind, joints in (
        ({"tau": turned(2, 5)}, "torque_sign", (2, 5)),
        (both, "joint_order", (2, 3)),
    ):
        (fault,) = check_logs(robot, edited(logs, **changes)).faults
        assert (fault.kind, fault.joints, fault.certain) == (kind, joints, True)


def test_the_repair_is_what_undoes_the_damage():
    robot, logs = clean_logs("small")

    def cycled(x):
        return x[:, [1, 2, 0]]

    (fault,) = check_logs(robot, edited(logs, q=cycled, tau=cycled)).faults
    order = (3, 1, 2)
    assert fault.repairs == (Repair("q", order=order), Repair("tau", order=order))
    (fault,) = check_logs(robot, edited(logs, tau=times(1e3))).faults
    assert fault.repairs == (Repair("tau", scale=1e-3),)
    (fault,) = check_logs(robot, edited(logs, tau=turned(2))).faults
    assert fault.repairs == (Repair("tau", (2,), sign=(-1,)),)


@pytest.mark.parametrize("effect", ["payload", "base_tilt"])
def test_an_arm_that_hides_something_has_a_clean_log(effect):
    robot, _ = clean_logs("irb140")
    hidden = (draw(robot, effect, stream(1, effect)),)
    robot, logs = clean_logs("irb140", 4, hidden)
    assert check_logs(robot, logs).faults == ()


def test_an_arm_of_another_build_is_the_wrong_robot():
    _, logs = clean_logs("irb140")
    (fault,) = check_logs(arm(3 * ("0 1 0", "0 0 1")), logs).faults
    assert (fault.kind, fault.joints, fault.certain) == ("wrong_robot", (), True)
    assert fault.repairs == ()
