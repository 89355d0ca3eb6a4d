"""Logs that something else explains: flaws of the file, balanced arms, zeros, gains."""

import xml.etree.ElementTree as ET

import numpy as np

from benchmarks.check_parts.arms import FaultyLogs, Host, changed, some, tables_of
from residual.robot.dynamics import compute_gravity_torque, compute_inverse_dynamics
from residual.robot.robot import build_robot

Rng = np.random.Generator
_SHOWS = 0.05  # of the torque of some joint: less of a flaw says nothing
_TRIES = 60


def placeholder(host: Host, size: int, rng: Rng) -> FaultyLogs | None:
    """One to three links have an inertia of 0.1 to 1 kg m^2, or one that cannot be."""
    for _ in range(_TRIES):
        links = some(rng, host.robot.dof, size + 1)
        root = ET.fromstring(host.robot.urdf)
        moving = [j.find("child").get("link") for j in root if _moves(j)]
        for link in root.iter("link"):
            tensor = link.find("inertial/inertia")
            if tensor is None or link.get("name") not in moving:
                continue
            if moving.index(link.get("name")) + 1 in links:
                value = 10 ** rng.uniform(-1, 0)
                if rng.random() < 0.5:
                    tensor.attrib |= dict.fromkeys(("ixx", "iyy", "izz"), str(value))
                else:
                    tensor.set("izz", str(value))
        urdf = ET.tostring(root, encoding="unicode")
        if _differs(host, urdf):
            tables = tables_of(host)
            return FaultyLogs("robot_file", links, tables, tables, urdf=urdf)
    return None


def _moves(element: ET.Element) -> bool:
    return element.tag == "joint" and element.get("type") != "fixed"


def _differs(host: Host, urdf: str) -> bool:
    """Whether another file moves the torque of some joint."""
    other = build_robot(host.robot.name, urdf, host.robot.toml)
    log = host.logs[0]
    q, t = log.q[::5], log.t[::5]
    qd = np.gradient(q, t, axis=0)
    motion = q, qd, np.gradient(qd, t, axis=0)
    was, now = (compute_inverse_dynamics(r.model, *motion) for r in (host.robot, other))
    rms = np.sqrt(np.mean((was - now) ** 2, axis=0))
    return bool(np.any(rms > _SHOWS * np.sqrt(np.mean(was**2, axis=0))))


def masses(host: Host, size: int, rng: Rng) -> FaultyLogs:
    """All masses of the file are 0.24 to 0.45, 0.6 to 1.7, or 2.2 to 4 times right."""
    factor = rng.uniform(*((0.24, 0.45), (0.6, 1.7), (2.2, 4.0))[size])
    root = ET.fromstring(host.robot.urdf)
    for element in (*root.iter("mass"), *root.iter("inertia")):
        for key, value in element.attrib.items():
            element.set(key, repr(factor * float(value)))
    urdf, tables = ET.tostring(root, encoding="unicode"), tables_of(host)
    return FaultyLogs("torque_unit", (), tables, (), urdf=urdf)


def balanced(host: Host, size: int, rng: Rng) -> FaultyLogs:
    """Counterweights or springs carry 60 to 100 % of one joint, two, or all of them."""
    model, dof = host.robot.model, host.robot.dof
    share = np.zeros(dof)
    joints = some(rng, dof, (1, 2, dof)[size])
    share[[j - 1 for j in joints]] = rng.uniform(0.6, 1.0, len(joints))

    def carry(table: dict) -> dict:
        weight = compute_gravity_torque(model, table["q"], model.gravity.linear)
        return table | {"tau": table["tau"] - share * weight}

    tables = [carry(table) for table in tables_of(host)]
    return FaultyLogs("gravity_removed", (), tables)


def zero(host: Host, size: int, rng: Rng) -> FaultyLogs | None:
    """The zero of one joint is 90, -90 or 180 degrees off, where that shows."""
    turn, right = (np.pi / 2, -np.pi / 2, np.pi)[size], tables_of(host)
    for _ in range(_TRIES):
        (joint,) = some(rng, host.robot.dof, 1)
        off = np.where(np.arange(host.robot.dof) == joint - 1, turn, 0.0)
        if _turns(host, off):
            tables = changed(right, ("q",), lambda q: q + off)  # noqa: B023
            return FaultyLogs("angle_zero", (joint,), tables, right)
    return None


def _turns(host: Host, off: np.ndarray) -> bool:
    log = host.logs[0]
    q, model = log.q[::5], host.robot.model
    down = model.gravity.linear
    was, now = (compute_gravity_torque(model, x, down) for x in (q, q + off))
    rms = np.sqrt(np.mean((was - now) ** 2, axis=0))
    return bool(np.any(rms > 0.25 * np.std(log.tau[::5], axis=0)))


def gain(host: Host, size: int, rng: Rng) -> FaultyLogs:
    """Torques of one to three joints are 0.25 to 4 times what they are."""
    joints = some(rng, host.robot.dof, size + 1)
    factor = np.ones(host.robot.dof)
    each = np.exp(rng.uniform(np.log(1.8), np.log(4.0), len(joints)))
    factor[[j - 1 for j in joints]] = each ** rng.choice([-1, 1], len(joints))
    tables = changed(tables_of(host), ("tau",), lambda tau: tau * factor)
    return FaultyLogs("torque_scale", joints, tables, tables_of(host))


EXPLAINED = {f.__name__: f for f in (placeholder, masses, balanced, zero, gain)}
