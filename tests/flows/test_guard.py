"""Who may speak to the server of a store, and the key of the store."""

import json
import os
import stat
from threading import Thread

import pytest

from flows.service.access_guard import LARGEST, Guard, build_access_rules, check_access
from flows.service.access_guard import add_security_headers as add_headers
from flows.service.state import KEY, read_access_key
from flows.settings import prefect_home
from residual.errors import InputError
from tests.flows.asgi import (
    BODY,
    HOST,
    JSON,
    OURS,
    OWN,
    SECRET,
    answer,
    origin,
    prefect,
    scope,
    signed,
)


def kind(value: str) -> tuple[str, str]:
    return "content-type", value


def post(*given: tuple[str, str], method: str = "POST", host: str = HOST) -> dict:
    return scope(method, host=host, given=given)


def websocket(*given: tuple[str, str], host: str = HOST) -> dict:
    return scope(kind="websocket", host=host, given=given)


PAGE, EVIL = origin(OWN), origin("http://evil.example")


@pytest.mark.parametrize(
    ("status", "asked"),
    [
        # The page and the programs of the store.
        (None, scope()),
        (None, scope(host="localhost:4200")),
        (None, scope(host="[::1]:4200")),
        (None, post(PAGE, JSON, BODY, signed())),
        (None, post(signed(), JSON, BODY)),
        (None, post(signed(), ("content-length", "0"))),
        (None, websocket(PAGE)),
        (None, websocket()),
        # A page of another address: attack 1, and what it may try next.
        (403, post(EVIL, BODY)),
        (403, post(EVIL, method="DELETE")),
        (403, post(EVIL, method="GET")),
        (403, post(PAGE, EVIL, JSON, BODY)),
        (403, post(origin("null"), JSON, BODY)),
        (403, post(origin("https://127.0.0.1:4200"), JSON, BODY)),
        (403, post(origin("http://127.0.0.1:8888"), JSON, BODY)),
        (403, post(origin("http://localhost:4200"), JSON, BODY)),
        (403, post(origin("http://127.0.0.1:4200.evil.example"), JSON, BODY)),
        (403, websocket(EVIL)),
        (403, websocket(origin("http://localhost:8888"), signed())),
        # A name that was made to point here: attack 2.
        (421, scope(host="evil.example:4200", path="/api/admin/settings")),
        (421, post(origin("http://evil.example:4200"), JSON, host="evil.example:4200")),
        (421, websocket(host="evil.example:4200")),
        (421, scope(host="127.0.0.1:4200.evil.example")),
        (421, scope(host="127.0.0.1:4201")),
        (421, scope(host="0.0.0.0:4200")),
        (421, scope(host="")),
        (421, scope(given=[("host", "evil.example:4200")])),
        # A program that has no key, or a wrong one.
        (401, post(JSON, BODY)),
        (401, post(PAGE, JSON, BODY)),
        (401, post(signed("modelgap:guessed"), JSON, BODY)),
        (401, post(("authorization", SECRET), JSON, BODY)),
        (401, post(("authorization", "Basic \xfc"), JSON, BODY)),
        (401, post(JSON, BODY, method="post")),
        # A body that a form of any page can send.
        (415, post(PAGE, BODY, signed())),
        (415, post(signed(), BODY)),
        (415, post(signed(), BODY, kind("text/plain"), method="PATCH")),
        (415, post(signed(), kind("text/plain; application/json"), method="PUT")),
        (415, post(signed(), BODY, JSON, kind("text/plain"))),
    ],
)
def test_what_comes_from_elsewhere_is_refused(status, asked):
    why = check_access(asked, OURS)
    assert (why and why[0]) == status
    assert SECRET not in repr((why, OURS))


# Who listens everywhere is asked by any address, but by no strange name.
ANY = "10.0.0.7:4200 [fe80::1]:4200 localhost:4200 127.0.0.1:4200"
STRANGE = "evil.example:4200 0.0.0.0:4200 10.0.0.7:80 10.0.0.7"


@pytest.mark.parametrize(
    ("bound", "port", "ours", "foreign"),
    [
        ("0.0.0.0", 4200, ANY, STRANGE),
        ("::", 4200, ANY, STRANGE),
        (
            "lab.example",
            4200,
            "lab.example:4200 LAB.example:4200",
            "127.0.0.1:4200 evil.example:4200 10.0.0.7:4200",
        ),
        ("127.0.0.1", 80, "127.0.0.1", ""),  # which browsers leave out
    ],
)
def test_a_server_is_asked_by_the_names_that_it_is_bound_to(bound, port, ours, foreign):
    rules = build_access_rules(bound, port, SECRET)
    assert all(map(rules.names_server, ours.split()))
    assert not any(map(rules.names_server, foreign.split()))


def headers_of(answered: list[dict]) -> dict[str, str]:
    return {k.decode(): v.decode() for k, v in answered[0]["headers"]}


def test_what_is_refused_does_not_reach_prefect():
    foreign = scope("POST", given=[origin("http://evil.example"), BODY])
    start, body = answer(Guard(prefect, OURS), foreign)
    assert start["status"] == 403
    assert "http://evil.example" in json.loads(body["body"])["detail"]
    assert "access-control-allow-origin" not in headers_of([start])


