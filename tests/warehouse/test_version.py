"""`modelgap --version` names the commit, from git or from the wheel."""

import re

from flows.cli import main
from warehouse.provenance import ROOT, commit, git


def test_a_checkout_says_the_commit_of_git(capsys):
    assert main(["--version"]) == 0
    shown = capsys.readouterr().out.strip()
    head = git(ROOT, "rev-parse", "HEAD").decode().strip()
    assert re.fullmatch(rf"\S+ \(commit {head[:12]}\)", shown)


def test_elsewhere_the_file_of_the_wheel_says_it(tmp_path):
    built = tmp_path / "commit.txt"
    assert commit(tmp_path, built) is None
    built.write_text("", encoding="ascii")
    assert commit(tmp_path, built) is None
    built.write_text("abc123+\n", encoding="ascii")
    assert commit(tmp_path, built) == "abc123+"
