"""A short loop on an arm in the engine, killed once between its work and its record."""

import pytest

from flows.report.closed import render
from flows.steps.closing import close
from flows.steps.closing.arm import Close
from warehouse.layout import list_folders
from warehouse.numbered import adopted, read_decisions

pytestmark = [pytest.mark.slow, pytest.mark.long]


class KilledError(Exception):
    """In place of a kill."""


def _dies(*_):
    raise KilledError


def test_an_arm_with_one_effect_comes_to_its_model(
    tmp_path, monkeypatch, compiled_plant
):
    asked = Close("irb140", 3, seed=5, effects=1, seconds=10.0, store=tmp_path)
    close.decided(close.begun(asked))
    with monkeypatch.context() as patch:
        patch.setattr(close, "commit_decision", _dies)
        with pytest.raises(KilledError):
            close.decided(close.begun(asked))
    assert len(list_folders(tmp_path, "runs")) == 2
    done = close.close(asked)
    assert len(list_folders(tmp_path, "runs")) == 3  # what was stored is not run again
    assert done.decisions == read_decisions(tmp_path, done.loop)
    assert [d.number for d in done.decisions] == list(range(1, len(done.decisions) + 1))
    (hidden,) = done.hidden
    given = done.known.adopted
    # What is adopted is the arm's own, and the next experiment is driven by it.
    assert given["effects"] == [f"{hidden['name']} on joint {hidden['joints'][0]}"]
    _, record = adopted(tmp_path, "irb140", "close-5-1")
    assert record.diagnosis_id == given["diagnosis"]
    assert adopted(tmp_path, "irb140") is None
    assert done.known.runs[-1].result["controller"] == given["diagnosis"]
    drive = next(d for d in done.decisions if d.action == "drive")
    assert drive.result["after"] < drive.result["before"]
    verdict = close.adopted_verdict(tmp_path, given)
    assert "1 of 1 hidden effects adopted" in render(done, verdict)
