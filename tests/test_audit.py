"""What `make audit` makes of an answer, and of none; nobody is asked here."""

import importlib.util
import json
import subprocess
from email.message import Message
from pathlib import Path
from types import SimpleNamespace

import pytest

_FILE = Path(__file__).parents[1] / "scripts" / "audit.py"
_SPEC = importlib.util.spec_from_file_location("audit", _FILE)
audit = importlib.util.module_from_spec(_SPEC)
_SPEC.loader.exec_module(audit)

GOOD = {"name": "good", "version": "1.0", "vulns": []}
FLAW = {"id": "PYSEC-1", "fix_versions": ["2.1"], "aliases": []}
BAD = {"name": "bad", "version": "2.0", "vulns": [FLAW]}
SKIPPED = {"name": "odd", "skip_reason": "not on the index"}


def answer(*packages, text=None, error=""):
    out = json.dumps({"dependencies": packages}) if text is None else text
    return lambda *words, **how: SimpleNamespace(stdout=out, stderr=error)


def never(*words, **how):
    raise subprocess.TimeoutExpired("pip-audit", 1)


def test_a_known_one_is_named_with_its_mend_and_else_nothing_is_known():
    code, lines = audit.audit(Path("x.lock"), answer(GOOD))
    assert (code, lines) == (0, ["1 packages asked for, 0 known vulnerabilities"])
    code, lines = audit.audit(Path("x.lock"), answer(GOOD, BAD, SKIPPED))
    assert (code, lines[0]) == (1, "bad 2.0: PYSEC-1, mended in 2.1")


LOST = answer(text="", error="ConnectionError: no route")


@pytest.mark.parametrize(
    "run", [LOST, answer(text="[]"), answer(GOOD, SKIPPED), answer(), never]
)
def test_no_answer_is_not_a_clean_one(run):
    code, lines = audit.audit(Path("x.lock"), run)
    assert code == 3
    assert "NOT CHECKED" in lines[-1]


def package(name, **fields):
    about = Message()
    about["Name"] = name
    for key, value in fields.items():
        about[key.replace("_", "-")] = value
    return SimpleNamespace(metadata=about)


def test_licences_to_look_at_are_marked():
    installed = [
        package("a", License_Expression="MIT"),
        package("b", Classifier="License :: OSI Approved :: MIT License"),
        package("c", License_Expression="MIT AND LGPL-2.1"),
        package("d", License="The text of a licence\nof many lines"),
        package("e"),
    ]
    assert audit.licences(installed) == [
        "  MIT: a",
        "! MIT AND LGPL-2.1: c",
        "  MIT License: b",
        "! The text of a licence: d",
        "! not stated: e",
    ]
