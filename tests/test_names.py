"""Public names keep to the glossary of CONTRIBUTING.md."""

import ast
import re
from collections import Counter
from collections.abc import Iterator
from functools import cache

from tests.checkout import ROOMS, ROOT, nodes, sources

FILES = [*sources(*ROOMS), ROOT / "modelgap.py"]
TEXT = " ".join((ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8").split())
_LISTED, _, _GENERAL = TEXT.partition("is exactly one of: ")[2].partition(". ")
BANNED = set(_LISTED.split(", "))
ONE_CLASS = set(re.findall(r"`(\w+)`", _GENERAL.partition(" name one class")[0]))
# What surface.json holds (options, keys, columns) keeps its name.
EXEMPT = {
    "Splits.found",  # verdict: evidence.splits.found
    "Diagnose.known",  # --known
    "Check.known",
    "Monitor.good",  # key of stored requests
}


@cache
def _public() -> list[str]:
    """Every public name of the product, once for each place."""
    names = [path.stem for path in FILES]
    for path in FILES:
        names += _members(nodes(path)[0].body, "")
    return names


def _members(body: list[ast.stmt], owner: str) -> Iterator[str]:
    for node in body:
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            yield f"{owner}{node.name}"
        elif isinstance(node, ast.ClassDef):
            yield node.name
            yield from _members(node.body, f"{node.name}.")
        elif owner and isinstance(node, ast.AnnAssign):
            yield f"{owner}{ast.unparse(node.target)}"


def test_no_public_name_is_a_word_of_the_list():
    assert "found" in BANNED
    found = {n for n in _public() if n.rpartition(".")[2].lower() in BANNED}
    assert found == EXEMPT, "see the glossary of CONTRIBUTING.md"


def test_a_general_name_has_one_class():
    assert "Table" in ONE_CLASS
    names = Counter(_public())
    assert {n for n in ONE_CLASS if names[n] > 1} == set(), "see the glossary"
