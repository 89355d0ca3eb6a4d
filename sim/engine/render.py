"""A moving picture of an arm: GIF, made without a display."""

import io
import xml.etree.ElementTree as ET

import numpy as np
import pinocchio as pin
from PIL import Image, ImageDraw

from residual.recording import Array
from residual.robot.robot import Robot
from sim.engine.bullet import Camera
from sim.engine.geometry import body
from sim.engine.records import Reference

_SIZE = (400, 320)  # pixels
_COLOURS = 64
_LONGEST = 10.0  # s that a picture shows where nothing repeats
_PLAYED = 6.0  # s that it plays at most
_STICK = 0.7  # radius of links that have no shape, in radii of the capsules
_COLOUR = "1 0.43 0.1 1"


def animate(robot: Robot, reference: Reference, frames: int = 60) -> bytes:
    """Return a GIF of the arm along a reference, one period of it where it repeats."""
    shown = reference.period or _LONGEST
    rows = reference.t <= shown + 1e-9
    return gif_of(robot, reference.t[rows], reference.q[rows], frames)


def gif_of(robot: Robot, t: Array, q: Array, frames: int = 60) -> bytes:
    """Return a GIF of the arm along samples, in real time or faster.

    Args:
        robot: The arm. Links without a primitive shape are drawn as rods.
    """
    rows = np.searchsorted(t, np.linspace(t[0], t[-1], frames, endpoint=False))
    span = float(t[-1] - t[0])
    arm = body(robot.model)
    length, stands = arm.radius / 0.07, bool(arm.low)
    with Camera(urdf_to_see(robot), length, stands, _SIZE) as camera:
        shots = [(camera.shot(q[row]), t[row] - t[0]) for row in rows]
    pictures = []
    for pixels, time in shots:
        picture = Image.fromarray(pixels)
        title = f"{robot.name}  {time:4.1f} s"
        ImageDraw.Draw(picture).text((8, 6), title, fill=(60, 60, 60))
        pictures.append(picture)
    # One palette for all: what does not move then costs nothing.
    palette = pictures[0].quantize(_COLOURS, dither=Image.Dither.NONE)
    pictures = [p.quantize(palette=palette, dither=Image.Dither.NONE) for p in pictures]
    out = io.BytesIO()
    pause = 1000 * min(span, _PLAYED) / frames
    pictures[0].save(
        out,
        format="GIF",
        save_all=True,
        append_images=pictures[1:],
        duration=max(20, round(pause / 10) * 10),
        loop=0,
    )
    return out.getvalue()


def urdf_to_see(robot: Robot) -> str:
    """Return a URDF with the robot's primitive shapes, rods where it has none.

    Meshes are files beside the URDF, which nobody can count on.
    """
    root = ET.fromstring(robot.urdf)
    joints = {
        parent.get("link"): joint
        for joint in root.findall("joint")
        for parent in joint.findall("parent")
    }
    radius = _STICK * body(robot.model).radius
    for link in root.findall("link"):
        for shape in [*link.findall("collision"), *link.findall("visual")]:
            if shape.tag == "collision" or shape.find("geometry/mesh") is not None:
                link.remove(shape)
        joint = joints.get(link.get("name"))
        if link.find("visual") is None and joint is not None:
            _add_rod(link, joint, radius)
    return ET.tostring(root, encoding="unicode")


def _add_rod(link: ET.Element, joint: ET.Element, radius: float) -> None:
    """Draw a link as a rod from its own frame to the joint it carries."""
    origin = joint.find("origin")
    words = (origin.get("xyz") if origin is not None else None) or "0 0 0"
    end = np.array([float(word) for word in words.split()])
    length = float(np.linalg.norm(end))
    if length < 1e-3:
        return
    turn = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), end / length)
    angles = pin.rpy.matrixToRpy(turn.toRotationMatrix())
    visual = ET.SubElement(link, "visual")
    place = {"xyz": _words(end / 2), "rpy": _words(angles)}
    ET.SubElement(visual, "origin", place)
    size = {"length": f"{length:.6g}", "radius": f"{min(radius, length / 2):.6g}"}
    ET.SubElement(ET.SubElement(visual, "geometry"), "cylinder", size)
    material = ET.SubElement(visual, "material", {"name": f"rod_{link.get('name')}"})
    ET.SubElement(material, "color", {"rgba": _COLOUR})


def _words(values: Array) -> str:
    return " ".join(f"{value:.6g}" for value in values)
