"""PyBullet: integrator of the link side, camera, GIFs; only this file imports it.

One step is exact: tau = RNEA(q_k, v_k, (v_(k+1) - v_k) / dt) to about 1e-11 N m, and
q_(k+1) = q_k + dt v_(k+1). Every setting below is needed for that.
"""

import ctypes
import io
import os
import sys
import tempfile
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Self

import numpy as np
import pinocchio as pin
from PIL import Image, ImageDraw

from residual.errors import build_missing_package_error
from residual.recording import Array
from residual.robot.dynamics import find_joint_axis
from residual.robot.files import find_prismatic_joints
from residual.robot.robot import Robot
from sim.engine.geometry import build_arm_capsules
from sim.engine.plant_records import ReferenceMotion

_FREE = 1e3  # rad and rad/s: limits that nothing reaches
_LOOK = {"yaw": 52.0, "pitch": -18.0, "roll": 0.0, "upAxisIndex": 2}
_FIELD = 40.0  # degrees from top to bottom
_AWAY = 2.1  # distance of the camera, in lengths of the arm
_UP = 0.4  # height that it looks at, in lengths of the arm
_TILES = 4  # from the middle to the edge of the floor
_FLOOR = ((0.86, 0.88, 0.9, 1.0), (0.76, 0.79, 0.82, 1.0))
_LIGHT = (1.2, -1.6, 3.0)


def write_model_urdf(model: pin.Model) -> str:
    """Return a URDF with the joints and bodies of a serial arm.

    Inertias are written along their principal axes: Bullet's own diagonalisation of a
    full tensor is good to 1e-6 N m only. Ranges are left wide open.
    """
    parts = ['<?xml version="1.0"?>', '<robot name="arm">', _link(0, None)]
    for i in range(1, model.njoints):
        parts += [_link(i, model.inertias[i]), _joint(model, i)]
    return "\n".join([*parts, "</robot>"])


def _link(i: int, body: pin.Inertia | None) -> str:
    if body is None:
        body = pin.Inertia(1.0, np.zeros(3), np.eye(3))  # the base does not move
    moments, axes = np.linalg.eigh(body.inertia)
    axes[:, 0] *= np.sign(np.linalg.det(axes))
    tensor = " ".join(
        f'{name}="{float(value)!r}"'
        for name, value in zip(("ixx", "iyy", "izz"), moments, strict=True)
    )
    return (
        f'<link name="link{i}"><inertial>{_origin(axes, body.lever)}'
        f'<mass value="{float(body.mass)!r}"/>'
        f'<inertia {tensor} ixy="0" ixz="0" iyz="0"/></inertial></link>'
    )


def _joint(model: pin.Model, i: int) -> str:
    place = model.jointPlacements[i]
    kind = "prismatic" if find_prismatic_joints(model)[i - 1] else "revolute"
    return (
        f'<joint name="joint{i}" type="{kind}"><parent link="link{i - 1}"/>'
        f'<child link="link{i}"/>{_origin(place.rotation, place.translation)}'
        f'<axis xyz="{_numbers(find_joint_axis(model, i))}"/>'
        '<limit lower="-1000" upper="1000" effort="0" velocity="1000"/></joint>'
    )


def _origin(rotation: Array, translation: Array) -> str:
    rpy = pin.rpy.matrixToRpy(rotation)
    return f'<origin xyz="{_numbers(translation)}" rpy="{_numbers(rpy)}"/>'


def _numbers(values: Array) -> str:
    return " ".join(repr(float(value)) for value in values)


@contextmanager
def silence_c_output() -> Iterator[None]:
    """Keep what C prints off the terminal, its own buffer included."""
    flush = ctypes.CDLL(None).fflush
    sys.stdout.flush()
    flush(None)
    sys.stderr.flush()
    saved = {number: os.dup(number) for number in (1, 2)}
    sink = os.open(os.devnull, os.O_WRONLY)
    for number in saved:
        os.dup2(sink, number)
    try:
        yield
    finally:
        flush(None)
        for number, copy in saved.items():
            os.dup2(copy, number)
            os.close(copy)
        os.close(sink)


