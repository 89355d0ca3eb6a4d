"""What an arm looks like: its links as bodies that move with its joints.

Where a URDF has shapes they are taken, meshes too where their files are found; a link
without any is a rod from its joint to the next.
"""

import re
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import coal
import numpy as np
import pinocchio as pin

from residual.recording import Array
from residual.robot.dynamics import flange_placement, joints_length
from residual.robot.robot import Robot

MOST_FACES = 120_000  # of all meshes together
_ROD = 0.035  # radius of a rod, as a share of the arm's length
_SHORTEST = 1e-3  # m


@dataclass(frozen=True, eq=False, slots=True)
class Body:
    """One rigid shape."""

    joint: int  # joint from 1 that it moves with; 0 for the base
    kind: str  # "mesh", "box", "cylinder" or "sphere"; a cylinder lies along its z
    place: Array  # its pose in the frame of that joint, (4, 4)
    # Box: its edges; cylinder: radius and length; sphere: radius [m].
    size: tuple[float, ...] = ()
    # Corners of a mesh [m], (n, 3).
    points: Array = field(default_factory=lambda: np.zeros((0, 3)))
    # Corners of its triangles, (m, 3).
    faces: Array = field(default_factory=lambda: np.zeros((0, 3), int))


@dataclass(frozen=True, eq=False, slots=True)
class Look:
    """An arm to be drawn."""

    places: Array  # pose of each joint in the frame of the one before, (dof, 4, 4)
    axes: Array  # axis of each joint in its own frame, (dof, 3)
    bodies: tuple[Body, ...]  # its shapes
    size: float  # length of the arm when it is stretched [m]
    lacking: tuple[str, ...] = ()  # files of meshes that were not found


def look_of(robot: Robot, folder: Path | None = None) -> Look:
    """Return what an arm looks like.

    Args:
        folder: Where its URDF lies, for files of meshes; None where nobody knows.
    """
    model = robot.model
    text, lacking = _with_files(robot.urdf, folder)
    shapes = pin.buildGeomFromUrdfString(model, text, pin.GeometryType.VISUAL)
    objects = list(shapes.geometryObjects)
    share = MOST_FACES // max(1, len(objects))
    bodies = [body for one in objects for body in _body(one, share)]
    size = joints_length(model)
    with_shape = {body.joint for body in bodies}
    rods = [r for r in _rods(robot, _ROD * size) if r.joint not in with_shape]
    places = [p.homogeneous for p in list(model.jointPlacements)[1:]]
    axes = [_axis(model, j) for j in range(1, model.njoints)]
    every = tuple([*bodies, *rods])
    return Look(np.array(places), np.array(axes), every, size, lacking)


def _with_files(urdf: str, folder: Path | None) -> tuple[str, tuple[str, ...]]:
    """Return the URDF with whole paths of its meshes, without those that are lacking.

    A link whose shapes are all lacking has none left.
    """
    root, lacking = ET.fromstring(urdf), []
    for link in root.findall("link"):
        for shape in link.findall("visual"):
            mesh = shape.find("geometry/mesh")
            if mesh is None:
                continue
            word = mesh.get("filename", "")
            path = _found(word, folder)
            if path is None:
                lacking.append(word)
                link.remove(shape)
            else:
                mesh.set("filename", str(path))
    return ET.tostring(root, encoding="unicode"), tuple(dict.fromkeys(lacking))


def _found(word: str, folder: Path | None) -> Path | None:
    """Return the file of a mesh: beside the URDF, or in its package around it."""
    plain = re.sub(r"^(package|file|model)://", "", word)
    if folder is None or not plain:
        return None
    folder = folder.resolve()
    tried = [base / plain for base in (folder, *folder.parents)]
    # The package's own name may be that of no folder in a copy.
    inner = plain.split("/", 1)[-1]
    tried += [base / inner for base in (folder, folder.parent)]
    return next((path for path in tried if path.is_file()), None)


def _body(shape: pin.GeometryObject, most: int) -> Sequence[Body]:
    geometry, place = shape.geometry, shape.placement.homogeneous
    joint = int(shape.parentJoint)
    match geometry:
        case coal.Box():
            size = tuple(2 * float(x) for x in geometry.halfSide)
            return [Body(joint, "box", place, size)]
        case coal.Cylinder() | coal.Capsule():
            size = (float(geometry.radius), 2 * float(geometry.halfLength))
            return [Body(joint, "cylinder", place, size)]
        case coal.Sphere():
            return [Body(joint, "sphere", place, (float(geometry.radius),))]
        case coal.BVHModelBase():
            points = np.array(geometry.vertices())  # scaled as the URDF says
            triangles = map(geometry.tri_indices, range(geometry.num_tris))
            faces = np.array([[t[0], t[1], t[2]] for t in triangles], int)
            points, faces = coarser(points, faces.reshape(-1, 3), most)
            return [Body(joint, "mesh", place, (), points, faces)]
    return []


def coarser(points: Array, faces: Array, most: int) -> tuple[Array, Array]:
    """Return a mesh with fewer triangles: corners in one cell of a grid become one.

    Vertex clustering (Rossignac and Borrel 1993, Multi-resolution 3D approximations).
    Corners (n, 3), and those of each triangle (m, 3).
    """
    cells = 256
    while len(faces) > most and cells > 4:
        low, span = points.min(axis=0), float(np.ptp(points, axis=0).max()) or 1.0
        keys = np.floor((points - low) / span * cells).astype(int)
        _, place = np.unique(keys, axis=0, return_inverse=True)
        place = place.ravel()
        counts = np.bincount(place)
        sums = [np.bincount(place, points[:, k]) for k in range(3)]
        merged = place[faces]
        a, b, c = merged.T
        points, faces = (
            np.stack(sums, axis=1) / counts[:, None],
            np.unique(merged[(a != b) & (b != c) & (a != c)], axis=0),
        )
        cells //= 2
    return points, faces


def _rods(robot: Robot, radius: float) -> list[Body]:
    """Every link as a rod, with a ball at its joint."""
    model, out = robot.model, []
    ends = [p.translation for p in list(model.jointPlacements)[1:]]
    ends.append(flange_placement(model).translation)
    for joint, end in enumerate(ends):
        if joint:
            out.append(Body(joint, "sphere", np.eye(4), (1.25 * radius,)))
        length = float(np.linalg.norm(end))
        if length < _SHORTEST:
            continue
        up = np.array([0.0, 0.0, 1.0])
        turn = pin.Quaternion.FromTwoVectors(up, end / length).toRotationMatrix()
        place = pin.SE3(turn, end / 2).homogeneous
        out.append(Body(joint, "cylinder", place, (radius, length)))
    return out


def _axis(model: pin.Model, joint: int) -> Array:
    """Axis of a revolute joint in its own frame, from its motion subspace."""
    data = model.joints[joint].createData()
    return np.array(data.S).ravel()[3:6]
