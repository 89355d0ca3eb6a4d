"""What nobody asks for again is not lost to "database is locked"."""

import asyncio
import sqlite3
from contextlib import closing

import pytest
from prefect.server.database.dependencies import MODELS_DEPENDENCIES
from prefect.server.utilities.messaging import (
    StopConsumer,
    create_consumer,
    create_publisher,
)
from prefect.settings import PREFECT_MESSAGING_BROKER, temporary_settings
from sqlalchemy import text
from sqlalchemy.exc import OperationalError

from flows.service import serve
from flows.service.serve import Patient, patient


async def read_then_write(path, meanwhile):
    """Read, let another do something, and write, all in one transaction."""
    patient = Patient(f"sqlite+aiosqlite:///{path}")
    engine = await patient.engine()
    session = await patient.session(engine)
    try:
        async with session, patient.begin_transaction(session):
            await session.execute(text("SELECT count(*) FROM signs"))
            meanwhile()
            await session.execute(text("INSERT INTO signs VALUES ('ours')"))
    finally:
        await engine.dispose()


@pytest.fixture
def path(tmp_path):
    with closing(sqlite3.connect(tmp_path / "prefect.db")) as made:
        made.execute("PRAGMA journal_mode = WAL")
        made.execute("CREATE TABLE signs (who TEXT)")
        made.commit()
    return tmp_path / "prefect.db"


def another_writes(path):
    with closing(sqlite3.connect(path, timeout=0.05)) as other:
        other.execute("INSERT INTO signs VALUES ('theirs')")
        other.commit()


@pytest.fixture(autouse=True)
def own_database(monkeypatch):
    """Undo what the application sets for its whole process."""
    for key in list(MODELS_DEPENDENCIES):
        monkeypatch.setitem(MODELS_DEPENDENCIES, key, MODELS_DEPENDENCIES[key])


def signs(path):
    with closing(sqlite3.connect(path)) as made:
        return [who for (who,) in made.execute("SELECT who FROM signs")]


def test_a_request_over_http_begins_as_a_reader_and_is_refused_when_another_wrote(path):
    async def asked(scope, receive, send):
        await read_then_write(path, lambda: another_writes(path))

    with pytest.raises(OperationalError, match="database is locked"):
        asyncio.run(patient(asked)({"type": "http"}, None, None))
    assert signs(path) == ["theirs"]


def refused(path):
    with pytest.raises(sqlite3.OperationalError, match="database is locked"):
        another_writes(path)


def test_one_that_comes_by_a_websocket_is_a_writer_from_the_start(path):
    async def sign_of_life(scope, receive, send):
        await read_then_write(path, lambda: refused(path))

    asyncio.run(patient(sign_of_life)({"type": "websocket"}, None, None))
    another_writes(path)
    assert signs(path) == ["ours", "theirs"]


def test_a_service_that_is_handed_an_event_is_a_writer_from_the_start(path):
    async def handed(message):
        await read_then_write(path, lambda: refused(path))
        raise StopConsumer(ack=True)

    async def told():
        # As the server does it, which finds the broker by the name of its module.
        consumer = create_consumer("events", concurrency=1)
        assert isinstance(consumer, serve.Consumer)
        async with create_publisher("events") as publisher:
            await publisher.publish_data(b"{}", {})
        await consumer.run(handed)
        await consumer.cleanup()

    with temporary_settings({PREFECT_MESSAGING_BROKER: serve.__name__}):
        asyncio.run(told())
    assert signs(path) == ["ours"]
