"""The page of a log: the arm with its shapes, its motion, and what its models say."""

import base64
import json
import struct
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from flows.cli import main
from flows.report import page as base
from flows.report.view import frames_of, render
from flows.requests import View
from flows.steps.predict import Viewed, view
from residual.errors import InputError
from residual.recording import Recording
from residual.robot.robot import load_robot, robot_from_texts
from residual.robot.shapes import coarser, look_of
from tests.flows.report_pages import Page

CUBE = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
SIDES = [(0, 1, 3), (0, 3, 2), (4, 7, 5), (4, 6, 7), (0, 5, 1), (0, 4, 5)]
SIDES += [(2, 3, 7), (2, 7, 6), (0, 2, 6), (0, 6, 4), (1, 5, 7), (1, 7, 3)]


def write_stl(path: Path) -> None:
    """Write a cube with edges of one unit as binary STL."""
    rows = [
        struct.pack("<12fH", 0, 0, 0, *np.concatenate(CUBE[list(side)]), 0)
        for side in SIDES
    ]
    path.write_bytes(b"\0" * 80 + struct.pack("<I", len(rows)) + b"".join(rows))


def a_log(dof: int, seconds: float = 4.0) -> Recording:
    t = np.arange(0, seconds, 0.004)
    q = 0.4 * np.sin(np.outer(t, 1 + 0.3 * np.arange(dof)))
    return Recording("A", "irb140", t, q, 10 * np.cos(q))


def shown(joints_with_shapes: bool = True) -> Viewed:
    robot = load_robot("irb140")
    if not joints_with_shapes:
        robot = robot_from_texts("bare", without_shapes(robot.urdf), "{}")
    log = a_log(robot.dof)
    torque = {"nominal": 0.5 * log.tau}
    return Viewed(robot, look_of(robot), log, torque, (), None, ())


def without_shapes(urdf: str) -> str:
    parts = urdf.split("<visual")
    return parts[0] + "".join(p.split("</visual>", 1)[1] for p in parts[1:])


def numbers(packed: dict) -> np.ndarray:
    return np.frombuffer(base64.b64decode(packed["bdata"]), "<f4")


@pytest.mark.parametrize("with_shapes", [True, False])
def test_joints_and_axes_give_the_pose_of_the_flange(with_shapes):
    found = shown(with_shapes)
    q = found.log.q[137]
    pose = np.eye(4)
    for place, axis, angle in zip(found.look.places, found.look.axes, q, strict=True):
        turn = np.eye(4)
        turn[:3, :3] = pin.exp3(axis * angle)
        pose = pose @ place @ turn
    model, data = found.robot.model, found.robot.model.createData()
    pin.forwardKinematics(model, data, q)
    assert np.allclose(pose, data.oMi[model.njoints - 1].homogeneous, atol=1e-9)


def test_meshes_are_found_beside_the_urdf_and_scaled(tmp_path):
    (tmp_path / "meshes").mkdir()
    write_stl(tmp_path / "meshes" / "cube.stl")
    urdf = without_shapes(load_robot("irb140").urdf)
    word = "package://irb140_support/meshes/cube.stl"
    mesh = f'<visual><geometry><mesh filename="{word}" scale="0.1 0.2 0.3"/>'
    links = urdf.split('<link name="')
    name, rest = links[2].split('"', 1)
    links[2] = f'{name}"{rest}'.replace(
        "</link>", f"{mesh}</geometry></visual></link>", 1
    )
    robot = robot_from_texts("meshed", '<link name="'.join(links), "{}")
    found = look_of(robot, tmp_path)
    (cube,) = [b for b in found.bodies if b.kind == "mesh"]
    assert np.allclose(np.ptp(cube.points, axis=0), [0.1, 0.2, 0.3], atol=1e-6)
    assert len(cube.faces) == 12
    assert found.lacking == ()
    lost = look_of(robot, None)
    assert lost.lacking == (word,)
    assert not any(b.kind == "mesh" for b in lost.bodies)
    assert cube.joint in {b.joint for b in lost.bodies}  # as a rod


def test_a_large_mesh_keeps_its_extent_with_fewer_faces():
    at = np.stack(np.meshgrid(*2 * [np.linspace(0, 1, 200)]), axis=-1).reshape(-1, 2)
    points = np.column_stack([at, np.sin(3 * at[:, 0])])
    row = np.arange(199 * 200).reshape(199, 200)[:, :-1].ravel()
    faces = np.column_stack([row, row + 1, row + 200])
    fewer, triangles = coarser(points, faces, 5000)
    assert 500 < len(triangles) <= 5000
    assert triangles.max() < len(fewer)
    assert np.allclose(np.ptp(fewer, axis=0), np.ptp(points, axis=0), atol=0.05)
    same, all_faces = coarser(points, faces, len(faces))
    assert (len(same), len(all_faces)) == (len(points), len(faces))


def test_the_page_has_the_motion_and_runs_only_known_scripts():
    found = shown()
    html = render(found)
    page = Page(html)
    assert len(page.scripts) == 4
    policy = page.all("meta")[2]["content"]
    assert [base.hash_of(text) for text in page.scripts] == policy.split()[-4:]
    scene = page.plots[0]
    rows = frames_of(found.log)
    assert np.allclose(numbers(scene["motion"]["t"]), found.log.t[rows], atol=1e-5)
    q = numbers(scene["motion"]["q"]).reshape(-1, 6)
    assert np.allclose(q, found.log.q[rows], atol=1e-6)
    assert len(scene["arm"]["joints"]) == 6
    assert len(page.plots) == 1 + 6
    assert "50.0 %" in page.text
    library = len(base.library()) + len(base.scene_library())
    assert len(html.encode()) - library < 2_000_000


def test_what_is_missing_is_said(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError, match="does not say which robot"):
        view(View("A.csv"))
    monkeypatch.setattr(base, "find_spec", lambda name: None)
    base.scene_library.cache_clear()
    with pytest.raises(InputError, match=r'pip install "modelgap\[view\]"'):
        base.scene_library()


def test_a_file_is_shown_with_the_model_as_described(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    log = a_log(6)
    names = ["t", *(f"q{j}" for j in range(1, 7)), *(f"tau{j}" for j in range(1, 7))]
    rows = np.column_stack([log.t, log.q, log.tau])
    np.savetxt("A.csv", rows, delimiter=",", header=",".join(names), comments="")
    assert main(["view", "A.csv", "--robot", "irb140", "--out", "a.html"]) == 0
    assert "wrote a.html" in capsys.readouterr().out
    page = Page(Path("a.html").read_text(encoding="utf-8"))
    assert "The arm as it moved" in page.text
    names = [trace["name"] for trace in page.plots[1]["data"]]
    assert names == ["measured", "nominal (as given)", "nominal (as given)"]
    assert json.dumps(page.plots[0]["first"]) == "0"
