"""A verdict in the store: rows of effects, errors and lineage."""

import pytest

from residual.errors import InputError
from tests.warehouse import store_samples as samples
from warehouse.store_catalogue import read_record

MODEL = {"theta": [1.0, 2.0], "effects": [{"name": "payload", "joints": [2]}]}


@pytest.fixture
def runs(tmp_path):
    kinds = ("fourier", "welding", "cyclic", "welding")
    return [samples.commit(tmp_path, seed, kind) for seed, kind in enumerate(kinds)]


def ask(store, query):
    return [tuple(row.values()) for row in samples.ask(store, query)]


def test_a_verdict_fills_the_views(tmp_path, runs):
    verdict = samples.verdict([runs[1]])
    id = samples.store_verdict(tmp_path, verdict, MODEL, runs[:2])
    ((robot, said, model, scale, left),) = ask(
        tmp_path, "SELECT robot, verdict, model_id, nominal_scale, unexplained FROM diagnoses"
    )
    assert (robot, said, scale, left) == ("two_link", "effects", 0.03, 0.04)
    assert read_record(tmp_path, id)["document"] == verdict
    stored = read_record(tmp_path, model)
    assert stored == {"robot": "two_link", "stage": "augmented", **MODEL}
    assert ask(tmp_path, "SELECT model_id, stage FROM models") == [(model, "augmented")]
    assert set(ask(tmp_path, "FROM lineage")) == {
        (model, runs[0], "fit"),
        (id, runs[0], "fit"),
        (id, runs[1], "held_out"),
        (id, model, "model"),
    }


def test_a_finding_has_a_row_per_parameter_and_joint_with_its_own_value(tmp_path, runs):
    id = samples.store_verdict(tmp_path, samples.verdict(runs[:1]), MODEL, runs)
    rows = ask(tmp_path, 'FROM effects ORDER BY "order", joints')
    assert rows == [
        (id, 1, "payload", [2], "mass", 2.9, 0.1, "kg", 0.97),
        (id, 2, "coulomb", [1], "level", 1.5, 0.1, "N m", 0.97),
        (id, 2, "coulomb", [2], "level", 2.5, 0.2, "N m", 0.97),
        (id, 3, "delay", [], None, None, None, None, 0.97),
    ]


def test_errors_are_per_joint_and_for_all_joints_together(tmp_path, runs):
    id = samples.store_verdict(tmp_path, samples.verdict([runs[1]]), MODEL, runs)
    rows = ask(
        tmp_path,
        "SELECT run_id, trajectory, joint, stage, metric, value FROM errors "
        f"WHERE source_id = '{id}'",
    )
    assert all(row[:2] == (runs[1], "welding") for row in rows)
    errors = {row[2:5]: row[5] for row in rows}
    # Three metrics for two joints and three stages, two of them for all joints too.
    assert len(errors) == len(rows) == 3 * 2 * 3 + 2 * 3
    assert errors[1, "nominal", "held_out"] == 21.0
    assert errors[2, "augmented", "moving"] == 5.0
    assert errors[None, "identified", "filtered"] == 8.6


def test_a_run_that_is_not_there_is_told_and_nothing_is_stored(tmp_path, runs):
    with pytest.raises(InputError, match="begins with 'ffffffffffff'"):
        samples.store_verdict(tmp_path, samples.verdict(), MODEL, [runs[0], "ffffffffffff"])
    assert ask(tmp_path, "FROM models") == []
