"""The foot of a page: where what it shows comes from."""

import pytest

from flows.report.page import origin_of_record
from warehouse.commit import commit_record

RUN, HELD = "ab" * 10, "cd" * 10


@pytest.fixture
def diagnosis(tmp_path):
    record = {"robot": "irb140", "verdict": "none", "model_id": "ee" * 10}
    parents = {"fit": [RUN, "bc" * 10], "held_out": [HELD]}
    return commit_record(tmp_path, "diagnoses", record, None, parents)


def test_it_says_id_time_version_commit_data_and_what_makes_it_again(
    tmp_path, diagnosis
):
    foot = dict(origin_of_record(tmp_path, diagnosis[:6]))
    assert diagnosis in foot["Diagnosis"]
    assert all(run in foot["Fit"] for run in (RUN, "bc" * 10))
    assert HELD in foot["Held out"]
    assert f"modelgap rerun {diagnosis}" in foot["Command"]
    assert foot["Stored"].startswith("20")
    assert foot["Program"].startswith("modelgap ")