class _Bullet:
    """PyBullet, loaded with the first arm that is put into it.

    Elsewhere than on Linux with Python 3.11 it is not installed, and what needs no
    simulated arm goes without.
    """

    def __getattr__(self, name: str):
        try:
            with silence_c_output():
                import pybullet
        except ImportError as error:
            raise build_missing_package_error("pybullet") from error
        # From here on names are found without a detour.
        vars(self).update(vars(pybullet))
        return getattr(pybullet, name)


bullet = _Bullet()


class _Client:
    """One arm in one physics client; close it, or use it in a with block."""

    def __init__(self, urdf: str, flags: int = 0) -> None:
        self._client = bullet.connect(bullet.DIRECT)
        self._on = {"physicsClientId": self._client}
        with tempfile.TemporaryDirectory() as folder, silence_c_output():
            path = Path(folder) / "arm.urdf"
            path.write_text(urdf, encoding="utf-8")
            self._arm = bullet.loadURDF(
                str(path), useFixedBase=True, flags=flags, **self._on
            )

    def close(self) -> None:
        """Let go of the physics client; twice is once."""
        if self._client >= 0:
            bullet.disconnect(self._client)
            self._client = -1

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


class BulletWorld(_Client):
    """One arm that moves by physics."""

    def __init__(self, model: pin.Model, dt: float) -> None:
        super().__init__(write_model_urdf(model), bullet.URDF_USE_INERTIA_FROM_FILE)
        self._joints = list(range(model.nv))
        bullet.setGravity(*model.gravity.linear.tolist(), **self._on)
        bullet.setPhysicsEngineParameter(
            fixedTimeStep=dt,
            numSubSteps=0,
            numSolverIterations=50,
            solverResidualThreshold=0,
            deterministicOverlappingPairs=1,
            **self._on,
        )
        self._set_free()

    def _set_free(self) -> None:
        """Switch off dampers, limits and motors that Bullet adds by itself."""
        # One property per call: combined, changeDynamics drops some of them silently.
        for link in (-1, *self._joints):
            free = {"linearDamping": 0, "angularDamping": 0}
            bullet.changeDynamics(self._arm, link, **free, **self._on)
            bullet.changeDynamics(self._arm, link, maxJointVelocity=_FREE, **self._on)
        for link in self._joints:
            limits = {"jointLowerLimit": -_FREE, "jointUpperLimit": _FREE}
            bullet.changeDynamics(self._arm, link, **limits, **self._on)
        still = [0.0] * len(self._joints)
        motors = bullet.VELOCITY_CONTROL
        bullet.setJointMotorControlArray(
            self._arm, self._joints, motors, forces=still, **self._on
        )

    def reset(self, q: Array, qd: Array) -> None:
        """Put the arm into a state."""
        for joint, position, velocity in zip(self._joints, q, qd, strict=True):
            bullet.resetJointState(self._arm, joint, position, velocity, **self._on)

    def state(self) -> tuple[Array, Array]:
        """Return positions [rad] and velocities [rad/s], shapes (dof,)."""
        states = bullet.getJointStates(
            self._arm, self._joints, physicsClientId=self._client
        )
        return np.array([s[0] for s in states]), np.array([s[1] for s in states])

    def step(self, torque: Array) -> None:
        """Go on by one time step under these joint torques [N m]. Shape (dof,)."""
        bullet.setJointMotorControlArray(
            self._arm,
            self._joints,
            bullet.TORQUE_CONTROL,
            forces=torque.tolist(),
            physicsClientId=self._client,
        )
        bullet.stepSimulation(physicsClientId=self._client)


