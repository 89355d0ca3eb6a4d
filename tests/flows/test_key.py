"""The key of a store: made once, and given to the page by a ticket that works once."""

import json
import os
import stat
from threading import Thread

import pytest

from flows.service import pages
from flows.service.guard import Guard
from flows.service.pages import LIFE, Tickets, with_entry
from flows.service.state import KEY, store_key
from flows.settings import prefect_home
from residual.errors import InputError
from tests.flows.asgi import (
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


def opened(tickets: Tickets, body: object) -> tuple[int, dict]:
    asked = scope("POST", "/open", given=[origin(OWN), JSON])
    sent = [{"type": "http.request", "body": json.dumps(body).encode()}]
    app = Guard(with_entry(prefect, OURS, tickets), OURS)
    start, told = answer(app, asked, sent)
    return start["status"], json.loads(told["body"])


def test_a_ticket_gives_the_key_once():
    tickets = Tickets()
    ticket = tickets.give()
    assert opened(tickets, {"ticket": ticket}) == (200, {"key": SECRET})
    assert opened(tickets, {"ticket": ticket})[0] == 403


@pytest.mark.parametrize("body", [{"ticket": "guessed"}, {"ticket": [1]}, {}, [], None])
def test_without_a_ticket_there_is_no_key(body):
    status, told = opened(Tickets(), body)
    assert status == 403
    assert "modelgap up" in told["detail"]


def test_a_ticket_is_not_good_for_ever_and_they_are_not_kept_without_end():
    now = [0.0]
    tickets = Tickets(lambda: now[0])
    late, first = tickets.give(), tickets.give()
    now[0] = LIFE + 1
    assert not tickets.take(late)
    kept = [tickets.give() for _ in range(pages._MOST)]
    assert not tickets.take(first)
    assert all(tickets.take(ticket) for ticket in kept)


@pytest.mark.parametrize("given", [[], [signed("modelgap:guessed")], [origin(OWN)]])
def test_only_who_has_the_key_gets_a_ticket(given):
    asked = scope("POST", "/open/ticket", given=[JSON, *given])
    sent = [{"type": "http.request", "body": b"{}"}]
    app = Guard(with_entry(prefect, OURS, Tickets()), OURS)
    assert answer(app, asked, sent)[0]["status"] == 401


def test_a_key_is_made_once_for_the_eyes_of_its_owner(tmp_path):
    before = os.umask(0)
    try:
        home = prefect_home(tmp_path / "store")
        key = store_key(home)
    finally:
        os.umask(before)
    assert len(key) > 40
    assert store_key(home) == key
    modes = [p.stat().st_mode for p in (home / KEY, home, tmp_path / "store")]
    assert [stat.S_IMODE(mode) for mode in modes] == [0o600, 0o700, 0o700]
    assert [p.name for p in home.iterdir()] == [KEY]
    assert store_key(prefect_home(tmp_path / "other")) != key


def test_of_keys_made_at_once_the_first_counts(tmp_path):
    found: list[str] = []
    many = [Thread(target=lambda: found.append(store_key(tmp_path))) for _ in range(8)]
    for each in many:
        each.start()
    for each in many:
        each.join()
    assert len(found) == 8
    assert set(found) == {store_key(tmp_path)}


def test_a_key_that_others_can_read_or_that_is_none_is_refused(tmp_path):
    store_key(tmp_path)
    (tmp_path / KEY).chmod(0o644)
    with pytest.raises(InputError, match="can be read by others"):
        store_key(tmp_path)
    (tmp_path / KEY).write_text("short")
    (tmp_path / KEY).chmod(0o600)
    with pytest.raises(InputError, match="is no key"):
        store_key(tmp_path)


def test_the_folder_of_an_earlier_version_is_closed_to_others(tmp_path):
    (tmp_path / "_prefect").mkdir(mode=0o755)
    assert stat.S_IMODE(prefect_home(tmp_path).stat().st_mode) == 0o700
