"""The house rules that a reader relies on, checked on the source text itself.

import-linter holds the directions of imports (make lint).
"""

import ast
import re
import subprocess
import sys
import tomllib
from functools import cache
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

from residual.effects import load_effects
from tests.checkout import ROOMS, ROOT, nodes, sources


def _is_bag(annotation: ast.expr, aliases: dict[str, ast.expr]) -> bool:
    """Whether a parameter is a tuple of unlike or unsaid things, or a row of three.

    A tuple of like things is a vector, one with ``...`` a sequence, and pairs within a
    collection are keys with what belongs to them; all else has names: arguments, or a
    record.
    """
    if ast.unparse(annotation) == "tuple":
        return True
    for node in ast.walk(annotation):
        own = aliases.get(getattr(node, "id", ""), node)
        if not (isinstance(own, ast.Subscript) and ast.unparse(own.value) == "tuple"):
            continue
        kinds = getattr(own.slice, "elts", [own.slice])
        unlike = len({ast.unparse(kind) for kind in kinds}) > 1
        row = node is annotation or isinstance(annotation, ast.BinOp) or len(kinds) > 2
        if unlike and row and "..." not in map(ast.unparse, kinds):
            return True
    return False


# Strings that are an effect's name by chance: (file, string) and what they are there.
HOMONYMS = {
    ("residual/check/result.py", "delay"): "a fault of a log, of the same nature",
    ("residual/drive.py", "delay"): "of the goal of a drive",
    ("residual/check/drive_chain.py", "delay"): "the same, searched",
    ("residual/robot/files.py", "offset"): "of a joint that follows another one",
    ("residual/robot/urdf.py", "offset"): "the same as a URDF has it",
    ("residual/model/evaluate.py", "offset"): "the constant of a look-up model",
    ("residual/model/lookup.py", "offset"): "the same in its record and its files",
}
NAMED_BY_FILES = ("residual/effects/", "sim/effects/")


