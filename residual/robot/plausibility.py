"""Bodies of a robot file: implausible ones, and compensated weight.

A tensor of positive mass has a covariance S = tr(I) / 2 - I that is positive: no moment
exceeds the sum of the two others. Its radius of gyration lies between that of a ball of
the heaviest metal and about half of the length of the link. A tensor shared by several
links of different mass, or that of a ball with one digit, was typed in, not computed.
"""

import xml.etree.ElementTree as ET
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from residual.errors import join_with_commas
from residual.recording import Array
from residual.robot.files import find_prismatic_joints
from residual.robot.urdf import GRAVCOMP

LIGHTEST, HEAVIEST = 300.0, 20_000.0  # kg/m^3 of a ball of the size of a link
WIDEST = 0.8  # radius of gyration over the link's length; a dumbbell's is 0.5
WIDEST_BALL = 0.5  # the same of three equal moments; a hollow ball's is 0.41
FARTHEST = 2.0  # a centre's distance from the link's joints over its length
HEAVIEST_LINK = 0.9  # of the moving mass, with three links or more
BODY_REMEDY = (
    "These moments are left open in a fit, and a body that cannot exist is taken as "
    "the nearest that can. Give the real ones in the robot file."
)
SLACK = 0.005  # of the largest moment: rounding of an exact plate
THIN = 0.02  # of the largest eigenvalue of S: limit for a repaired body
# Of the inertia at its joint: smaller moments are ignored.
SHARE, IMPOSSIBLE_SHARE = 0.01, 1e-4
_KEYS = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")


@dataclass(frozen=True, eq=False, slots=True)
class BodyFlaw:
    """A flaw of the body of one link of a robot file."""

    link: str  # its name in the file
    joint: int  # that moves it, from 1
    # "impossible" (no mass has such moments), "spread" or "dense" (too large or small
    # for its mass and length), "placeholder", "centre", "mass"
    kind: str
    words: str  # what is given, and what was expected
    # Deviation that the ten parameters of the joint's body are left with [SI]; zero
    # where they are not in doubt. Shape (10,).
    doubt: Array


@dataclass(frozen=True, eq=False, slots=True)
class LinkBody:
    """The body of one link from its file, in the axes of its joint."""

    link: str
    joint: int  # that moves it, from 1
    mass: float  # [kg]
    centre: Array  # from the joint's origin [m], (3,)
    tensor: Array  # about the centre [kg m^2], (3, 3)
    entries: tuple[float, ...]  # moments and products as they stand in the file
    length: float  # of the link, as its joints, centre and mass show it [m]
    away: float  # of the centre from the line through its joints [m]

    @property
    def moments(self) -> Array:
        """Principal moments, increasing [kg m^2]. Shape (3,)."""
        return np.linalg.eigvalsh(self.tensor)

    @property
    def radius(self) -> float:
        """Largest radius of gyration about the centre [m]."""
        return float(np.sqrt(max(self.moments[2], 0.0) / max(self.mass, 1e-12)))


def read_link_bodies(model: pin.Model, urdf: str) -> tuple[LinkBody, ...]:
    """Return the bodies with a mass or a tensor that a joint of the arm moves.

    Args:
        model: The Pinocchio model of the URDF.
        urdf: Its text, joints outside of the arm fixed.
    """
    root, out = ET.fromstring(urdf), []
    ends: dict[str, list[Array]] = {}
    for joint in root.findall("joint"):
        parent = joint.find("parent").get("link", "")
        ends.setdefault(parent, []).append(_vector(joint.find("origin"), "xyz"))
    for link in root.findall("link"):
        name, node = link.get("name", ""), link.find("inertial")
        if node is None:
            continue
        frame = model.frames[model.getFrameId(name, pin.FrameType.BODY)]
        if frame.parentJoint == 0:
            continue
        mass, tensor = node.find("mass"), node.find("inertia")
        mass = 0.0 if mass is None else float(mass.get("value", "0"))
        given = tuple(0.0 if tensor is None else float(tensor.get(key, "0")) for key in _KEYS)
        if not mass and not any(given):
            continue
        origin = node.find("origin")
        turned = frame.placement.rotation @ pin.rpy.rpyToMatrix(_vector(origin, "rpy"))
        centre = _vector(origin, "xyz")
        sizes = [float(np.linalg.norm(end)) for end in ends.get(name, [])]
        length = max(*sizes, _ball(mass, LIGHTEST), 0.0)
        at = []  # distances from the lines from the origin to each end
        for end in (np.zeros(3), *ends.get(name, [])):
            along = float(np.clip(centre @ end / max(end @ end, 1e-12), 0.0, 1.0))
            at.append(float(np.linalg.norm(centre - along * end)))
        xx, yy, zz, xy, xz, yz = given
        own = turned @ np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]) @ turned.T
        out.append(
            LinkBody(
                name,
                int(frame.parentJoint),
                mass,
                frame.placement.act(centre),
                own,
                given,
                max(length, 2 * float(np.linalg.norm(centre))),
                min(at) / max(length, 1e-9),
            )
        )
    return tuple(out)


