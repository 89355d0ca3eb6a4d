"""The set-up says what it does, and does what the README says."""

import re
import shutil
import subprocess
import tomllib

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from tests.checkout import ROOT

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
OPTIONAL = PROJECT["project"]["optional-dependencies"]


def _text(name: str) -> str:
    return (ROOT / name).read_text(encoding="utf-8")


def _pins(lock: str) -> dict[str, str]:
    return dict(re.findall(r"^([\w.-]+)==(\S+)(?: ;.*)? \\$", _text(lock), re.M))


@pytest.mark.parametrize(
    ("lock", "extras"),
    [("requirements.lock", ()), ("requirements-dev.lock", sorted(OPTIONAL.keys() - {"all"}))],
)
def test_a_lock_pins_every_dependency_inside_its_declared_range(lock, extras):
    pins = _pins(lock)
    groups = PROJECT["dependency-groups"]
    texts = [*PROJECT["project"]["dependencies"], *groups["build"]]
    texts += [text for extra in extras for text in OPTIONAL[extra]]
    for want in map(Requirement, texts):
        pin = pins.get(canonicalize_name(want.name))
        assert pin, f"{lock} lacks {want.name}: make lock"
        assert want.specifier.contains(pin, prereleases=True), f"{want} but {pin}"


def test_what_is_tested_is_what_a_user_gets():
    core, dev = _pins("requirements.lock"), _pins("requirements-dev.lock")
    assert core.items() <= dev.items()


@pytest.mark.parametrize("lock", ["requirements.lock", "requirements-dev.lock"])
def test_every_pin_has_hashes_and_no_package_depends_on_an_address(lock):
    blocks = re.split(r"^(?=[\w.-]+==)", _text(lock), flags=re.M)
    entries = [block for block in blocks if "==" in block]
    assert len(entries) == len(_pins(lock))
    assert all("--hash=sha256:" in entry for entry in entries)
    assert not re.search(r"^[^#]*(?:://| @ |^-)", _text(lock), re.M)


@pytest.mark.parametrize("page", ["README.md", "CONTRIBUTING.md", ".ci/run"])
def test_every_make_command_that_a_page_names_exists(page):
    named = set(re.findall(r"^\s*(?:`|\$ )?make ([a-z-]+)", _text(page), re.M))
    named |= set(re.findall(r"`make ([a-z-]+)`", _text(page)))
    targets = re.findall(r"^([a-z][a-z -]*):", _text("Makefile"), re.M)
    assert named
    assert named <= set(" ".join(targets).split())


def test_the_changelog_knows_the_version_of_pyproject():
    version = PROJECT["project"]["version"]
    entries = re.findall(r"^## \[([^\]]+)\]", _text("CHANGELOG.md"), re.M)
    assert version in entries[:2]


@pytest.fixture
def bare_machine(tmp_path):
    """A copy of the set-up and a PATH with a shell but without any Python."""
    (tmp_path / "bin").mkdir()
    for name in ("bash", "dirname", "uname", "grep", "env", "rm"):
        (tmp_path / "bin" / name).symlink_to(shutil.which(name))
    (tmp_path / "scripts").mkdir()
    shutil.copy(ROOT / "scripts" / "setup.sh", tmp_path / "scripts")
    return tmp_path


SHIMS = {
    "python3.11": "echo 'no such version' >&2; exit 127",
    "python3": "[ $1 = -V ] && echo Python 3.9.2 || exit 1",
}
UV = "echo uv was called: $* >&2; exit 9"
LACKING = [
    ({}, ("Python 3.11 to 3.13 with venv is needed; found: none.", "apt install")),
    # A shim that only complains is not taken for Python.
    (SHIMS, ("found: Python 3.9.2.",)),
    ({"uv": UV}, ("--python 3.11 --seed", "uv could not bring Python 3.11")),
    # 3.13 without a compiler: the test's answer to what setup.sh asks of a Python.
    (
        {"python3.13": "[ $1 = -V ] && echo Python 3.13.5 || [[ $2 == *3.13* ]]"},
        ("no wheel for Python 3.13.5", "g++"),
    ),
    ({"uname": "echo Darwin arm64"}, ("Linux on x86_64 is needed",)),
]


@pytest.mark.parametrize(("programs", "said"), LACKING)
def test_the_set_up_says_what_it_lacks_and_makes_nothing(bare_machine, programs, said):
    for name, script in programs.items():
        path = bare_machine / "bin" / name
        path.unlink(missing_ok=True)
        path.write_text(f"#!/usr/bin/env bash\n{script}\n", encoding="utf-8")
        path.chmod(0o755)
    done = subprocess.run(
        ["bash", "scripts/setup.sh", "requirements.lock"],
        cwd=bare_machine,
        env={"PATH": str(bare_machine / "bin")},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 1
    assert [words for words in said if words not in done.stderr] == []
    assert len(done.stderr.splitlines()) <= 3
    assert not (bare_machine / ".venv").exists()
