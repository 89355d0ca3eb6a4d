"""The history of flow runs in PostgreSQL: a server of the Debian package, and ours."""

import os
import subprocess
from pathlib import Path

import pytest

from flows.cli import main
from tests.flows.prefect_server import free_port

PROGRAMS = sorted(Path("/usr/lib/postgresql").glob("*/bin/initdb"))

pytestmark = [
    pytest.mark.prefect,
    pytest.mark.slow,
    pytest.mark.long,
    pytest.mark.skipif(not PROGRAMS, reason="no PostgreSQL (apt install postgresql)"),
]


@pytest.fixture
def database(tmp_path_factory):
    folder, port = tmp_path_factory.mktemp("database"), str(free_port())
    # It refuses to run as the administrator.
    other = ["runuser", "-u", "postgres", "--"] if os.getuid() == 0 else []
    if other:
        for place in (folder, *folder.parents[:2]):
            place.chmod(0o755)
        subprocess.run(["chown", "postgres", folder], check=True)

    def ask(name: str, *words: str) -> None:
        command = [*other, PROGRAMS[-1].with_name(name), *words]
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL, cwd="/")

    data, log = str(folder / "data"), str(folder / "log")
    ask("initdb", "-D", data, "-U", "modelgap", "-A", "trust")
    options = f"-p {port} -k {folder} -c listen_addresses=127.0.0.1"
    ask("pg_ctl", "-D", data, "-l", log, "-o", options, "-t", "300", "start")
    ask("createdb", "-h", "127.0.0.1", "-p", port, "-U", "modelgap", "history")
    yield f"postgresql://modelgap:secret@127.0.0.1:{port}/history"
    ask("pg_ctl", "-D", data, "-m", "immediate", "-t", "300", "stop")


def test_up_status_and_down_with_a_history_in_postgresql(database, tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("MODELGAP_DATABASE_URL", database)
    words = ["--store", str(tmp_path / "store")]
    try:
        assert main(["up", "--port", str(free_port()), *words]) == 0
        assert main(["status", *words]) == 0
        output = capsys.readouterr().out
        assert f"history: postgresql://{database.rpartition('@')[2]}" in output
        assert "nightly/nightly" in output
        assert "secret" not in output
    finally:
        assert main(["down", "--wait", "0", *words]) == 0
    assert not list((tmp_path / "store" / "_prefect").glob("*.db"))
