"""A two-joint arm and its log, written as text files."""

import numpy as np
import pytest

from residual.robot.robot import load_robot

LINK = """
  <joint name="joint{i}" type="revolute">
    <parent link="link{parent}"/><child link="link{i}"/>
    <origin xyz="0 0 0.4"/><axis xyz="0 1 0"/>
    <limit lower="-2" upper="2" velocity="3" effort="50"/>
  </joint>
  <link name="link{i}"><inertial><mass value="2"/>
    <inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial>
  </link>"""


def chain(name, dof):
    """URDF of so many equal links, one on the other."""
    links = "".join(LINK.format(i=i, parent=i - 1) for i in range(1, dof + 1))
    return f'<robot name="{name}"><link name="link0"/>{links}</robot>'


URDF = chain("two_link", 2)
NAMES = ("t", "q1", "q2", "tau1", "tau2")


@pytest.fixture
def make_robot(tmp_path):
    def make(toml=""):
        folder = tmp_path / "arm"
        folder.mkdir(exist_ok=True)
        (folder / "arm.urdf").write_text(URDF)
        (folder / "robot.toml").write_text(toml)
        return load_robot(folder)

    return make


@pytest.fixture
def robot(make_robot):
    return make_robot()


@pytest.fixture
def samples():
    """Four seconds at 100 Hz: columns t, q1, q2, tau1, tau2."""
    rng = np.random.default_rng(5)
    t = np.arange(400) / 100
    q = np.column_stack([np.sin(2 * t), 0.5 * np.cos(3 * t)])
    return np.column_stack([t, q, rng.normal(size=(400, 2))])


@pytest.fixture
def write(tmp_path):
    def write(table, names=NAMES, name="run.csv", separator=","):
        lines = [separator.join(names)]
        lines += [separator.join(repr(float(x)) for x in row) for row in table]
        (tmp_path / name).write_text("\n".join(lines) + "\n")
        return str(tmp_path / name)

    return write
