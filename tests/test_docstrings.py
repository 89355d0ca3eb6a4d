"""What a docstring or a comment of the product refers to exists."""

import ast
import builtins
import re
from collections.abc import Iterator
from pathlib import Path

from tests.checkout import ROOMS, ROOT, nodes, sources

# Of other programs: functions of C, keys of a spec, the prefix of effects without name.
FOREIGN = re.compile(r"f(abs|min|max)|sgn|x_\.\.\.|plant\.effect\.2\.level|mg\.\w+")
DOCUMENTED = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)


# Where a node of each kind has a name.
FIELDS = {
    **dict.fromkeys((ast.FunctionDef, ast.ClassDef, ast.alias), "name"),
    **dict.fromkeys((ast.arg, ast.keyword), "arg"),
    **{ast.Name: "id", ast.Attribute: "attr", ast.ImportFrom: "module"},
}


def _names() -> set[str]:
    """Return every word that the code of the product uses, and short strings."""
    names = set(dir(builtins))
    for path in sources(*ROOMS):
        names |= set(path.relative_to(ROOT).with_suffix("").parts)
        for node in nodes(path):
            if isinstance(node, ast.Constant) and isinstance(node.value, str):
                names.add(node.value[:60])
            if (field := FIELDS.get(type(node))) and (word := getattr(node, field)):
                names.update(word.split("."))
    return names


def _prose(path: Path) -> Iterator[str]:
    for node in nodes(path):
        if isinstance(node, DOCUMENTED):
            yield ast.get_docstring(node, clean=False) or ""
    yield from re.findall(r"# .*", path.read_text("utf-8"))


def test_a_name_in_backticks_exists():
    names, broken = _names(), []
    for path in sources(*ROOMS):
        for text in _prose(path):
            plain = re.sub(r"```.*?```", "", text, flags=re.S)
            for name in re.findall(r"`([A-Za-z_][\w.]*)(?:\(\))?`", plain):
                parts = [name] if name in names else name.split(".")
                is_file = (ROOT / name).exists() or FOREIGN.fullmatch(name)
                if not is_file and not all(part in names for part in parts if part):
                    broken.append(f"{path.relative_to(ROOT)}: {name}")
    assert broken == []


def _documented(node: ast.AST) -> tuple[str, set[str]] | None:
    """Return the section that lists the names of a definition, and these names."""
    if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
        return "Args", {n.arg for n in ast.walk(node.args) if isinstance(n, ast.arg)}
    if not isinstance(node, ast.ClassDef):
        return None
    known = {n.attr for n in ast.walk(node) if isinstance(n, ast.Attribute)}
    for item in node.body:
        if isinstance(item, ast.AnnAssign) and isinstance(item.target, ast.Name):
            known.add(item.target.id)
        known |= {item.name} if isinstance(item, ast.FunctionDef) else set()
    return "Attributes", known


def test_each_argument_and_attribute_that_is_explained_exists():
    broken = []
    for path in sources(*ROOMS):
        for node in nodes(path):
            if (own := _documented(node)) is None:
                continue
            section, known = own
            text = ast.get_docstring(node) or ""
            found = re.search(rf"^{section}:\n((?: {{4}}.*\n?|\n)+)", text, re.M)
            lines = found[1].splitlines() if found else ()
            listed = (re.match(r" {4}\*{0,2}(\w+(?:, \w+)*):", line) for line in lines)
            words = {w for match in listed if match for w in match[1].split(", ")}
            broken += [f"{path.name}: {node.name}: {w}" for w in sorted(words - known)]
    assert broken == []