def find_body_flaws(model: pin.Model, bodies: Sequence[LinkBody]) -> tuple[BodyFlaw, ...]:
    """Return the flaws of the bodies of an arm, at most one for each link."""
    felt = _felt_inertias(model, bodies)
    moving = sum(body.mass for body in bodies)
    out = []
    for body in bodies:
        kind, words = _judge(body, bodies, moving)
        share = abs(body.moments).max()
        if kind in ("dense", "mass", "centre"):  # the flaw is the missing part
            share = max(share, body.mass * body.length**2)
        least = IMPOSSIBLE_SHARE if kind == "impossible" else SHARE
        if kind and share >= least * felt[body.joint - 1]:
            out.append(BodyFlaw(body.link, body.joint, kind, words, _doubt(body, kind)))
    return tuple(out)


def describe_body_flaws(flaws: Sequence[BodyFlaw]) -> list[str]:
    """Return the flaws in words, links with the same flaw together."""
    links: dict[str, list[str]] = {}
    for flaw in flaws:
        links.setdefault(flaw.words, []).append(f"'{flaw.link}'")
    return [
        f"Link{'s' * (len(names) > 1)} {join_with_commas(names)}: {words}"
        for words, names in links.items()
    ]


def repair_impossible_bodies(
    model: pin.Model, bodies: Sequence[LinkBody], flaws: Sequence[BodyFlaw]
) -> pin.Model:
    """Return the model with impossible tensors replaced by the nearest possible ones."""
    links = {flaw.link for flaw in flaws if flaw.kind == "impossible"}
    if not links:
        return model
    model = pin.Model(model)
    for body in (body for body in bodies if body.link in links):
        whole = model.inertias[body.joint]
        # The mass stays, so the change of the tensor is the same about any point.
        tensor = whole.inertia + _nearest(body) - body.tensor
        model.inertias[body.joint] = pin.Inertia(whole.mass, whole.lever, tensor)
    return model


def _judge(body: LinkBody, bodies: Sequence[LinkBody], moving: float) -> tuple[str, str]:
    """Kind and description of the worst flaw of a body; "" for none."""
    least, middle, most = body.moments
    given = _words(body)
    if not body.mass:
        return "impossible", f"{given} without a mass: expected both or neither"
    if least < -SLACK * max(most, -least):
        return "impossible", f"{given} has the moment {least:.3g} kg m^2, expected >= 0"
    if least + middle < (1 - SLACK) * most:
        words = f"{most:.3g} exceeds {least:.3g} + {middle:.3g}, the two others"
        return "impossible", f"{given}: the moment {words}, which no body has"
    if len(bodies) > 2 and body.mass > HEAVIEST_LINK * moving:
        words = f"{body.mass:.4g} kg of the {moving:.4g} kg that move"
        return "mass", f"{words}: expected less than {HEAVIEST_LINK:.0%} on one link"
    if body.away > FARTHEST:
        away = body.away * body.length
        return "centre", (
            f"its centre lies {np.linalg.norm(body.centre):.3g} m from its joint: "
            f"{away:.3g} m off a link of {body.length:.3g} m"
        )
    if not most:
        return "", ""  # a deliberate point mass, which the reader reports
    ball = most - least <= 1e-6 * most
    widest = (WIDEST_BALL if ball else WIDEST) * body.length
    if body.radius > widest:
        return "spread", (
            f"{given} on {body.mass:.4g} kg: radius of gyration {body.radius:.3g} m, "
            f"expected at most {widest:.2g} m on a link of {body.length:.2g} m"
        )
    alike = [
        other.link
        for other in bodies
        if other.joint != body.joint
        and other.entries == body.entries
        and abs(other.mass - body.mass) > 0.01 * body.mass
    ]
    if alike:
        words = f"{given} on links of different mass"
        return "placeholder", f"{words}: a placeholder"
    if ball and f"{most:.3e}"[1:5] == ".000":
        return "placeholder", f"{given}, a ball's with one digit: a placeholder"
    densest = np.sqrt(0.1) * _ball(body.mass, HEAVIEST)
    if body.radius < densest:
        return "dense", (
            f"{given} on {body.mass:.4g} kg: radius of gyration {body.radius:.2g} m, "
            f"expected at least {densest:.2g} m, that of a ball of gold"
        )
    return "", ""


