"""A real server, attacked by raw clients and by pages in a real browser."""

import http.client
import json
from base64 import b64encode
from contextlib import suppress
from functools import partial
from types import SimpleNamespace

import pytest
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect

from flows.service import api
from flows.service.state import read_access_key
from flows.settings import prefect_home
from residual.errors import RunError
from tests.flows.browser import PROGRAM, browser
from tests.flows.prefect_server import served as serving
from tests.waiting import PATIENCE

EVIL = "http://evil.example"
FLOW = b'{"name": "attack"}'
# What ran a command within a minute: on any event start a deployment of the store.
RULE = {
    "name": "attack",
    "trigger": dict(type="event", expect=["*"], posture="Reactive", threshold=1),
    "actions": [
        dict(type="run-deployment", source="inferred")
        | {"job_variables": {"command": "touch /tmp/attacked"}}
    ],
}
SOCKETS = (
    "/events/in",
    "/events/out",
    "/logs/out",
    "/task_runs/subscriptions/scheduled",
    "/work_pools/modelgap/workers/connect",
)

pytestmark = [pytest.mark.prefect, pytest.mark.slow]


def reached(url: str, key: str):
    """Where a server is attacked, and by what its owner asks it."""
    ui, port = url.removesuffix("/api"), int(url.split(":")[2].split("/")[0])
    return SimpleNamespace(api=api.Api(url, key), ui=ui, port=port)


@pytest.fixture
def served(server):
    """The server of all tests, without its pages."""
    return reached(server.url, server.key)


@pytest.fixture(scope="module")
def paged(tmp_path_factory):
    """The server of `modelgap up`, as it starts it, and no worker."""
    home = prefect_home(tmp_path_factory.mktemp("attacked") / "store")
    with serving(home) as running:
        yield reached(running.url, read_access_key(home))


def send(served, method: str, path: str, body: bytes | None = None, **given) -> int:
    """Send exactly these headers; returns the status."""
    headers = {name.replace("_", "-"): value for name, value in given.items()}
    connection = http.client.HTTPConnection("127.0.0.1", served.port, timeout=PATIENCE)
    connection.putrequest(method, f"/api{path}", skip_host="Host" in headers)
    length = {} if body is None else {"Content-Length": str(len(body))}
    for name, value in (headers | length).items():
        connection.putheader(name, value)
    connection.endheaders(body)
    try:
        return connection.getresponse().status
    finally:
        connection.close()


def signed(key: str) -> str:
    return f"Basic {b64encode(key.encode()).decode()}"


def attack_records(served) -> list[str]:
    with served.api.client() as client:
        everything = [*client.read_flows(), *client.read_automations()]
    return [each.name for each in everything if each.name == "attack"]


def test_pages_and_programs_of_others_give_no_orders(served):
    rule = json.dumps(RULE).encode()
    key = {"Authorization": signed(served.api.key)}
    json_body = {"Content_Type": "application/json"}
    assert send(served, "POST", "/flows/", FLOW, Origin=EVIL) == 403
    assert send(served, "POST", "/automations/", rule, Origin=EVIL) == 403
    assert send(served, "POST", "/automations/", rule, Origin="null") == 403
    assert send(served, "POST", "/flows/", FLOW, Origin=EVIL, **json_body, **key) == 403
    assert send(served, "POST", "/flows/", FLOW) == 401
    assert send(served, "POST", "/flows/", FLOW, **json_body) == 401
    assert send(served, "POST", "/flows/", FLOW, Origin=served.ui, **json_body) == 401
    assert send(served, "POST", "/flows/", FLOW, **key) == 415
    plain = {"Content_Type": "text/plain"}
    assert send(served, "POST", "/flows/", FLOW, **plain, **key) == 415
    assert attack_records(served) == []


