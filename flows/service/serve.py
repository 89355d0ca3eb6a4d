"""The application of `modelgap up`; alone here, since to load it is to load Prefect."""

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from contextvars import ContextVar

from prefect.server.api.server import create_app
from prefect.server.database.configurations import AioSqliteConfiguration
from prefect.server.database.dependencies import MODELS_DEPENDENCIES
from prefect.server.utilities.database import get_dialect
from prefect.server.utilities.messaging import MessageHandler, memory
from prefect.settings import PREFECT_API_DATABASE_CONNECTION_URL, get_current_settings
from sqlalchemy.ext.asyncio import AsyncSession, AsyncSessionTransaction
from starlette.types import ASGIApp, Receive, Scope, Send

from flows.report.night.site import Site
from flows.service.api import Api, past_of
from flows.service.guard import Guard, rules_for
from flows.service.pages import Tickets, with_entry, with_pages
from flows.service.state import Running
from flows.settings import store_folder
from residual.errors import RunError

Publisher, break_topic = memory.Publisher, memory.break_topic
ephemeral_subscription = memory.ephemeral_subscription
_WAITS: ContextVar[bool] = ContextVar("waits", default=False)


class Patient(AioSqliteConfiguration):
    """Lets what comes by a WebSocket, and events, wait for their turn to write.

    Prefect begins a transaction as a reader. If another one writes before it does,
    SQLite cannot let it write any more and refuses at once, however long its limit for
    waiting is (https://www.sqlite.org/isolation.html). A request over HTTP is then
    answered 503 and made again; a worker's sign of life on its WebSocket is lost, and
    an event fills the log with what is read as an error. All others go on as readers:
    who waits holds a connection, and there are fifteen.
    """

    @asynccontextmanager
    async def begin_transaction(
        self, session: AsyncSession, with_for_update: bool = False
    ) -> AsyncIterator[AsyncSessionTransaction]:
        """Begin one; of who waits for it, as a writer from the start."""
        writes = with_for_update or _WAITS.get()
        async with super().begin_transaction(session, with_for_update=writes) as begun:
            yield begun


def wait_to_write() -> None:
    """Let this task, and those that it starts, wait for their turn from now on."""
    _WAITS.set(True)


def patient(app: ASGIApp) -> ASGIApp:
    """Return an application that can wait; for PostgreSQL nothing changes."""
    url = PREFECT_API_DATABASE_CONNECTION_URL.value()
    if get_dialect(url).name == "sqlite":
        MODELS_DEPENDENCIES["database_config"] = Patient(url)

    async def marked(scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] == "websocket":
            wait_to_write()
        await app(scope, receive, send)

    return marked


# Prefect's broker of events, in memory, whose consumers wait for their turn to write.
#
# Prefect loads it by the name in PREFECT_MESSAGING_BROKER, and asks of such a module
# the names below.


class Consumer(memory.Consumer):
    """Hands events to one service of the server, two at a time."""

    async def run(self, handler: MessageHandler) -> None:
        """Hand events to ``handler`` until it says to stop."""
        wait_to_write()
        await super().run(handler)


def app() -> ASGIApp:
    """Return Prefect's application with the pages of the store, behind the guard.

    Where it listens, and the key, are in Prefect's settings.

    Raises:
        RunError: If Prefect was given no key: nothing is served without.
    """
    settings = get_current_settings().server.api
    host, port, key = settings.host, settings.port, settings.auth_string
    if key is None or not key.get_secret_value():
        raise RunError("The server was given no key. Start it by modelgap up.")
    rules = rules_for(host, port, key.get_secret_value())
    to = Api(Running(host, port, "").url, rules.key)
    site = Site(store_folder(), past_of(to))
    served = with_entry(patient(create_app(final=True)), rules, Tickets())
    return Guard(with_pages(served, rules, site, Tickets()), rules)
