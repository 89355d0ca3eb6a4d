"""Robot files of installed packages: are they read, and read right?

A file is read if it is an arm or names its arms, one of which is then taken; files that
are no arm must be refused with an InputError. It is right if the torque at random
states equals that of Pinocchio's own reading of the file, of the same joints, with the
others at zero, or where the robot is locked if its limits exclude zero. Arms with a body
that cannot exist, which is repaired, are counted apart.
"""

import sys
from pathlib import Path

import numpy as np
import pinocchio as pin

from benchmarks.harness.figures import Figures, figure, missing
from benchmarks.harness.rates import at_least, share
from modelgap import load_robot
from residual.errors import InputError
from residual.robot.robot import Robot

# Where their robots are, below a directory that Python or Pinocchio is installed in.
PACKAGES = {
    "pybullet_data": "pybullet_data",
    "example_robot_data": "share/example-robot-data/robots",
    "rtb_data": "rtbdata",
}
_STATES, _CLOSE = 20, 1e-6  # share of the largest torque


def figures(quick: bool) -> Figures:
    """Return for each package the share of arms that are right, and the crashes."""
    out: Figures = {}
    for package, folder in PACKAGES.items():
        places = [Path(p, *at) for p in sys.path for at in ((), ("cmeel.prefix",))]
        roots = (place / folder for place in (*places, *Path(pin.__file__).parents))
        root = next((r for r in roots if r.is_dir()), None)
        if root is None:
            why = f"{package} is not installed"
            out[f"files_{package}_right"] = missing(1.0, why)
            continue
        arms, right, repaired, refused, crashes = 0, 0, 0, 0, []
        for path in sorted(root.rglob("*.urdf"))[:: 5 if quick else 1]:
            try:
                robot = _load(path)
                if not robot.dof:
                    raise InputError("no joints")
                if any(flaw.kind == "impossible" for flaw in robot.flaws):
                    repaired += 1
                    continue
                arms += 1
                ok = _is_right(path, robot)
                right += ok
                if not ok:
                    print(f"other torque: {path.relative_to(root)}")
            except InputError:
                refused += 1
            except Exception as error:
                crashes.append(f"{path.name}: {error}")
        entry = share(right, arms, repaired=repaired, refused=refused)
        out[f"files_{package}_right"] = at_least(entry, 1.0)
        count = arms + repaired + refused + len(crashes)
        out[f"files_{package}_crashes"] = figure(len(crashes), 0, count, which=crashes)
    return out


def _load(path: Path) -> Robot:
    """Load an arm; of several chains the first that the message names."""
    try:
        return load_robot(path)
    except InputError as error:
        parts = str(error).split("--tip ")
        if len(parts) < 3:
            raise
        return load_robot(path, tip=parts[2].split(":")[0])


def _is_right(path: Path, robot: Robot) -> bool:
    whole = pin.buildModelFromUrdf(str(path))
    names = list(robot.model.names)[1:]
    if not all(whole.existJointName(name) for name in names):
        return False
    places = [whole.joints[whole.getJointId(name)].idx_v for name in names]
    rest = pin.neutral(whole)
    for name, angle in robot.locked.items():
        joint = whole.joints[whole.getJointId(name)]
        if joint.nq == 1:  # continuous joints rest at zero
            rest[joint.idx_q] = angle
    data, other = whole.createData(), robot.model.createData()
    whole.gravity = robot.model.gravity
    rng, worst, largest = np.random.default_rng(0), 0, 0
    for _ in range(_STATES):
        state = rng.uniform(-1, 1, (3, robot.dof))
        full = np.zeros((3, whole.nv))
        full[:, places] = state
        ours = pin.rnea(robot.model, other, *state)
        # From rest, since continuous joints are cosine and sine.
        peer = pin.rnea(whole, data, pin.integrate(whole, rest, full[0]), *full[1:])[places]
        worst = max(worst, float(np.abs(ours - peer).max()))
        largest = max(largest, float(np.abs(peer).max()))
    return worst <= _CLOSE * max(largest, 1e-9)
