"""A camera in PyBullet: pictures of an arm on a floor, without a display.

TinyRenderer computes them on the processor; nothing here moves by physics.
"""

import tempfile
from pathlib import Path
from types import TracebackType

import numpy as np

from sim.engine.bullet import silence

with silence():
    import pybullet as bullet

Array = np.ndarray

_LOOK = {"yaw": 52.0, "pitch": -18.0, "roll": 0.0, "upAxisIndex": 2}
_FIELD = 40.0  # degrees from top to bottom
_AWAY = 2.1  # distance of the camera, in lengths of the arm
_UP = 0.4  # height that it looks at, in lengths of the arm
_TILES = 4  # from the middle to the edge of the floor
_FLOOR = ((0.86, 0.88, 0.9, 1.0), (0.76, 0.79, 0.82, 1.0))
_LIGHT = (1.2, -1.6, 3.0)


class Camera:
    """A camera on one arm; close it, or use it in a with block.

    Args:
        urdf: What the arm looks like: primitive shapes, no meshes.
        length: Length of the stretched arm [m].
        floor: Whether there is a floor at z = 0.
        size: Width and height of a picture [pixels].
    """

    def __init__(
        self, urdf: str, length: float, floor: bool, size: tuple[int, int]
    ) -> None:
        self._size = size
        self._client = bullet.connect(bullet.DIRECT)
        self._on = {"physicsClientId": self._client}
        self._arm = self._load(urdf)
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

    def shot(self, q: Array) -> Array:
        """Return a picture of the arm in a posture.

        Args:
            q: Positions [rad]. Shape (dof,).

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

    def close(self) -> None:
        """Give the physics client back."""
        if self._client >= 0:
            bullet.disconnect(self._client)
            self._client = -1

    def __enter__(self) -> "Camera":
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def _load(self, urdf: str) -> int:
        with tempfile.TemporaryDirectory() as folder, silence():
            path = Path(folder) / "arm.urdf"
            path.write_text(urdf, encoding="utf-8")
            return bullet.loadURDF(str(path), useFixedBase=True, **self._on)

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
