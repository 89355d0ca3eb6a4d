"""Arms to plan for, as URDF text."""

from residual.robot.robot import load_robot


def _link(name, mass, inertia, centre):
    x, y, z = centre
    return (
        f'<link name="{name}"><inertial><origin xyz="{x} {y} {z}"/>'
        f'<mass value="{mass}"/><inertia ixx="{inertia}" iyy="{inertia}" '
        f'izz="{inertia / 2}" ixy="0" ixz="0" iyz="0"/></inertial></link>'
    )


def _joint(number, parent, child, place, axis, effort):
    return (
        f'<joint name="j{number}" type="revolute"><parent link="{parent}"/>'
        f'<child link="{child}"/><origin xyz="{place}"/><axis xyz="{axis}"/>'
        f'<limit lower="-2.8" upper="2.8" velocity="2.5" effort="{effort}"/></joint>'
    )


def urdf(name, places, axes, masses, efforts):
    text, parent = f'<robot name="{name}"><link name="l0"/>', "l0"
    for i, place in enumerate(places, start=1):
        mass = masses[i - 1]
        text += _link(f"l{i}", mass, 0.02 * mass, (0.01, 0.02, 0.1))
        text += _joint(i, parent, f"l{i}", place, axes[i - 1], efforts[i - 1])
        parent = f"l{i}"
    text += f'<link name="tip"/><joint name="end" type="fixed"><parent link="{parent}"/>'
    return text + '<child link="tip"/><origin xyz="0 0 0.1"/></joint></robot>'


Z, Y = "0 0 1", "0 1 0"
MASSES = [6, 3, 2, 1.5, 1.2, 1, 0.8]
SEVEN = urdf("seven", ["0 0 0.2"] * 7, [Z, Y, Z, Y, Z, Y, Z], MASSES, [80] * 7)
# A pendulum of two links: a first axis that is level, so no floor is known.
TWO = urdf("two", ["0 0 0.3", "0 0 0.4"], [Y, Y], [3, 2], [60, 40])
# At zero it lies along the floor, a hand above it.
FLAT = urdf(
    "flat",
    ["0 0 0.1", "0 0.1 0", "0.4 -0.1 0", "0.4 0 0", "0 0.1 0", "0.1 0 0"],
    [Z, Y, Y, Y, Z, Y],
    [8, 8, 3, 1.3, 1.2, 0.3],
    [150, 150, 150, 28, 28, 28],
)


def arm(text, folder):
    path = folder / "arm.urdf"
    path.write_text(text)
    return load_robot(path)
