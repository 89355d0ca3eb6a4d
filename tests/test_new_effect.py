"""New effects, readers and exporters: in two files here, or in another package."""

import importlib
import json
import sys
from pathlib import Path

import numpy as np
import pytest

from flows.cli import main
from flows.steps.export import list_export_targets
from residual.effects import load_effects
from residual.errors import InputError
from residual.plugins import load_plugins
from sim.engine.plant_records import SyntheticEffect as Effect
from tests.residual.arms import arm, short_case, urdf_text
from tests.residual.test_model_record import model_of
from tests.synthetic.logs import write_csv
from warehouse.logs import read_log

NAME, JOINT, SIZE = "creaking", 2, 8.0  # N m s/rad^2


@pytest.mark.usefixtures("new_effect")
def test_an_effect_of_two_new_files_is_hidden_found_named_and_shown(own_folder, capsys):
    case = short_case(arm(), Effect(NAME, (JOINT,), {"coefficient": SIZE}), seed=5)
    logs = [f"{log.id}.csv" for log in (*case.fit, *case.held_out)]
    for name, log in zip(logs, (*case.fit, *case.held_out), strict=True):
        write_csv(name, log)
    (own_folder / "arm.urdf").write_text(urdf_text())
    files = [str(own_folder / name) for name in ("verdict.json", "page.html")]
    options = ["--holdout", logs[-1], "--robot", str(own_folder / "arm.urdf")]
    options += ["--json", files[0], "--report", files[1]]
    assert main(["diagnose", *logs[:-1], *options]) == 0
    shown = capsys.readouterr().out
    verdict, page = (Path(file).read_text(encoding="utf-8") for file in files)
    (finding,) = json.loads(verdict)["effects"]
    assert (finding["name"], finding["joints"]) == (NAME, [JOINT])
    size = finding["parameters"]["coefficient"]
    assert size["unit"] == "N m s/rad^2"
    assert abs(size["value"] - SIZE) < 4 * size["std"]
    assert "a creaking hinge on joint 2" in shown
    assert "coefficient" in shown
    for words in ("a creaking hinge on joint 2", "grows with the angle", "coefficient"):
        assert words in page


# Effects, readers and exporters of another package, found by its entry points.


PACKAGE = '''
from residual.effects.base import Effect, build_joint_columns
from residual.export.model_export import ModelExport, to_json
from warehouse.logs.log_tables import LogFile
import numpy as np

SIZE = Effect(
    "gadget",
    "a gadget on the hinge",
    {"coefficient": "N m"},
    build_joint_columns(lambda state, j, shape: [np.cos(3 * state.q[:, j])]),
)

class Shouted(LogFile):
    """A log whose lines are NAME: value value ..."""

    def __init__(self, path):
        lines = path.read_text().splitlines()[1:]
        parts = [line.split(":") for line in lines]
        self._table = {n: np.array(v.split(), float) for n, v in parts}
        self.name, self.columns = path.name, tuple(self._table)

    def read(self, columns):
        return {name: self._table[name] for name in columns}

def shouted(path, head, columns, joints):
    return Shouted(path) if head.startswith(b"SHOUTED") else None

def poem(model):
    return to_json(model)
'''
ENTRIES = """[modelgap.effects]
gadget = gadgets:SIZE
[modelgap.readers]
shouted = gadgets:shouted
[modelgap.exporters]
poem = gadgets:poem
"""


@pytest.fixture
def install(tmp_path, monkeypatch):
    """Return a function that puts a package with entry points on the path."""

    def forget():
        load_plugins.cache_clear()
        load_effects.cache_clear()
        importlib.invalidate_caches()
        sys.modules.pop("gadgets", None)

    def put(entries=ENTRIES, code=PACKAGE):
        (tmp_path / "gadgets.py").write_text(code)
        info = tmp_path / "gadgets-1.0.dist-info"
        info.mkdir()
        (info / "METADATA").write_text("Name: gadgets\nVersion: 1.0\n")
        (info / "entry_points.txt").write_text(entries)
        monkeypatch.syspath_prepend(tmp_path)
        forget()
        return tmp_path

    yield put
    monkeypatch.undo()
    forget()


def test_an_effect_of_a_package_is_one_of_the_registry(install, capsys):
    install()
    assert list(load_effects())[-1] == "gadget"
    robot = arm()
    model = model_of(["gadget"], robot)
    assert "gadget" in repr(model)
    state = np.zeros((1, robot.dof))
    bare = model.without("gadget").torque(state, state, state)
    assert np.abs(model.torque(state, state, state) - bare).max() > 0


def test_a_reader_of_a_package_is_asked_before_ours(install):
    folder = install()
    t = np.arange(300) / 100
    q = np.column_stack([np.sin(2 * t), np.cos(3 * t)])
    columns = {"t": t, "q1": q[:, 0], "q2": q[:, 1], "tau1": t**2, "tau2": -q[:, 0]}
    lines = [f"{n}: {' '.join(map(repr, map(float, x)))}" for n, x in columns.items()]
    (folder / "log.loud").write_text("\n".join(["SHOUTED", *lines]))
    log, _ = read_log(str(folder / "log.loud"), arm())
    np.testing.assert_array_equal(log.q, q)


def test_an_exporter_of_a_package_is_a_target(install, monkeypatch, capsys):
    folder = install()
    monkeypatch.chdir(folder)
    assert "poem" in list_export_targets()
    model_of(["viscous"]).save("model.json")
    assert main(["export", "model.json", "--to", "poem", "--out", "out"]) == 0
    assert any((folder / "out").iterdir())


BROKEN = {
    "no such module": ("[modelgap.effects]\nx = nothing:X\n", "of gadgets"),
    "no effect": ("[modelgap.effects]\nx = gadgets:poem\n", "expected an Effect"),
    "another name": ("[modelgap.effects]\nx = gadgets:SIZE\n", "'gadget'"),
    "no function": ("[modelgap.exporters]\nx = gadgets:ENTRY\n", "cannot be loaded"),
    "a name of ours": ("[modelgap.exporters]\nurdf = gadgets:poem\n", "no other target"),
}


@pytest.mark.parametrize("name", BROKEN)
def test_a_broken_plug_in_is_named_with_its_package(install, name):
    entries, message = BROKEN[name]
    install(entries)
    with pytest.raises(InputError, match=message):
        (load_effects if "effects" in entries else list_export_targets)()


def test_a_command_says_so_and_ends(install, monkeypatch, capsys):
    folder = install("[modelgap.effects]\nx = nothing:X\n")
    monkeypatch.chdir(folder)
    (folder / "arm.urdf").write_text(urdf_text())
    assert main(["check", "log.csv", "--robot", "arm.urdf"]) == 2
    assert "uninstall gadgets" in capsys.readouterr().err
