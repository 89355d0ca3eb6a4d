"""What `up`, `status` and `down` decide, without starting a server."""

import os
import signal
import subprocess
import sys
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Thread

import pytest

from flows.cli import main
from flows.service import api, up
from flows.service.state import (
    CLIENT,
    DATABASE,
    SERVER,
    RunningService,
    ServiceRequest,
    build_server_environment,
    build_worker_environment,
    check_request,
    database_url,
    format_database_label,
    is_process_running,
    lock_service,
    read_access_key,
    read_running,
    start_process,
    stop_process,
    write_running,
)
from flows.settings import port_is_free, prefect_home
from residual.errors import InputError, RunError
from tests.waiting import until

SLEEP = [sys.executable, "-c", "import time; time.sleep(600)"]
SECRET = "postgresql://ann:s3cret@db.lab:5432/prefect"
LOCAL = RunningService("127.0.0.1", 4300, "sqlite")
REMOTE = RunningService("127.0.0.1", 4300, format_database_label(SECRET))


@pytest.fixture
def sleeper(tmp_path):
    """A process that holds the place of the server of the store tmp_path."""
    home = prefect_home(tmp_path)
    start_process(home, "server", SLEEP, os.environ)
    yield home
    stop_process(home, "server", grace=1.0)


def test_a_process_is_known_by_its_lock_and_not_by_its_number(sleeper):
    assert is_process_running(sleeper, "server")
    with pytest.raises(RunError, match="already running"):
        start_process(sleeper, "server", SLEEP, os.environ)
    stop_process(sleeper, "server")
    assert not is_process_running(sleeper, "server")
    stop_process(sleeper, "server")  # once more is no error


def test_a_number_that_was_given_to_another_process_is_never_ended(tmp_path):
    other = subprocess.Popen(SLEEP)
    try:
        (tmp_path / "server.pid").write_text(str(other.pid))
        stop_process(tmp_path, "server", grace=0.0)
        assert other.poll() is None
    finally:
        other.kill()
        other.wait()


def test_a_killed_process_lives_no_more_though_its_children_do(tmp_path):
    """A worker's flow processes must not pass for the worker."""
    child = f"import subprocess; subprocess.Popen({SLEEP!r}).wait()"
    start_process(tmp_path, "worker", [sys.executable, "-c", child], os.environ)
    pid = int((tmp_path / "worker.pid").read_text())
    children = Path(f"/proc/{pid}/task/{pid}/children")
    orphan = int(until(lambda: children.read_text().split(), "it has a child")[0])
    os.kill(pid, signal.SIGKILL)
    until(lambda: not is_process_running(tmp_path, "worker"), "it is gone")
    os.kill(orphan, signal.SIGKILL)


@pytest.mark.parametrize("content", ["", "{", "[]", '{"host": 1}'])
def test_a_damaged_note_is_as_good_as_none(tmp_path, content):
    (tmp_path / "up.json").write_text(content)
    assert read_running(tmp_path) is None


def test_two_at_once_on_one_store_are_told_apart(tmp_path):
    with lock_service(tmp_path), pytest.raises(RunError, match="is running on"):  # noqa: SIM117
        with lock_service(tmp_path):
            pass


@pytest.mark.parametrize(
    ("wish", "words"),
    [
        ({"host": "0.0.0.0"}, "--trust-network"),
        ({"host": "lab.example"}, "--trust-network"),
        ({"port": 0}, "expected 1 to 65535"),
        ({"workers": 0}, "expected 1 to 64"),
        ({"every": 3}, "expected 10 seconds"),
        ({"database": "mysql://a:s3cret@b/c"}, "expected postgresql://"),
        ({"database": "postgresql://ann:s3cret@db"}, "expected postgresql://"),
    ],
)
def test_what_cannot_be_or_must_be_said_twice_is_refused(tmp_path, wish, words):
    with pytest.raises(InputError) as caught:
        check_request(ServiceRequest(tmp_path, **wish))
    assert words in str(caught.value)
    assert "s3cret" not in str(caught.value)
    check_request(ServiceRequest(tmp_path, host="0.0.0.0", trust_network=True))
    for host in ("127.0.0.1", "::1", "localhost"):
        check_request(ServiceRequest(tmp_path, host=host))


