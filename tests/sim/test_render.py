"""Pictures of an arm, made without a display."""

import io

import numpy as np
from PIL import Image

from residual.robot.robot import load_robot
from sim.engine.plant_records import ReferenceMotion
from sim.engine.pybullet_world import animate_reference, write_visible_urdf
from tests.sim.arms import SEVEN, arm

ROBOT = load_robot("irb140")


def _sweep(robot, n=40):
    t = np.arange(n) / 10
    q = np.zeros((n, robot.dof))
    q[:, 0] = np.linspace(-1, 1, n)
    return ReferenceMotion("move_stop_move", t, q, q * 0, q * 0, None)


def test_an_animation_is_a_small_gif_that_shows_an_arm_moving():
    data = animate_reference(ROBOT, _sweep(ROBOT), frames=12)
    picture = Image.open(io.BytesIO(data))
    assert (picture.format, picture.n_frames) == ("GIF", 12)
    assert len(data) < 1_000_000
    frames = []
    for i in (0, 6):
        picture.seek(i)
        frames.append(np.asarray(picture.convert("RGB")).astype(int))
    orange = [(f[:, :, 0] > 150) & (f[:, :, 2] < 80) for f in frames]
    assert all(0.01 < o.mean() < 0.3 for o in orange)
    assert (orange[0] != orange[1]).mean() > 0.005


def test_links_without_shapes_are_rods_and_meshes_are_left_out(tmp_path):
    robot = arm(SEVEN, tmp_path)
    assert write_visible_urdf(robot).count("<cylinder") == 8
    picture = Image.open(io.BytesIO(animate_reference(robot, _sweep(robot), frames=2)))
    pixels = np.asarray(picture.convert("RGB")).astype(int)
    assert ((pixels[:, :, 0] > 150) & (pixels[:, :, 2] < 80)).mean() > 0.005
    mesh = '<visual><geometry><mesh filename="package://x/y.stl"/></geometry></visual>'
    solid = '<collision><geometry><sphere radius="1"/></geometry></collision>'
    robot = arm(
        SEVEN.replace('<link name="l3">', f'<link name="l3">{mesh}{solid}'), tmp_path
    )
    assert "mesh" not in write_visible_urdf(robot)
    assert "sphere" not in write_visible_urdf(robot)
