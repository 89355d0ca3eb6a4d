"""The pages over a store as its server gives them: to whom, and what they may do."""

from html.parser import HTMLParser

import pytest

from flows.report.page import hash_script, read_page_script
from flows.service.access_guard import MADE, STORED, Guard, add_store_pages
from flows.service.access_guard import add_security_headers as add_headers
from tests.flows.asgi import OURS, SECRET, answer, origin, prefect, scope, signed
from tests.flows.index.stores import STORED as PAGE
from tests.flows.index.stores import fill

INDEX = "/pages/index.html"
EVIL = origin("http://evil.example")


class Attributes(HTMLParser):
    """All tags of a page and their attributes, as a browser takes them."""

    def __init__(self):
        super().__init__()
        self.tags, self.names = set(), set()

    def handle_starttag(self, tag, attrs):
        self.tags.add(tag)
        self.names |= {name for name, _ in attrs}


@pytest.fixture
def app(nights):
    return Guard(add_headers(add_store_pages(prefect, OURS, nights.store)), OURS)


def get(app, path: str, *given, **more):
    request = scope(path=path, given=given, **more) | {"raw_path": path.encode()}
    start, *rest = answer(app, request)
    headers = {k.decode(): v.decode() for k, v in start["headers"]}
    return start["status"], headers, b"".join(part["body"] for part in rest)


@pytest.mark.parametrize("given", [[], [signed("modelgap:guessed")]])
def test_who_has_no_key_is_asked_for_it_and_sees_nothing(app, nights, given):
    bodies = {get(app, path, *given)[2] for path in (INDEX, "/pages/none")}
    assert len(bodies) == 1  # not even whether there is such a page
    status, headers, body = get(app, INDEX, *given)
    assert (status, headers["content-security-policy"]) == (401, MADE)
    assert headers["www-authenticate"].startswith("Basic realm=")
    for secret in (SECRET, "two_link", nights.missing):
        assert secret.encode() not in body


def test_who_has_the_key_gets_the_page(app):
    status, headers, body = get(app, INDEX, signed())
    assert (status, headers["content-security-policy"]) == (200, MADE)
    assert b"two_link #1" in body
    assert headers["cache-control"] == "no-store"
    assert headers["x-frame-options"] == "DENY"


def test_pages_of_others_and_other_names_get_none(app):
    assert get(app, INDEX, EVIL, signed())[0] == 403
    assert get(app, INDEX, origin("null"), signed())[0] == 403
    assert get(app, INDEX, signed(), host="evil.example:4200")[0] == 421


def test_a_stored_page_has_no_origin_that_the_server_listens_to(app, nights):
    path = f"/pages/report_id={nights.report}/report.html"
    status, headers, body = get(app, path, signed())
    assert (status, body) == (200, PAGE)
    policy = headers["content-security-policy"]
    assert policy == STORED
    assert policy.startswith("sandbox allow-scripts;")
    # With it, scripts of the page would have the key and the ear of the server.
    assert "allow-same-origin" not in policy
    assert "connect-src" not in policy
    assert "default-src 'none'" in policy
    assert "cross-origin-opener-policy" not in headers  # no browser shows both


def test_what_is_made_runs_no_script_but_ours(app):
    _, headers, body = get(app, INDEX, signed())
    own = hash_script(read_page_script("filter.js"))
    assert f"script-src {own};" in headers["content-security-policy"]
    tags = Attributes()
    tags.feed(body.decode())
    assert {"a", "main", "h1"} <= tags.tags
    assert body.count(b"<script") == 1
    assert not {"iframe", "img", "form"} & tags.tags
    assert not {name for name in tags.names if name.startswith("on")}


def test_an_application_behind_the_guard_chooses_none_but_known_policies(nights):
    async def loose(scope, receive, send):
        headers = [(b"content-security-policy", b"default-src *")]
        await send({"type": "http.response.start", "status": 200, "headers": headers})
        await send({"type": "http.response.body", "body": b""})

    ((_, given),) = [
        (k, v)
        for k, v in answer(add_headers(loose), scope(path="/"))[0]["headers"]
        if k == b"content-security-policy"
    ]
    assert b"*" not in given
    assert b"frame-ancestors 'none'" in given


@pytest.mark.parametrize(
    "path",
    [
        "/pages/../api/flows",
        "/pages//etc/passwd",
        "/pages/report/../../_prefect/key",
        "/pages/report/%2e%2e/key",
        "/pages/none.html",
    ],
)
def test_what_is_no_page_is_404(app, path):
    status, headers, body = get(app, path, signed())
    assert status == 404
    assert headers["content-type"].startswith("text/plain")
    assert b"index.html" in body


def test_all_else_goes_to_prefect(app):
    for path in ("/", "/api/flows/", "/pagesx", "/page"):
        assert get(app, path, signed())[2] == b"reached"
    status, headers, _ = get(app, "/pages/", signed())
    assert (status, headers["location"]) == (307, "/pages/index.html")


def test_other_files_of_a_report_are_no_pages(tmp_path):
    nights = fill(tmp_path, files={"truth.json": b'{"a": "<script>"}', "a.svg": b"<svg>"})
    app = add_store_pages(prefect, OURS, nights.store)
    place = f"/pages/report_id={nights.report}"
    response = get(app, f"{place}/truth.json", signed())
    assert response[1]["content-type"] == "application/json"
    assert response[1]["content-security-policy"] == MADE
    assert get(app, f"{place}/a.svg", signed())[0] == 404
