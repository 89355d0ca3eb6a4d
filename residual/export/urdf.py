"""A model as URDF: inertias, and damping and dry friction of the joints."""

import xml.etree.ElementTree as ET

from residual.export.exported import Exported, Whole, body_of, file_stem, with_bodies
from residual.export.passive import properties, split_passive
from residual.robot.urdf_write import with_inertials

CAN = ("damping", "friction")


def to_urdf(whole: Whole) -> Exported:
    """Return a model as the text of a URDF.

    Returns:
        One file; gravity and what the drives add is not for a URDF to say.

    Raises:
        InputError: If a link has no positive mass.
    """
    parts = split_passive(whole, "URDF", CAN)
    model = body_of(parts.carried)
    root = ET.fromstring(with_inertials(model.robot, with_bodies(model)))
    joints = {j.get("name"): j for j in root.findall("joint")}
    values = properties(model)
    for number, name in enumerate(list(model.robot.model.names)[1:]):
        joint = joints[name]
        for old in joint.findall("dynamics"):
            joint.remove(old)
        own = {key: repr(float(values[key][number])) for key in CAN}
        ET.SubElement(joint, "dynamics", own)
    ET.indent(root)
    text = ET.tostring(root, encoding="unicode") + "\n"
    return parts.exported({f"{file_stem(whole)}.urdf": text.encode()})
