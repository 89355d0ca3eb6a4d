"""The foot of a page: where what it shows comes from."""

import pytest

from flows.report.page import made_of
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
    made = made_of(tmp_path, diagnosis[:6])
    assert (made.what, made.id) == ("diagnosis", diagnosis)
    assert made.data == {"fit": (RUN, "bc" * 10), "held out": (HELD,)}
    assert made.command == f"modelgap rerun {diagnosis}"
    assert made.created.startswith("20")
    foot = " ".join(value for _, value in made.facts)
    for word in (diagnosis, RUN, HELD, made.created, made.version, made.command):
        assert word in foot