def test_every_page_may_talk_to_its_own_server_only_and_be_framed_by_none():
    for host in (HOST, "localhost:4200"):
        app = Guard(add_headers(prefect), OURS)
        headers = headers_of(answer(app, scope(path="/", host=host)))
        policy = dict(
            part.strip().split(" ", 1) for part in headers["content-security-policy"].split(";")
        )
        assert policy["connect-src"] == f"'self' ws://{host}"
        assert policy["default-src"] == "'self'"
        assert policy["frame-ancestors"] == policy["object-src"] == "'none'"
        assert policy["script-src"] == "'self' 'unsafe-eval'"  # and nothing inline
        assert not any("http" in s or "*" in s for s in policy.values())
        assert headers["x-frame-options"] == "DENY"
        assert headers["x-content-type-options"] == "nosniff"


def message(told: object) -> dict:
    text = told if isinstance(told, str) else json.dumps(told)
    return {"type": "websocket.receive", "text": text}


SHOWN = {"type": "auth", "token": SECRET}


@pytest.mark.parametrize(
    "first",
    [
        {"type": "auth", "token": "guessed"},
        {"type": "auth", "token": None},
        {"type": "auth"},
        {"type": "event", "token": SECRET},
        {"event": "modelgap.run.committed"},
        [],
        "no JSON",
        "[" * 100_000,
        {"type": "auth", "token": "\ud800"},
        {"type": "auth", "token": SECRET, "more": "x" * LARGEST},
    ],
)
def test_a_websocket_without_the_key_first_is_closed(first):
    sent = [{"type": "websocket.connect"}, message(first), message(SHOWN)]
    messages = answer(Guard(prefect, OURS), scope(kind="websocket"), sent)
    closed = {"type": "websocket.close", "code": 1008}
    assert messages == [{"type": "websocket.accept"}, closed]


def test_a_websocket_with_the_key_is_open():
    connect, more = {"type": "websocket.connect"}, message("more")
    shown = [connect, message(SHOWN), more]
    app = Guard(prefect, OURS)
    messages = answer(app, scope(kind="websocket"), shown)
    assert [m.get("text") for m in messages[1:]] == [message(SHOWN)["text"], "more"]
    signs = scope(kind="websocket", given=[signed()])
    assert [m.get("text") for m in answer(app, signs, [connect, more])[1:]] == ["more"]


def test_a_foreign_websocket_is_closed_before_it_is_open():
    foreign = scope(kind="websocket", given=[origin("http://evil.example")])
    messages = answer(Guard(prefect, OURS), foreign, [{"type": "websocket.connect"}])
    assert messages == [{"type": "websocket.close", "code": 1008}]


def test_a_key_is_made_once_for_the_eyes_of_its_owner(tmp_path):
    before = os.umask(0)
    try:
        home = prefect_home(tmp_path / "store")
        key = read_access_key(home)
    finally:
        os.umask(before)
    assert len(key) > 40
    assert read_access_key(home) == key
    modes = [p.stat().st_mode for p in (home / KEY, home, tmp_path / "store")]
    assert [stat.S_IMODE(mode) for mode in modes] == [0o600, 0o700, 0o700]
    assert [p.name for p in home.iterdir()] == [KEY]
    assert read_access_key(prefect_home(tmp_path / "other")) != key


def test_of_keys_made_at_once_the_first_counts(tmp_path):
    keys: list[str] = []
    many = [Thread(target=lambda: keys.append(read_access_key(tmp_path))) for _ in range(8)]
    for each in many:
        each.start()
    for each in many:
        each.join()
    assert len(keys) == 8
    assert set(keys) == {read_access_key(tmp_path)}


def test_a_key_that_others_can_read_or_that_is_none_is_refused(tmp_path):
    read_access_key(tmp_path)
    (tmp_path / KEY).chmod(0o644)
    with pytest.raises(InputError, match="can be read by others"):
        read_access_key(tmp_path)
    (tmp_path / KEY).write_text("short")
    (tmp_path / KEY).chmod(0o600)
    with pytest.raises(InputError, match="is no key"):
        read_access_key(tmp_path)


def test_a_folder_that_was_made_by_hand_is_closed_to_others(tmp_path):
    (tmp_path / "_prefect").mkdir(mode=0o755)
    assert stat.S_IMODE(prefect_home(tmp_path).stat().st_mode) == 0o700


def bodies(size: int):
    """Give a body in parts of a megabyte, and count those that were taken."""
    taken = []

    def parts():
        for part in range(size):
            taken.append(part)
            more = part + 1 < size
            yield {"type": "http.request", "body": b" " * (1 << 20), "more_body": more}

    return parts(), taken


def test_a_large_body_without_the_key_is_not_read():
    request = scope("POST", given=[origin(OWN), JSON])
    sent, taken = bodies(400)
    assert answer(Guard(prefect, OURS), request, sent)[0]["status"] == 401
    assert taken == []


def test_a_large_body_with_the_key_is_read():
    read = []

    async def behind(_, receive, send):
        while (told := await receive()).get("more_body"):
            read.append(len(told["body"]))
        await prefect(request, receive, send)

    request = scope("POST", given=[signed(), JSON])
    assert answer(Guard(behind, OURS), request, bodies(3)[0])[0]["status"] == 200
    assert sum(read) == 2 << 20