def _name(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


@cache
def _imports(path: Path) -> set[str]:
    """Return the dotted names that a file imports, at its top or inside a function."""
    found = set()
    for node in nodes(path):
        if isinstance(node, ast.Import | ast.ImportFrom):
            found |= _imported(path, node)
    return found


def _imported(path: Path, node: ast.Import | ast.ImportFrom) -> set[str]:
    if isinstance(node, ast.Import):
        return {alias.name for alias in node.names}
    package = path.relative_to(ROOT).parent.parts
    base = ".".join(package[: len(package) - node.level + 1]) if node.level else ""
    module = ".".join(part for part in (base, node.module) if part)
    # `from residual import robot` names a folder, `from residual.robot import x` what
    # is in it: the longer name tells both apart once it is cut by _within.
    return {f"{module}.{alias.name}" for alias in node.names}


def _within(name: str, allowed: set[str]) -> bool:
    return any(name == a or name.startswith(a + ".") for a in allowed)


def _modules() -> dict[str, Path]:
    files = [*sources(*ROOMS), *ROOT.glob("modelgap.py")]
    dotted = (_name(path).removesuffix(".py").replace("/", ".") for path in files)
    return {n.removesuffix(".__init__"): p for n, p in zip(dotted, files, strict=True)}


@cache
def _edges() -> dict[str, set[str]]:
    """Return which modules of the product each of them imports, early or late."""
    known = _modules()

    def module(name: str) -> str | None:
        # `from residual import robot` names a module, `from x import f` what is in it.
        return next((n for n in (name, name.rpartition(".")[0]) if n in known), None)

    found = {n: {module(each) for each in _imports(p)} for n, p in known.items()}
    return {name: others - {None, name} for name, others in found.items()}


def test_no_modules_import_each_other_in_a_circle():
    try:
        TopologicalSorter(_edges()).prepare()
    except CycleError as error:
        pytest.fail(" -> ".join(error.args[1]))


def _floor(module: str, package: str) -> str | None:
    """Return on which floor of a package a module stands, None where on none of it.

    Every sub-folder is a floor, and the package's own modules together are one. Its
    ``__init__`` is its door, which stands on none: the circles of modules hold it.
    """
    if not module.startswith(f"{package}."):
        return None
    first = module.removeprefix(f"{package}.").split(".")[0]
    is_folder = (ROOT / package.replace(".", "/") / first).is_dir()
    return first if is_folder else "its own modules"


def _floors_below(package: str) -> dict[str, set[str]]:
    found: dict[str, set[str]] = {}
    for module, others in _edges().items():
        above = _floor(module, package)
        below = {_floor(other, package) for other in others if above}
        found.setdefault(above or "", set()).update(below - {None, above})
    return found


@pytest.mark.parametrize(
    "package", sorted({_name(p.parent).replace("/", ".") for p in sources(*ROOMS)})
)
def test_no_folders_import_each_other_in_a_circle(package):
    try:
        TopologicalSorter(_floors_below(package)).prepare()
    except CycleError as error:
        pytest.fail(" -> ".join(error.args[1]))


def _settings() -> dict:
    text = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    return tomllib.loads(text)["tool"]


def _late_imports() -> set[tuple[str, str]]:
    return {
        (_name(path), name)
        for path in _modules().values()
        for function in nodes(path)
        if isinstance(function, ast.FunctionDef | ast.AsyncFunctionDef)
        for node in ast.walk(function)
        if isinstance(node, ast.Import | ast.ImportFrom)
        for name in _imported(path, node)
    }


def test_imports_stand_at_the_top_of_a_file_but_for_those_that_are_listed():
    listed = _settings()["modelgap"]["late-imports"]
    late = _late_imports()
    assert [e for e in late if not _within(e[1], set(listed.get(e[0], ())))] == []
    unused = [
        (file, name)
        for file, names in listed.items()
        for name in names
        if not any(f == file and _within(n, {name}) for f, n in late)
    ]
    assert unused == []


# What a package is imported as, where that is not its name; "" for one that is not: a
# bound on what Prefect brings, and a script that pages read as a file.
IMPORTED = {"scikit-learn": "sklearn", "pin": "pinocchio", "pyyaml": "yaml"}
IMPORTED |= dict.fromkeys(("fastapi", "sqlalchemy", "plotly"), "")


def test_a_file_of_the_product_imports_each_package_that_is_installed():
    text = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    listed = tomllib.loads(text)["project"]["dependencies"]
    names = [re.match(r"[\w-]+", line)[0] for line in listed]
    roots = {n.partition(".")[0] for p in sources(*ROOMS) for n in _imports(p)}
    packages = [IMPORTED.get(name, name).replace("-", "_") for name in names]
    assert [name for name in packages if name and name not in roots] == []


# What a program loads that runs some code, and what of it must not be there.
LOADED = {
    "a typing error": (
        "import " + ", ".join(f"flows.cli.{p.stem}" for p in (ROOT / "flows/cli").glob("*.py")),
        {"numpy", "pyarrow", "duckdb", "pinocchio", "prefect"},
    ),
    "a verdict": (
        "import residual.verdict.document",
        {"scipy", "pinocchio", "numba", "residual.effects"},
    ),
    "a printed verdict": (
        "import flows.report.diagnosis; from residual.effects import find_effect; "
        "find_effect('payload'), find_effect('coulomb')",
        {"scipy", "pinocchio", "numba", "jinja2", "residual.effects.viscous"},
    ),
    "the help page": (
        "from flows.cli import main; main(['--help'])",
        {"cyclopts.completion", "difflib", "rich.progress", "threadpoolctl", "numpy", "tomllib"},
    ),
    "the steps": (
        "import flows.steps.fit, flows.steps.diagnose, flows.steps.imports, "
        "flows.steps.experiment, flows.report.models",
        {"prefect", "pybullet", "cvxpy"},
    ),
    "a query": (
        "import flows.report.records, warehouse.queries",
        {"pinocchio", "pyarrow.compute", "pydantic"},
    ),
}


@pytest.mark.parametrize("what", LOADED)
def test_nothing_is_loaded_that_is_not_used(what):
    code, slow = LOADED[what]
    code += f"\nimport sys; print({slow!r} & set(sys.modules), file=sys.stderr)"
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True)
    assert done.stderr == "set()\n"


