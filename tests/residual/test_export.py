"""Laws of the exports: what is carried is right, and the rest is said with its size."""

import re
from dataclasses import replace

import numpy as np
import pytest

from residual.calibration.correction_choice import MAIN
from residual.errors import InputError
from residual.export.c99 import to_c99
from residual.export.model_export import build_reference_motion, remove_tables, to_json
from residual.export.urdf_mjcf import to_mjcf, to_urdf
from residual.model.lookup import CorrectedModel, JointCorrection
from residual.model.model import Model
from tests.exports.models import NAMES, model_with, robot_of
from tests.residual.test_model_record import lookup

WRITERS = {"json": to_json, "urdf": to_urdf, "mjcf": to_mjcf, "c99": to_c99}
# What each target can say of one effect alone; all else must be listed.
JOINTS = {"drive_damping", "viscous", "coulomb"}
BODIES = {"payload", "link_body", "link_inertia"}
MUJOCO = {"rotor_inertia", "spring", "quadratic_viscous", "base_tilt"}
AHEAD = {"backlash", "elasticity"}  # they look ahead in time
CARRIED = {
    "json": set(NAMES),
    "urdf": JOINTS | BODIES,
    "mjcf": JOINTS | BODIES | MUJOCO,
    "c99": set(NAMES) - AHEAD,
}


@pytest.mark.parametrize("target", sorted(WRITERS))
@pytest.mark.parametrize("name", NAMES)
def test_a_target_carries_an_effect_or_lists_it_with_its_torque(target, name):
    source = model_with(robot_of("irb140"), "viscous", name)
    export = WRITERS[target](source)
    omissions = [each for each in export.omissions if each.name == name]
    kept = [t.effect.name for t in remove_tables(export.carried).terms]
    if name in CARRIED[target]:
        assert omissions == []
        assert name in kept
    else:
        (omission,) = omissions
        assert name not in kept
        motion = build_reference_motion(source.robot)
        gap = source.along(motion.t, motion.parts)
        gap = gap - source.without(name).along(motion.t, motion.parts)
        assert omission.largest == pytest.approx(np.abs(gap).max())
        assert 0 < omission.rms <= omission.largest
        assert export.largest == pytest.approx(omission.largest)
        assert str(omission).startswith(f"{name}")
        assert omission.why


def _corrected(robot) -> CorrectedModel:
    rng = np.random.default_rng(4)
    columns = (("qd", (0,), ""), ("q", (1,), ""))
    own = tuple(JointCorrection(j, columns, lookup(rng), MAIN) for j in (1, 2))
    return CorrectedModel(model_with(robot, "viscous", "torque_gain"), own)


@pytest.mark.parametrize("target", ["urdf", "mjcf"])
def test_tables_that_a_target_has_no_place_for_are_listed(target):
    export = WRITERS[target](_corrected(robot_of("seven")))
    (tables,) = (each for each in export.omissions if each.name == "tables")
    assert tables.joints == (2, 3)
    assert tables.largest > 0
    assert isinstance(export.carried, Model)


@pytest.mark.parametrize(
    ("write", "change", "message"),
    [
        (to_urdf, {20: -1.0}, r"Link 3 has mass -1 kg.*--consistent"),
        (to_mjcf, {20: -1.0}, r"Link 3 has mass -1 kg.*--consistent"),
        (to_mjcf, {24: 50.0}, r"Link 3 has principal inertias.*c99"),
    ],
)
def test_a_body_that_cannot_be_is_refused_with_what_to_do(write, change, message):
    source = model_with(robot_of("irb140"))
    wrong = source.inertial.copy()
    wrong[list(change)] = list(change.values())
    with pytest.raises(InputError, match=message):
        write(replace(source, inertial=wrong))


def test_a_strangers_name_makes_no_path_and_no_code():
    robot = replace(robot_of("irb140"), name='../x*/"""\nimport os')
    source = model_with(robot, "viscous")
    for write in WRITERS.values():
        export = write(source)
        assert all(re.fullmatch(r"[\w-]+\.(?:\w+)", name) for name in export.files)
        for name, content in export.files.items():
            if name.endswith(".h"):
                assert b"import os" not in content
