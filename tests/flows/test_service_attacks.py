"""A real server, attacked by raw clients and by pages in a real browser."""

import http.client
import json
from base64 import b64encode
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import partial
from http.server import BaseHTTPRequestHandler, HTTPServer
from threading import Thread
from types import SimpleNamespace

import pytest
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect

from flows.service import api
from flows.service.state import store_key
from flows.settings import prefect_home
from residual.errors import RunError
from tests.flows.browser import PROGRAM, browser
from tests.flows.prefect_server import served as serving

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
        yield reached(running.url, store_key(home))


def send(served, method: str, path: str, body: bytes | None = None, **given) -> int:
    """Send exactly these headers; returns the status."""
    headers = {name.replace("_", "-"): value for name, value in given.items()}
    connection = http.client.HTTPConnection("127.0.0.1", served.port, timeout=60)
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
    """Return what a program sends to show its key."""
    return f"Basic {b64encode(key.encode()).decode()}"


def made(served) -> list[str]:
    """Return what the attacks have made."""
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
    assert made(served) == []


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
    opened = partial(connect, place, subprotocols=["prefect"], open_timeout=60)
    for origin in (EVIL, "null", "http://127.0.0.1:1"):
        with pytest.raises(InvalidStatus) as caught, opened(origin=origin):
            pass
        assert caught.value.response.status_code == 403
    for origin in (None, served.ui):
        assert not greeted(opened(origin=origin), {"type": "auth", "token": "guessed"})
        assert not greeted(opened(origin=origin), {"type": "filter", "filter": {}})
    with suppress(ConnectionClosed, InvalidStatus), connect(place) as legacy:
        legacy.send(json.dumps({"event": "modelgap.run.committed"}))
        legacy.recv(timeout=60)
        pytest.fail("it answered without a key")
    assert greeted(opened(), {"type": "auth", "token": served.api.key})


def greeted(opening, first: dict) -> bool:
    """Whether the server welcomes who sends this first."""
    with opening as open_:
        open_.send(json.dumps(first))
        try:
            return json.loads(open_.recv(timeout=60)) == {"type": "auth_success"}
        except ConnectionClosed:
            return False


ATTACK = """
(async () => {
  const told = {};
  const ask = async (name, path, options) => {
    try { told[name] = (await fetch("%(ui)s/api" + path, options)).status; }
    catch (error) { told[name] = "failed"; }
  };
  const blob = new Blob([JSON.stringify({name: "attack"})]);
  const rule = new Blob([JSON.stringify(%(rule)s)]);
  await ask("blind", "/flows/", {method: "POST", mode: "no-cors", body: blob});
  await ask("rule", "/automations/", {method: "POST", mode: "no-cors", body: rule});
  await ask("plain", "/flows/", {method: "POST", body: '{"name": "attack"}'});
  await ask("json", "/flows/", {method: "POST", body: '{"name": "attack"}',
                                headers: {"Content-Type": "application/json"}});
  await ask("read", "/admin/settings", {});
  told.socket = await new Promise((done) => {
    const socket = new WebSocket("%(ws)s/events/in", "prefect");
    socket.onopen = () => done("open");
    socket.onerror = () => done("failed");
  });
  told.framed = await new Promise((done) => {
    const frame = document.createElement("iframe");
    frame.onload = () => { try { done(frame.contentDocument ? "seen" : "empty"); }
                           catch (error) { done("empty"); } };
    frame.src = "%(ui)s/";
    document.body.append(frame);
  });
  return told;
})()
"""


@contextmanager
def evil_pages() -> Iterator[int]:
    """Serve an empty page; gives its port."""

    class Page(BaseHTTPRequestHandler):
        def do_GET(self):
            self.send_response(200)
            self.send_header("Content-Type", "text/html")
            self.end_headers()
            self.wfile.write(b"<!doctype html><body>evil</body>")

        def log_message(self, *_):
            pass

    with HTTPServer(("127.0.0.1", 0), Page) as server:
        Thread(target=server.serve_forever, daemon=True).start()
        yield server.server_port
        server.shutdown()


@pytest.fixture
def tab(tmp_path):
    """A browser; every name but those of the attacks leads nowhere."""
    if PROGRAM is None:
        pytest.skip("no chromium on this machine (Debian: apt-get install chromium)")
    evil = "MAP evil.example 127.0.0.1, MAP * ~NOTFOUND, EXCLUDE 127.0.0.1"
    with browser(tmp_path, f"--host-resolver-rules={evil}") as tab:
        yield tab


@pytest.mark.long
@pytest.mark.parametrize("name", ["evil.example", "127.0.0.1"])
def test_a_page_of_another_address_gives_no_orders(paged, tab, name):
    given = {
        "ui": paged.ui,
        "ws": paged.api.url.replace("http", "ws"),
        "rule": json.dumps(RULE),
    }
    with evil_pages() as port:
        # As after a visit by its owner: what the browser keeps must not help.
        tab.log_in(paged.ui, paged.api.key)
        tab.open(f"http://{name}:{port}/")
        tab.wait(
            "document.body?.innerText === 'evil'", "the page of the attack is open"
        )
        told = tab.run(ATTACK % given)
    # 0: sent, and the page may not see what came.
    assert told.pop("blind") in (0, "failed")
    assert told.pop("rule") in (0, "failed")
    assert told.pop("framed") == "empty"
    assert set(told.values()) == {"failed"}, told
    assert made(paged) == []


@pytest.mark.long
def test_a_rebound_name_shows_nothing(paged, tab):
    tab.open(f"http://evil.example:{paged.port}/api/admin/settings")
    told = tab.wait("document.body?.innerText", "the answer is there")
    assert "evil.example" in json.loads(told)["detail"]
    asked = "fetch('/api/admin/settings').then(() => 'answered').catch(() => 'refused')"
    assert tab.run(asked) == "refused"


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