class BulletCamera(_Client):
    """A camera on one arm, on a floor, without a display.

    TinyRenderer computes pictures on the processor; nothing here moves by physics.

    Args:
        urdf: What the arm looks like: primitive shapes, no meshes.
        length: Length of the stretched arm [m].
        floor: Whether there is a floor at z = 0.
        size: Width and height of a picture [pixels].
    """

    def __init__(
        self, urdf: str, length: float, floor: bool, size: tuple[int, int]
    ) -> None:
        super().__init__(urdf)
        self._size = size
        self._joints = [
            joint
            for joint in range(bullet.getNumJoints(self._arm, **self._on))
            if bullet.getJointInfo(self._arm, joint, **self._on)[2]
            == bullet.JOINT_REVOLUTE
        ]
        if floor:
            self._lay_floor(1.2 * length)
        self._view = bullet.computeViewMatrixFromYawPitchRoll(
            (0.15 * length, 0.0, _UP * length), _AWAY * length, **_LOOK
        )
        self._lens = bullet.computeProjectionMatrixFOV(
            _FIELD, size[0] / size[1], 0.05 * length, 10 * length
        )

    def take_picture(self, q: Array) -> Array:
        """Return a picture of the arm in a posture.

        Returns:
            Red, green and blue, 0 to 255. Shape (height, width, 3).
        """
        for joint, position in zip(self._joints, q, strict=True):
            bullet.resetJointState(self._arm, joint, float(position), **self._on)
        width, height = self._size
        picture = bullet.getCameraImage(
            width,
            height,
            self._view,
            self._lens,
            lightDirection=_LIGHT,
            # Its shadows lie in stripes on a floor, and take longer than all the rest.
            shadow=0,
            renderer=bullet.ER_TINY_RENDERER,
            **self._on,
        )
        pixels = np.asarray(picture[2], dtype=np.uint8)
        return pixels.reshape(height, width, 4)[:, :, :3]

    def _lay_floor(self, half: float) -> None:
        """Lay tiles of two shades, which show where the arm stands.

        Small ones: the renderer looks at every pixel around a triangle, and takes
        seconds for long thin ones.
        """
        side = half / _TILES
        corners = side * np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
        places = range(-_TILES, _TILES)
        for shade, colour in enumerate(_FLOOR):
            tiles = [(i, j) for i in places for j in places if (i + j) % 2 == shade]
            points = [
                corner + side * np.array([i, j, 0])
                for i, j in tiles
                for corner in corners
            ]
            faces = [4 * n + k for n in range(len(tiles)) for k in (0, 1, 2, 0, 2, 3)]
            shape = bullet.createVisualShape(
                bullet.GEOM_MESH,
                vertices=np.array(points).tolist(),
                indices=faces,
                normals=[(0.0, 0.0, 1.0)] * len(points),
                rgbaColor=colour,
                **self._on,
            )
            bullet.createMultiBody(baseVisualShapeIndex=shape, **self._on)


_SIZE = (400, 320)  # pixels
_COLOURS = 64
_LONGEST = 10.0  # s that a picture shows where nothing repeats
_PLAYED = 6.0  # s that it plays at most
_STICK = 0.7  # radius of links that have no shape, in radii of the capsules
_COLOUR = "1 0.43 0.1 1"


def animate_reference(robot: Robot, motion: ReferenceMotion, frames: int = 60) -> bytes:
    """Return a GIF of the arm along a reference, one period of it where it repeats."""
    shown = motion.period or _LONGEST
    rows = motion.t <= shown + 1e-9
    return animate_samples(robot, motion.t[rows], motion.q[rows], frames)


def animate_samples(robot: Robot, t: Array, q: Array, frames: int = 60) -> bytes:
    """Return a GIF of the arm along samples, in real time or faster.

    Args:
        robot: The arm. Links without a primitive shape are drawn as rods.
    """
    rows = np.searchsorted(t, np.linspace(t[0], t[-1], frames, endpoint=False))
    span = float(t[-1] - t[0])
    arm = build_arm_capsules(robot.model)
    length, stands = arm.radius / 0.07, bool(arm.low)
    with BulletCamera(write_visible_urdf(robot), length, stands, _SIZE) as camera:
        shots = [(camera.take_picture(q[row]), t[row] - t[0]) for row in rows]
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


def write_visible_urdf(robot: Robot) -> str:
    """Return a URDF with the robot's primitive shapes, rods where it has none.

    Meshes are files beside the URDF, which nobody can count on.
    """
    root = ET.fromstring(robot.urdf)
    joints = {
        parent.get("link"): joint
        for joint in root.findall("joint")
        for parent in joint.findall("parent")
    }
    radius = _STICK * build_arm_capsules(robot.model).radius
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
