"""Public names keep to the glossary of CONTRIBUTING.md."""

import ast
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

from tests.checkout import ROOT

FOLDERS = ("residual", "sim", "warehouse", "flows")
FILES = [p for f in FOLDERS for p in sorted((ROOT / f).rglob("*.py"))]
FILES.append(ROOT / "modelgap.py")
BANNED = {
    *("told", "said", "asked", "wanted", "own", "found", "made", "known", "given"),
    *("came", "left", "here", "usual", "whole", "good", "nobody"),
}
ONE_CLASS = {"Rows", "Rules", "Table", "State", "Change", "Rest", "Motion"}
# What surface.json holds (options, keys, columns) keeps its name.
EXEMPT = {
    "Splits.found",  # verdict: evidence.splits.found
    "Diagnose.known",  # --known
    "Monitor.good",  # key of stored requests
}


def _public(path: Path) -> Iterator[str]:
    """Module, class, function, method and field names, fields as Class.field."""
    yield path.stem
    yield from _members(ast.parse(path.read_text(encoding="utf-8")).body, "")


def _members(body: list[ast.stmt], owner: str) -> Iterator[str]:
    for node in body:
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            yield f"{owner}{node.name}"
        elif isinstance(node, ast.ClassDef):
            yield node.name
            yield from _members(node.body, f"{node.name}.")
        elif owner and isinstance(node, ast.AnnAssign):
            yield f"{owner}{ast.unparse(node.target)}"


def _banned() -> set[str]:
    return {
        name
        for path in FILES
        for name in _public(path)
        if name.rpartition(".")[2].lower() in BANNED and name not in EXEMPT
    }


def _repeated() -> set[str]:
    counts: Counter[str] = Counter()
    for path in FILES:
        nodes = ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        counts.update(n.name for n in nodes if isinstance(n, ast.ClassDef))
    return {name for name in ONE_CLASS if counts[name] > 1}


def test_no_public_name_is_a_word_that_says_nothing():
    assert _banned() == set(), "see the glossary of CONTRIBUTING.md"


def test_a_general_name_has_one_class():
    assert _repeated() == set(), "see the glossary of CONTRIBUTING.md"


def test_no_exception_outlives_its_name():
    named = {name for path in FILES for name in _public(path)}
    assert EXEMPT - named == set()


def test_the_glossary_states_the_words_of_this_test():
    text = " ".join((ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8").split())
    listed = text.partition("is exactly one of: ")[2].partition(".")[0]
    assert set(listed.split(", ")) == BANNED
    general = text.partition(f"{listed}. ")[2].partition(" name one class")[0]
    assert {
        w.strip("`") for w in general.replace(" and ", ", ").split(", ")
    } == ONE_CLASS
