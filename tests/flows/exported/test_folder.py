"""A study as plain files: the same bits again, and nothing gives the truth away."""

import json
from dataclasses import replace
from pathlib import Path

import pytest

from flows.blind import draw as blind_draw
from flows.blind.draw import Draft, Excitation, StudyRequest, Wish
from flows.blind.export import write
from flows.blind.export.write import classes, words
from flows.workers.pool import Here
from residual.errors import InputError, RunError
from sim.engine.records import CLEAN


def test_every_effect_has_a_class_and_three_are_bodies():
    known = classes()
    assert set(known.values()) == {"body", "joint", "other"}
    assert [name for name, c in known.items() if c == "body"] == [
        "link_body",
        "link_inertia",
        "payload",
    ]
    assert {name: own["class"] for name, own in words().items()} == known


# -- a whole export, of motions that need no search -----------------------------------

SHORT = Excitation(0, ("cyclic",), ("cyclic",), 0.005, 1e-4)
ASKED = StudyRequest(2, 3, duration=4.0, background=CLEAN)
DRAFTS = [
    Draft(0, "single", (Wish("torque_gain", 10.0),), SHORT),
    Draft(1, "unknown", (Wish("x_square_wave", None),), SHORT),
]


@pytest.fixture
def short(monkeypatch, compiled_plant):
    monkeypatch.setattr(write, "drafts", lambda asked: DRAFTS[: asked.n])
    monkeypatch.setattr("flows.blind.export.write.AFTER", ("cyclic",))
    monkeypatch.setattr(blind_draw, "_PAUSE", 1.0)
    # Without known sizes the usual ones are hidden, and nothing need be diagnosed.
    monkeypatch.setattr(write, "null_sizes", lambda *args: ({0: []}, []))


@pytest.mark.slow
def test_an_export_has_every_bit_again_and_gives_nothing_away(short, tmp_path):
    for name, asked in (("one", ASKED), ("two", replace(ASKED, n=1))):
        store = tmp_path / f"store_{name}"
        write.export_study(asked, (0,), tmp_path / name, store, Here())
    one, two = (
        {p.relative_to(tmp_path / n): p.read_bytes() for p in logs_of(tmp_path / n)}
        for n in ("one", "two")
    )
    assert len(two) >= 3
    assert {place: one[place] for place in two} == two
    opened = tmp_path / "one" / "open"
    files = [p for p in opened.rglob("*") if p.is_file()]
    assert len(files) == 2 + 2 + 2 * 3
    # Of both cases the same names, heads and lengths; only the judge has the torque.
    heads = {}
    for path in (p for p in files if p.suffix == ".csv"):
        text = path.read_text()
        heads.setdefault(path.name, set()).add((text.split("\n")[0], text.count("\n")))
        assert ("tau" in text) == path.name.startswith("fit_")
    assert {len(values) for values in heads.values()} == {1}
    lists = json.loads((opened / "cases.json").read_text())["cases"]
    assert lists["case_001"] == lists["case_002"]
    told = " ".join(p.read_text() for p in files if p.name != "classes.json")
    assert "torque_gain" not in told
    assert "square_wave" not in told
    truth = json.loads((tmp_path / "one" / "sealed" / "truth.json").read_text())
    (hidden,) = truth["cases"]["case_001"]["effects"]
    assert hidden["effect"] == "torque_gain"
    assert truth["cases"]["case_002"]["after"] == {"after_1": None}


def logs_of(folder):
    return [path for path in folder.rglob("*.csv") if "case_001" in str(path)]


def test_a_folder_that_is_there_is_not_written_into(tmp_path):
    with pytest.raises(InputError, match="is there already; name a new folder"):
        write.export_study(ASKED, (0,), tmp_path, tmp_path, Here())


def test_a_case_that_fails_leaves_no_folder(monkeypatch, tmp_path):
    monkeypatch.setattr(write, "null_sizes", lambda *args: ({}, ["excitation 0: why"]))
    with pytest.raises(RunError, match="excitation 0: why"):
        write.export_study(ASKED, (0,), tmp_path / "new", tmp_path / "store", Here())
    assert not (tmp_path / "new").exists()


def test_every_ten_cases_have_another_arm(tmp_path):
    cases = write.parts(StudyRequest(40, 1, background=CLEAN), range(3), tmp_path)
    arms = [own.robot for own, _ in cases][::10]
    assert arms[0] == arms[3] == "irb140"
    assert len(set(arms)) == 3
    assert {Path(word).parent for word in arms[1:3]} == {tmp_path / "open" / "robots"}
    again = write.parts(
        StudyRequest(40, 1, background=CLEAN), range(3), tmp_path / "again"
    )
    names = [[Path(own.robot).name for own, _ in part] for part in (cases, again)]
    assert names[0] == names[1]
