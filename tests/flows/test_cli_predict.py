"""modelgap predict: the torque of a model on logs, whole and edited."""

import json
from dataclasses import replace

import numpy as np
import pyarrow.csv as pc
import pyarrow.parquet as pq
import pytest

from flows.cli import main
from residual.model.compare import EDITED, WHOLE
from residual.recording import Recording
from tests.exports.models import model_with, robot_of
from tests.residual.arms import smooth_motion
from tests.synthetic.logs import write_csv


@pytest.fixture
def place(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    robot = robot_of("irb140")
    model = model_with(robot, "payload", "viscous", "spring")
    first, second, *rest = model.terms
    second = replace(second, nominal=replace(second, theta=second.theta / 2))
    model = replace(model, terms=(first, second, *rest))
    t = np.arange(1500) / 250
    q, qd, qdd = smooth_motion(robot, t)
    log = Recording("log", robot.name, t, q, model.along(t, (q, qd, qdd)))
    write_csv("log.csv", log, "%.10g")
    model.save("model.json")
    return model, log


def test_the_error_of_a_model_and_of_the_edited_one(place, tmp_path, capsys):
    words = ["log.csv", "--model", "model.json", "--json", "e.json"]
    assert main(["predict", *words]) == 0
    document = json.loads((tmp_path / "e.json").read_text())["error"]
    assert document["overall_filtered"][WHOLE] < 0.5
    assert EDITED not in document["overall"]
    assert main(["predict", *words, "--without", "payload", "spring"]) == 0
    both = json.loads((tmp_path / "e.json").read_text())
    assert both["without"] == ["payload", "spring"]
    assert both["error"]["overall_filtered"][WHOLE] < 0.5
    assert both["error"]["overall_filtered"][EDITED] > 5
    output = capsys.readouterr().out
    assert "Error in % of torque (log)" in output
    assert "edited: Model(irb140: rigid body, viscous" in output
    assert "), without payload, spring\n" in output
    heads = output[output.rindex("Error in %") :].split("───")[0]
    assert [heads.count(word) for word in ("without", "payload", "spring")] == [3] * 3
    assert main(["predict", *words, "--without", "viscous@4"]) == 0
    shown = capsys.readouterr().out
    assert "viscous J4, spring J4), without viscous@4 (at its nominal value)\n" in shown
    # All joints together have each of the six errors that a joint has.
    (last,) = (row.split() for row in output.splitlines()[-12:] if row[:3] == "all")
    moving = both["error"]["overall_moving"]
    assert len(last) == 7
    assert float(last[-1]) == pytest.approx(moving[EDITED], rel=0.01)


@pytest.mark.parametrize("form", ["csv", "parquet"])
def test_samples_are_those_of_the_model_in_python(place, tmp_path, form):
    model, log = place
    out = tmp_path / f"o.{form}"
    words = ["log.csv", "--model", "model.json", "--without", "payload"]
    assert main(["predict", *words, "--out", str(out)]) == 0
    rows = pq.read_table(out) if form == "parquet" else pc.read_csv(out)
    heads = [f"{c}{j}" for c in ("tau", "tau_model", "tau_edited") for j in range(1, 7)]
    assert rows.column_names == ["log", "t", *heads]
    for head, one in (("tau_model", model), ("tau_edited", model.without("payload"))):
        got = np.column_stack([rows[f"{head}{j}"] for j in range(1, 7)])
        np.testing.assert_allclose(got, one.predict(log), atol=1e-3)


@pytest.mark.parametrize(
    ("more", "word"),
    [
        (["--without", "stribeck"], "Valid: payload, spring, viscous"),
        (["--without", "spring@x"], "expected NAME or NAME@JOINT"),
        (["--without", "payload@2"], "no payload on joints [2]"),
        (["--out", "o.txt"], "*.csv or *.parquet"),
        (["--which", "nominal"], "--which chooses"),
    ],
)
def test_what_cannot_be_done_is_said(place, capsys, more, word):
    assert main(["predict", "log.csv", "--model", "model.json", *more]) == 2
    assert word in capsys.readouterr().err
    assert main(["predict", "--model", "model.json"]) == 2