def test_a_password_goes_to_the_server_and_nowhere_else(tmp_path, monkeypatch):
    monkeypatch.setenv(DATABASE, SECRET)
    running = REMOTE
    server = build_server_environment(running, tmp_path, SECRET)
    with_it = [k for k, v in server.items() if "s3cret" in v]
    assert with_it == ["PREFECT_SERVER_DATABASE_CONNECTION_URL"]
    assert server[with_it[0]] == database_url(SECRET)
    assert database_url(SECRET).startswith("postgresql+asyncpg://ann:s3cret@")
    assert "s3cret" not in str(build_worker_environment(running, tmp_path, tmp_path))
    write_running(tmp_path, running)
    assert "s3cret" not in (tmp_path / "up.json").read_text()
    assert running.database == "postgresql://db.lab:5432/prefect"


def test_the_server_calls_nobody_and_obeys_only_its_own_page(tmp_path, monkeypatch):
    monkeypatch.setenv("PREFECT_SERVER_ANALYTICS_ENABLED", "true")
    env = build_server_environment(LOCAL, tmp_path, None)
    assert env["PREFECT_SERVER_ANALYTICS_ENABLED"] == "false"
    assert env["DO_NOT_TRACK"] == "1"
    assert env["PREFECT_SERVER_UI_API_URL"] == "/api"
    assert env["PREFECT_SERVER_CORS_ALLOWED_ORIGINS"] == "http://127.0.0.1:4300"


def test_the_key_goes_to_server_and_worker_and_is_written_nowhere(tmp_path):
    running, key = LOCAL, read_access_key(tmp_path)
    server = build_server_environment(running, tmp_path, None)
    worker = build_worker_environment(running, tmp_path, tmp_path)
    assert [k for k, v in server.items() if key in v] == [SERVER]
    assert [k for k, v in worker.items() if key in v] == [CLIENT]
    write_running(tmp_path, running)
    assert key not in (tmp_path / "up.json").read_text()
    assert key not in repr(api.Api(running.url, key))


def test_a_taken_port_is_said_with_another_to_try(tmp_path, capsys):
    # One that answers: of a mute one it takes ten seconds to know what it is not.
    with ThreadingHTTPServer(("127.0.0.1", 0), BaseHTTPRequestHandler) as taken:
        Thread(target=taken.serve_forever, daemon=True).start()
        port = taken.server_port
        assert not port_is_free("127.0.0.1", port)
        assert main(["up", "--store", str(tmp_path), "--port", str(port)]) == 2
        taken.shutdown()
    complaint = capsys.readouterr().err
    assert f"Port {port} of 127.0.0.1 is taken by another program" in complaint
    assert f"modelgap up --port {port + 1}" in complaint


def test_a_second_up_must_not_contradict_the_first(tmp_path, sleeper):
    write_running(sleeper, LOCAL)
    for wish in ({"port": 4301}, {"host": "::1"}, {"database": SECRET}):
        with pytest.raises(InputError, match=r"served at .*4300.*modelgap down"):
            up.start_service(ServiceRequest(tmp_path, **wish), print)


def test_a_history_elsewhere_is_not_silently_begun_anew(tmp_path):
    home = tmp_path / "_prefect"
    home.mkdir()
    write_running(home, REMOTE)
    with pytest.raises(InputError, match=r"db\.lab:5432.*MODELGAP_DATABASE_URL"):
        up.start_service(ServiceRequest(tmp_path), print)


def test_status_says_stopped_or_what_is_wrong(tmp_path, capsys, monkeypatch):
    home = prefect_home(tmp_path)
    monkeypatch.setattr("flows.cli.service._prepare", lambda home: None)
    write_running(home, RunningService("127.0.0.1", 4300, "sqlite", stopped=True))
    assert main(["status", "--store", str(tmp_path)]) == 1
    assert "is stopped. Start it: modelgap up" in capsys.readouterr().err
    write_running(home, LOCAL)
    assert main(["status", "--store", str(tmp_path)]) == 1
    complaint = capsys.readouterr().err
    assert "the server has ended; see" in complaint
    assert "the worker has ended; see" in complaint


def test_status_of_nothing_is_1_and_down_of_nothing_is_0(tmp_path, capsys):
    store = str(tmp_path / "store")
    assert main(["status", "--store", store]) == 1
    assert main(["status", "--json", "--store", store]) == 1
    assert '"healthy": false' in capsys.readouterr().out
    assert main(["down", "--store", store]) == 0
    assert "nothing is running" in capsys.readouterr().out
    assert not (tmp_path / "store").exists()
    assert main(["down", "--store", store, "--wait", "-1"]) == 2
