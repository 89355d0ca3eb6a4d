"""Completion by the shell itself: bash, zsh and fish, where they are installed."""

import os
import pty
import select
import shutil
import subprocess
import time

import pytest

from flows.cli import main
from tests.waiting import PATIENCE

SHELLS = [
    pytest.param(shell, marks=pytest.mark.skipif(not shutil.which(shell), reason=f"no {shell}"))
    for shell in ("bash", "zsh", "fish")
]
RUN, OTHER = "1f0c2d9b5e7a4c6d8f90", "a2" * 10
# What is typed, and what must then stand in the line or in the list below it.
LINES = {
    "modelgap diag": "diagnose",
    "modelgap sho": "show",
    "modelgap store qua": "quarantine",
    "modelgap diagnose --save": "--save-model",
    "modelgap diagnose my_l": "my_log.csv",
    "modelgap diagnose my_log.csv --robot irb": "irb140",
    "modelgap runs --format par": "parquet",
    "modelgap map my_log.csv --map my_l": "my_log.csv",
    "modelgap show 1f": RUN,
    "modelgap adopt --store other a": OTHER,
}


@pytest.fixture
def home(tmp_path, monkeypatch):
    """A home with a log, two stores, and a program and a Python that must not start."""
    for place in (
        f"store/samples/robot=a/run_id={RUN}",
        f"other/diagnoses/diagnosis_id={OTHER}",
        "bin",
    ):
        (tmp_path / place).mkdir(parents=True)
    (tmp_path / "my_log.csv").write_text("t,q1,tau1\n")
    for name in ("modelgap", "python", "python3"):
        program = tmp_path / "bin" / name
        program.write_text(f"#!/bin/sh\ntouch '{tmp_path}/started'\n")
        program.chmod(0o755)
    monkeypatch.setenv("HOME", str(tmp_path))
    for name in ("MODELGAP_STORE", "ZDOTDIR", "ZSH", "ZSH_CUSTOM", "XDG_CONFIG_HOME"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("PATH", f"{tmp_path}/bin:/usr/bin:/bin")
    monkeypatch.setenv("TERM", "dumb")
    monkeypatch.setenv("LC_ALL", "C.UTF-8")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def complete_in_terminal(shell, line, expected):
    """Type a line and two tabs at a prompt; return what is shown once it is there."""
    terminal, ours = pty.openpty()
    process = subprocess.Popen(
        [shell, "-i"], stdin=ours, stdout=ours, stderr=ours, start_new_session=True
    )
    os.close(ours)
    shown = ""

    def read_until(text):
        nonlocal shown
        until = time.monotonic() + PATIENCE
        while text not in shown and time.monotonic() < until:
            if select.select([terminal], [], [], 1.0)[0]:
                shown += os.read(terminal, 4096).decode().replace("\a", "")
        return shown

    try:
        read_until("READY")
        shown = ""
        os.write(terminal, f"{line}\t\t".encode())
        return read_until(expected)
    finally:
        process.kill()
        process.wait()
        os.close(terminal)


@pytest.mark.parametrize("shell", SHELLS)
def test_a_tab_completes_words_files_and_ids_and_starts_no_python(home, shell, capsys):
    assert main(["--install-completion", "--shell", shell]) == 0
    if shell == "zsh":
        with (home / ".zshrc").open("a") as file:
            file.write("autoload -Uz compinit && compinit -u\n")
    for name in (".bashrc", ".zshrc"):
        with (home / name).open("a") as file:
            file.write("PS1='READY> '\n")
    for line, expected in LINES.items():
        if shell == "fish":
            command = ["fish", "-c", f"complete -C '{line}'"]
            shown = subprocess.run(command, capture_output=True, text=True).stdout
        else:
            shown = complete_in_terminal(shell, line, expected)
        assert expected in shown, line
    assert not (home / "started").exists()
