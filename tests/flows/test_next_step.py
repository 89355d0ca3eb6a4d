"""After a verdict: what to do next, and how often the arm's diagnoses had a name."""

import copy

import pytest

from flows.cli import app
from flows.report.diagnosis import describe_next_step
from flows.report.store_index import describe_name_records
from residual.verdict.result import Place
from tests.flows import report_outcomes as outcomes
from tests.warehouse import store_samples as samples


@pytest.mark.parametrize("name", outcomes.ALL)
def test_every_verdict_ends_with_one_command_of_the_program(name):
    words, line = describe_next_step(outcomes.ALL[name]().verdict)
    program, command, *rest = line.split()
    assert program == "modelgap"
    assert words
    assert "\n" not in f"{words}{line}"
    options = {n for a in app[command].assemble_argument_collection() for n in a.names}
    assert {word for word in rest if word.startswith("--")} <= options


def test_the_record_of_a_name_counts_diagnoses_of_other_runs_up_to_this_one(tmp_path):
    runs = [samples.commit(tmp_path, seed, "fourier") for seed in range(4)]

    def diagnose(fit, names):
        document = copy.deepcopy(samples.verdict(runs[3:]))
        document["effects"] = [e for e in document["effects"] if e["name"] in names]
        model = {"theta": [1.0], "effects": [], "of": [fit, sorted(names)]}
        return samples.store_verdict(tmp_path, document, model, [runs[fit], runs[3]])

    both = [Place("payload", (2,)), Place("coulomb", (1,))]
    first = diagnose(0, {"payload"})
    assert "first stored diagnosis" in describe_name_records(tmp_path, first, both)[0]
    diagnose(1, {"payload", "coulomb"})
    again = diagnose(1, {"coulomb"})  # the same run: counts instead of the one before
    payload, coulomb = describe_name_records(tmp_path, again, both)
    assert "named in 1 of the last 2 stored diagnoses" in payload
    assert "named in 1 of the last 2 stored diagnoses" in coulomb
    later = diagnose(2, {"payload"})
    payload, coulomb = describe_name_records(tmp_path, later, both)
    assert "named in 2 of the last 3" in payload
    assert "named in 1 of the last 3" in coulomb
    assert "first stored" in describe_name_records(tmp_path, first, both)[0]
