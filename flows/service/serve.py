"""The server of one command, as a program: it serves until its input ends.

Its input ends with whoever holds it, however that one ends.
"""

import sys
import threading
from pathlib import Path

import uvicorn
from prefect.server.api.server import create_app
from prefect.settings import get_current_settings
from starlette.types import ASGIApp

from flows.errors import RunError
from flows.report.night.site import Site
from flows.service.api import Api, past_of
from flows.service.database import patient
from flows.service.guard import Guard, rules_for
from flows.service.pages import Tickets, with_entry, with_pages
from flows.service.state import Running
from flows.settings import store_folder


def app() -> ASGIApp:
    """Return the application of `modelgap up`; where it listens is in the settings."""
    api = get_current_settings().server.api
    return guarded(create_app(final=True), api.host, api.port, store_folder())


def guarded(
    prefect: ASGIApp, host: str, port: int, store: Path | None = None
) -> ASGIApp:
    """Return Prefect's application with the guard before it.

    Args:
        store: The store whose pages it serves as well; None for none.

    Raises:
        RunError: If Prefect was given no key: nothing is served without.
    """
    key = get_current_settings().server.api.auth_string
    if key is None or not key.get_secret_value():
        raise RunError("The server was given no key. Start it by modelgap up.")
    rules = rules_for(host, port, key.get_secret_value())
    app = with_entry(patient(prefect), rules, Tickets())
    if store is not None:
        to = Api(Running(host, port, "").url, rules.key)
        app = with_pages(app, rules, Site(store, "/", past_of(to)), Tickets())
    return Guard(app, rules)


_HOST = "127.0.0.1"


def serve(port: int) -> None:
    """Serve until standard input ends.

    Args:
        port: Where to listen, on this machine only.
    """
    app = guarded(create_app(ephemeral=True, final=True), _HOST, port)
    settings = uvicorn.Config(app, _HOST, port, log_level="error", proxy_headers=False)
    server = uvicorn.Server(settings)

    def end_with_input() -> None:
        sys.stdin.buffer.read()
        server.should_exit = True

    threading.Thread(target=end_with_input, daemon=True).start()
    server.run()


if __name__ == "__main__":
    serve(int(sys.argv[1]))