def _doubt(body: LinkBody, kind: str) -> Array:
    """Deviation of the ten parameters of a flawed body. Shape (10,)."""
    out, size = np.zeros(10), max(body.mass, 0.0) * body.length**2
    # About the joint's origin, where the error of the tensor is the same.
    out[4:] = max(float(abs(body.moments).max()), 0.1 * size)
    if kind in ("mass", "centre"):
        away = max(float(np.linalg.norm(body.centre)), body.length)
        out[1:4] = body.mass * away
        out[4:] += body.mass * away**2
    if kind == "mass":
        out[0] = body.mass
    return out


def _nearest(body: LinkBody) -> Array:
    """The physically possible tensor nearest to a body's. (3, 3)."""
    if not body.mass:
        return np.zeros((3, 3))
    tensor = body.tensor
    values, axes = np.linalg.eigh(np.trace(tensor) / 2 * np.eye(3) - tensor)
    values = np.maximum(values, THIN * max(values[-1], 1e-12))
    spread = (axes * values) @ axes.T
    return np.trace(spread) * np.eye(3) - spread


def _felt_inertias(model: pin.Model, bodies: Sequence[LinkBody]) -> Array:
    """Inertia about each joint, the arm at zero [kg m^2]. Shape (dof,).

    Computed for rods with the length and mass of the links, since their tensors are in
    doubt.
    """
    model, rods = pin.Model(model), np.zeros(model.njoints)
    for body in bodies:
        rods[body.joint] += body.mass * body.length**2 / 12
    for j in range(1, model.njoints):
        whole = model.inertias[j]
        tensor = rods[j] * np.eye(3)
        model.inertias[j] = pin.Inertia(whole.mass, whole.lever, tensor)
    felt = np.abs(np.diag(pin.crba(model, model.createData(), pin.neutral(model))))
    turning = 0.0
    for j, slides in enumerate(find_prismatic_joints(model)):
        # A sliding joint has no moment; use the revolute joint before it.
        felt[j] = turning = turning if slides else felt[j]
    return felt


def _words(body: LinkBody) -> str:
    first, second, third, *products = body.entries
    if first == second == third and not any(products):
        return f"ixx = iyy = izz = {first:.4g} kg m^2"
    named = zip(_KEYS, body.entries, strict=True)
    kept = [f"{k} {v:.4g}" for n, (k, v) in enumerate(named) if n < 3 or v]
    return f"tensor {', '.join(kept)} kg m^2"


def _ball(mass: float, density: float) -> float:
    """Diameter of a ball [m]."""
    return 2 * (3 * max(mass, 0.0) / (4 * np.pi * density)) ** (1 / 3)


def _vector(node: ET.Element | None, key: str) -> Array:
    text = "0 0 0" if node is None else node.get(key, "0 0 0")
    return np.array(text.split(), float)


# The weight that the drives of an arm do not carry, by its robot file.
#
# MuJoCo supports that share ``gravcomp`` of the weight of a body with an extra force.
# Joints with actuatorgravcomp count it as torque of their drive; in the torque of the
# others it is missing:
#
# tau = Y(q, qd, qdd) pi - G(q) C pi
#
# with G the columns of gravity and C pi the supported masses and moments. For a body of
# several links, some supported, C is exact for the bodies of the file.


@dataclass(frozen=True, eq=False, slots=True)
class CarriedWeight:
    """The part of the arm's weight that is missing in the torque of its drives."""

    # C of each body: share of its mass and first moments. Shape (dof, 4, 4).
    shares: Array
    missing: Array  # whether it is missing from a joint's torque, (dof,), bool
    links: tuple[str, ...]  # links supported completely or in part


def read_carried_weight(
    model: pin.Model, urdf: str, bodies: Sequence[LinkBody]
) -> CarriedWeight | None:
    """Return the carried weight noted in our URDF; None if the drives carry all."""
    nodes = ET.fromstring(urdf).findall(f"modelgap/{GRAVCOMP}")
    share = {n.get("link", ""): float(n.get("share", "0")) for n in nodes}
    counted = {n.get("joint", "") for n in nodes}
    missing = np.array([name not in counted for name in list(model.names)[1:]])
    held, own = np.zeros((2, model.nv, 4))
    links = []
    for body in bodies:
        moments = body.mass * np.array([1.0, *body.centre])
        own[body.joint - 1] += moments
        held[body.joint - 1] += share.get(body.link, 0.0) * moments
        links += [body.link] * bool(share.get(body.link))
    if not links or not missing.any():
        return None
    shares = np.zeros((model.nv, 4, 4))
    for out, part, all_of_it in zip(shares, held, own, strict=True):
        if all_of_it[0] > 0:
            mean = part[0] / all_of_it[0]
            out += mean * np.eye(4)
            out[:, 0] += (part - mean * all_of_it) / all_of_it[0]
    return CarriedWeight(shares, missing, tuple(links))