def test_a_diagnosis_is_shown_by_few_modules():
    code = (
        "import sys; import flows.cli.store, flows.report.diagnosis, warehouse.queries; "
        "import residual.verdict.document; from residual.effects import find_effect; "
        f"find_effect('payload'); print(sum(n.split('.')[0] in {ROOMS!r} for n in sys.modules))"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True)
    assert int(done.stdout) <= 40


def _strings(path: Path) -> set[str]:
    """Return the string constants of a file, docstrings left out."""
    docs = {
        id(node.body[0].value)
        for node in nodes(path)
        if isinstance(node, (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef))
        and ast.get_docstring(node) is not None
    }
    return {
        node.value
        for node in nodes(path)
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in docs
    }


def test_no_effect_is_named_outside_its_file():
    product = [*sources(*ROOMS), *ROOT.glob("modelgap.py")]
    named = {
        (_name(path), text)
        for path in product
        if not _name(path).startswith(NAMED_BY_FILES)
        for text in _strings(path) & set(load_effects())
    }
    assert named == set(HOMONYMS)
    assert len(HOMONYMS) <= 10


def _pages() -> list[Path]:
    """Return every text that somebody wrote and reads: no data, locks or licence."""
    kinds = {".py", ".sh", ".md", ".toml", ".sql", ".html", ".css", ".js", ".ipynb"}
    folders = (*ROOMS, "tests", "benchmarks", "docs", "examples", "scripts", ".ci")
    inside = [p for f in folders for p in (ROOT / f).rglob("*")]
    top = [p for p in ROOT.iterdir() if p.suffix in {".md", ".toml", ".py"}]
    other = [ROOT / "Makefile", ROOT / ".ci" / "run"]
    return sorted({p for p in inside + top if p.suffix in kinds} | set(other))


# Written in pieces, so that this file does not find itself.
MACHINE = re.compile(
    r"(?<![\w.~/-])/(?:home|work|root|opt|Users)" + r"/\w"
    "|" + "pypi" + r"\.(?:org|python)|python" + "hosted" + r"|/simp" + "le/"
    "|" + "--(?:extra-)?ind" + "ex-url|--find-" + "links"
)


def test_no_text_holds_a_path_of_one_machine_or_the_address_of_an_index():
    wrong = [
        f"{_name(p)}:{number}: {line.strip()[:80]}"
        for p in [*_pages(), *ROOT.glob("*.lock")]
        for number, line in enumerate(p.read_text(encoding="utf-8").splitlines(), 1)
        if MACHINE.search(line)
    ]
    assert wrong == []


def test_every_folder_with_code_is_a_package_and_tests_are_not():
    bare = [
        _name(folder)
        for folder in {path.parent for path in sources(*ROOMS)}
        if not (folder / "__init__.py").is_file()
    ]
    assert bare == []
    assert list((ROOT / "tests").rglob("__init__.py")) == []


def test_no_parameter_is_a_bag_of_unlike_things():
    wrong = []
    for path in _modules().values():
        aliases = {
            target.id: node.value
            for node in nodes(path)[0].body
            if isinstance(node, ast.Assign)
            for target in node.targets
            if isinstance(target, ast.Name)
        }
        for node in nodes(path):
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                every = node.args.posonlyargs + node.args.args + node.args.kwonlyargs
                wrong += [
                    f"{_name(path)}:{arg.lineno} {node.name}({arg.arg})"
                    for arg in every
                    if arg.annotation and _is_bag(arg.annotation, aliases)
                ]
    assert wrong == []


def test_each_fault_of_the_mutation_check_has_one_place():
    faults = tomllib.loads((ROOT / "tests" / "mutations.toml").read_text("utf-8"))["faults"]
    counts = {text: (ROOT / file).read_text("utf-8").count(text) for file, text, _ in faults}
    assert {text: count for text, count in counts.items() if count != 1} == {}