def test_a_name_that_was_made_to_point_here_is_not_served(served):
    evil = {"Host": f"evil.example:{served.port}"}
    key = {"Authorization": signed(served.api.key)}
    assert send(served, "GET", "/admin/settings", **evil) == 421
    assert send(served, "GET", "/admin/settings", **evil, **key) == 421
    assert send(served, "GET", "/health", **evil) == 421


def test_nothing_is_told_to_who_has_no_key(served):
    for path in ("/admin/settings", "/csrf-token?client=a", "/flows/count", "/version"):
        assert send(served, "GET", path) == 401
    assert send(served, "GET", "/health") == 200
    guesses = api.Api(served.api.url, "modelgap:guessed")
    with pytest.raises(RunError, match="401"), guesses.client() as client:
        client.read_flows()
    with served.api.client() as client:
        assert client.api_version()


@pytest.mark.parametrize("path", SOCKETS)
def test_a_websocket_is_for_who_has_the_key(served, path):
    place = served.api.url.replace("http", "ws") + path
    opened = partial(connect, place, subprotocols=["prefect"], open_timeout=PATIENCE)
    for origin in (EVIL, "null", "http://127.0.0.1:1"):
        with pytest.raises(InvalidStatus) as caught, opened(origin=origin):
            pass
        assert caught.value.response.status_code == 403
    for origin in (None, served.ui):
        assert not greeted(opened(origin=origin), {"type": "auth", "token": "guessed"})
        assert not greeted(opened(origin=origin), {"type": "filter", "filter": {}})
    with suppress(ConnectionClosed, InvalidStatus), connect(place) as legacy:
        legacy.send(json.dumps({"event": "modelgap.run.committed"}))
        legacy.recv(timeout=PATIENCE)
        pytest.fail("it answered without a key")
    assert greeted(opened(), {"type": "auth", "token": served.api.key})


def greeted(opening, first: dict) -> bool:
    """Whether the server welcomes who sends this first."""
    with opening as open_:
        open_.send(json.dumps(first))
        try:
            return json.loads(open_.recv(timeout=PATIENCE)) == {"type": "auth_success"}
        except ConnectionClosed:
            return False


@pytest.fixture
def tab(tmp_path):
    """A browser; every name but those of the attacks leads nowhere."""
    if PROGRAM is None:
        pytest.skip("no chromium on this machine (Debian: apt-get install chromium)")
    evil = "MAP evil.example 127.0.0.1, MAP * ~NOTFOUND, EXCLUDE 127.0.0.1"
    with browser(tmp_path, f"--host-resolver-rules={evil}") as tab:
        yield tab


@pytest.mark.long
def test_a_rebound_name_shows_nothing(paged, tab):
    tab.open(f"http://evil.example:{paged.port}/api/admin/settings")
    page_text = tab.wait("document.body?.innerText", "the answer is there")
    assert "evil.example" in json.loads(page_text)["detail"]
    script = "fetch('/api/admin/settings').then(() => 'given').catch(() => 'refused')"
    assert tab.run(script) == "refused"


@pytest.mark.long
def test_the_pages_work_and_ask_for_nothing_beyond_this_machine(paged, tab):
    with paged.api.client() as client:
        client.request("POST", "/flows/", json={"name": "seen-flow"})
        variable = {"name": "seen_variable", "value": 1}
        client.request("POST", "/variables/", json=variable)
    tab.log_in(paged.ui, paged.api.key)
    pages = {
        "/v2/flows": "seen-flow",
        "/v2/variables": "seen_variable",
        "/v2/settings": "csrf_support_enabled",
    }
    for path, words in pages.items():
        tab.open(f"{paged.ui}{path}")
        tab.wait(f"document.body?.innerText.includes({json.dumps(words)})", path)
        # Its tracker asks a few times, each time later.
        tab.listen(2)
    assert any("amplitude" in said for said in tab.said)  # it has tried
    hosts = {url.split("/")[2] for url in tab.asked.values() if "://" in url}
    assert hosts == {f"127.0.0.1:{paged.port}"}
    assert paged.api.key not in tab.run("document.documentElement.outerHTML")
