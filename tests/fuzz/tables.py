"""Readers of text: URDF, COLUMNS.toml, robot.toml, SPEC.toml and campaigns."""

from pathlib import Path

import numpy as np
import pinocchio as pin

from flows.specs import load_campaign, load_spec
from flows.steps.experiment import compute_run_id
from residual.effects import list_effect_parameters
from residual.robot.robot import Robot, build_robot, load_robot
from tests.fuzz.arm import arm, as_csv
from tests.fuzz.mutation import mutated
from tests.fuzz.reader import Reader
from tests.warehouse.conftest import URDF
from warehouse.logs import read_column_map, read_log
from warehouse.record_ids import ID_DIGITS

_MAPS = (
    """time = {column = "t", unit = "s", scale = 1.0}
q = {columns = ["q1", "q2"], unit = "rad", side = "link", sign = [1, -1]}
tau = {columns = ["tau1", "tau2"], unit = "A", scale = [1.0, 2.0]}
csv = {separator = ",", decimal = ".", skip = 0}
""",
)
_MAP_WORDS = tuple(
    b"time column unit scale q tau qd qdd q_ref columns side sign zero csv separator "
    b"decimal skip bag topic joints link motor deg ms us counts % rad/s^2".split()
)


def _read_map(data: bytes, place: Path) -> None:
    (place / "map.toml").write_bytes(data)
    (place / "log.csv").write_text(as_csv())
    columns = read_column_map(place / "map.toml")
    log, understood = read_log(str(place / "log.csv"), arm(), columns, despite_doubts=True)
    assert understood.text
    assert len(log.t) == understood.rows


_ROBOTS = (
    """[robot]
name = "two_link"
gravity = [0, 0, -9.81]
[joints]
gear_ratio = [50, -80.5]
torque_per_unit = [4.0, 3.5]
torque_limit = [50, 20]
velocity_limit = [3, 3]
acceleration_limit = [9, 9]
[couplings]
motor_from_joint = [[50, 0], [1.5, 80]]
[prior]
scale = 0.03
[declared.viscous]
coefficient = [1.5, 2]
assumed = true
source = "a guess"
[declared.coulomb]
""",
    'prior = {scale = "estimate"}\ndeclared = {rotor_inertia = {inertia = [1, 2]}}\n',
)
_ROBOT_WORDS = tuple(
    b"robot name gravity joints gear_ratio torque_per_unit torque_limit declared prior "
    b"velocity_limit couplings motor_from_joint scale estimate assumed source "
    b"viscous coulomb payload backlash mass".split()
)


def _read_robot(data: bytes, place: Path) -> None:
    (place / "arm.urdf").write_text(URDF)
    (place / "robot.toml").write_bytes(data)
    check_robot(load_robot(place, list_effect_parameters()))


def check_robot(robot: Robot) -> None:
    """Assert that what is kept of a robot makes the same one, and that it can move."""
    again = build_robot(robot.name, robot.urdf, robot.toml)
    assert again.content_hash == robot.content_hash
    assert robot.name
    assert (robot.lower < robot.upper).all()
    still = np.zeros(robot.dof)
    inertia = pin.crba(robot.model, robot.model.createData(), still)
    assert np.isfinite(inertia).all(), "the mass matrix is not finite"


_SPECS = (
    """schema = 1
robot = "irb140"
seed = 7
start = 0.5
[trajectory]
kind = "cyclic"
duration = 4.0
periods = 2
seed = 3
[plant]
scatter = 0.02
salt = "s"
background = "workshop"
worked_before = 60.0
noise = {torque = 0.015, encoder = 1e-4}
[[plant.effect]]
name = "payload"
mass = 0.5
onset = 1.0
[rates]
control = 1000.0
log = 250.0
""",
    'plant = {effect = [{name = "viscous", joints = [1], coefficient = 1}]}\n',
)
_GRIDS = (
    "schema = 1\nseed = 7\n[trajectory]\nduration = 4.0\n[[plant.effect]]\n"
    'name = "coulomb"\njoints = [1]\n'
    "[grid]\nseed = [1, 2]\ntrajectory.kind = ['cyclic', 'welding']\n"
    "plant.effect.1.level = [0.1, 0.2]\n",
    "seed = 7\n[random]\ncount = 3\ntrajectory.duration = {low = 2, high = 9}\n"
    "plant.scatter = {low = 0.01, high = 0.1, log = true}\nrobot = ['irb140']\n",
)
_SPEC_WORDS = tuple(
    b"schema robot seed start trajectory kind duration periods plant effect name "
    b"joints level onset scatter noise torque encoder rates control log salt "
    b"background grid random "
    b"count low high cyclic welding clean worn 10000 10001".split()
)


def _read_spec(data: bytes, place: Path) -> None:
    (place / "spec.toml").write_bytes(data)
    spec = load_spec(place / "spec.toml")
    assert spec.reference().duration > 0
    assert spec.log_rates().log <= spec.log_rates().control
    assert len(compute_run_id(spec)) == ID_DIGITS


def _read_campaign(data: bytes, place: Path) -> None:
    (place / "campaign.toml").write_bytes(data)
    entries = load_campaign(place / "campaign.toml")
    assert entries
    for entry in entries[:3]:
        assert len(compute_run_id(entry.spec)) == ID_DIGITS


_CONTINUOUS = URDF.replace("revolute", "continuous").replace(
    '<limit lower="-2" upper="2" velocity="3" effort="50"/>', ""
)
_TOOL = URDF.replace(
    "</robot>",
    '<joint name="tool" type="fixed"><parent link="link2"/><child link="flange"/>'
    '<origin xyz="0 0 0.1" rpy="0 1.57 0"/></joint>'
    '<link name="flange"><visual><geometry><box size="1 1 1"/></geometry></visual>'
    "</link></robot>",
)
_URDF_WORDS = tuple(
    b"robot link joint parent child origin axis limit inertial mass inertia revolute "
    b"continuous fixed prismatic mimic link0 link1 link2 joint1 lower upper xyz rpy "
    b"value ixx ixy name type <!-- --> <![CDATA[ ]]> <?xml <!DOCTYPE xacro: /> "
    b"</".split()
)


def _read_urdf(data: bytes, place: Path) -> None:
    (place / "arm.urdf").write_bytes(data)
    check_robot(load_robot(place / "arm.urdf"))


def _reader(name: str, texts: tuple[str, ...], words: tuple, read) -> Reader:
    seeds = [text.encode() for text in texts]
    return Reader(name, lambda: mutated(seeds, words), lambda: seeds, read)


TABLES = (
    _reader("map", _MAPS, _MAP_WORDS, _read_map),
    _reader("urdf", (URDF, _CONTINUOUS, _TOOL), _URDF_WORDS, _read_urdf),
    _reader("robot", _ROBOTS, _ROBOT_WORDS, _read_robot),
    _reader("spec", _SPECS, _SPEC_WORDS, _read_spec),
    _reader("campaign", _GRIDS, _SPEC_WORDS, _read_campaign),
)
