"""The server application of `modelgap up`; importing it loads Prefect's server."""

from prefect.server.api.server import create_app
from prefect.settings import get_current_settings
from starlette.types import ASGIApp

from flows.service.access_guard import (
    Guard,
    add_security_headers,
    add_store_pages,
    build_access_rules,
)
from flows.settings import resolve_store_folder
from residual.errors import RunError


def app() -> ASGIApp:
    """Return Prefect's application with the pages of the store, behind the guard.

    Address and key are in Prefect's settings.

    Raises:
        RunError: If there is no key.
    """
    settings = get_current_settings().server.api
    host, port, key = settings.host, settings.port, settings.auth_string
    if key is None or not key.get_secret_value():
        raise RunError("The server was given no key. Start it by modelgap up.")
    rules = build_access_rules(host, port, key.get_secret_value())
    served = add_store_pages(create_app(final=True), rules, resolve_store_folder())
    return Guard(add_security_headers(served), rules)
