"""The weight that the drives of an arm do not carry, by what its robot file states.

MuJoCo holds a body with ``gravcomp`` against that share of its weight by a force of its
own. Joints with actuatorgravcomp count it as torque of their drive; on the others
it is missing from it:

tau = Y(q, qd, qdd) pi - G(q) C pi

with G the columns of gravity and C pi the masses and moments that are held. A body of
several links, some held, has a C that is exact for the bodies of the file.
"""

import xml.etree.ElementTree as ET
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from residual.recording import Array
from residual.robot.plausibility import LinkBody
from residual.robot.urdf import GRAVCOMP


@dataclass(frozen=True, eq=False, slots=True)
class CarriedWeight:
    """What of the arm's weight is missing from the torque of its drives."""

    # C of each body: mass and first moments held, of its own. Shape (dof, 4, 4).
    shares: Array
    missing: Array  # whether it is missing from a joint's torque, (dof,), bool
    links: tuple[str, ...]  # that are held, in whole or in part


def read_carried_weight(
    model: pin.Model, urdf: str, bodies: Sequence[LinkBody]
) -> CarriedWeight | None:
    """Return what a URDF of ours notes of it; None where the drives carry all."""
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
