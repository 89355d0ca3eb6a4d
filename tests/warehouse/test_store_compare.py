"""Values side by side: every bit counts, and where they part is said."""

import json

import numpy as np
import pytest

from residual.errors import InputError
from tests.warehouse import store_samples as samples
from warehouse.queries import build_lineage_tree, open_store
from warehouse.store_catalogue import find_record, list_record_ancestry
from warehouse.verification import compare_channels, compare_values
from warehouse.verification import select_differing_channels as differing_channels

T = np.arange(100) / 50


def channels(**changes):
    rng = np.random.default_rng(1)
    return {"t": T, "q": rng.normal(size=(100, 2)), "tau": np.ones((100, 2)), **changes}


def test_where_and_how_far_values_part():
    tau = np.ones((100, 2))
    tau[40:, 1] += 3e-3
    tau[60, 1] -= 8e-3
    (bad,) = differing_channels(compare_channels(channels(), channels(tau=tau)))
    assert (bad.name, bad.unit, bad.differing) == ("tau2", "N m", 60)
    assert bad.first == T[40]
    assert bad.largest == pytest.approx(5e-3)
    assert bad.rms == pytest.approx(np.sqrt((59 * 9e-6 + 25e-6) / 100))
    assert "tau2: differs from 0.8 s on, by at most 0.005 N m" in bad.words


def test_records_are_compared_value_by_value():
    one = {"a": {"b": [1.0, 2.0]}, "c": "x", "same": [{}]}
    changes = compare_values(one, {"a": {"b": [1.0, 2.5]}, "c": None, "same": [{}]})
    assert [(c.name, c.largest) for c in changes] == [("a.b[1]", 0.5), ("c", None)]
    assert compare_values(json.loads("[0.1]"), [0.1]) == []
    assert len(compare_values({"x": 0.0}, {"x": -0.0})) == 1


@pytest.fixture
def store(tmp_path):
    runs = [samples.commit(tmp_path, seed) for seed in range(2)]
    id = samples.store_verdict(tmp_path, samples.verdict([runs[1]]), {"theta": [1]}, runs)
    return tmp_path, runs, id


def test_a_record_comes_after_what_it_was_made_from(store):
    folder, runs, id = store
    kinds = [found.kind for found in list_record_ancestry(folder, id)]
    assert kinds == ["runs", "runs", "models", "diagnoses"]
    with open_store(folder) as opened:
        up = build_lineage_tree(opened, id)
        down = build_lineage_tree(opened, runs[0], down=True)
    assert {each.id for each in up.relatives} >= set(runs)
    assert {each.kind for each in down.relatives} == {"models", "diagnoses"}
    assert len([each for each in down.relatives if each.again]) <= 1


def test_a_lost_parent_is_named(store, tmp_path):
    folder, runs, id = store
    find_record(folder, runs[0]).folder.rename(tmp_path / "gone")
    with pytest.raises(InputError, match=f"made from {runs[0]}, which is not in"):
        list_record_ancestry(folder, id)
    with open_store(folder) as opened:
        kinds = {each.kind for each in build_lineage_tree(opened, id).relatives}
    assert None in kinds
