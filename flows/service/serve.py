"""The application of `modelgap up`; alone here, since to load it is to load Prefect."""

from prefect.server.api.server import create_app
from prefect.settings import get_current_settings
from starlette.types import ASGIApp

from flows.service.guard import Guard, rules_for
from flows.service.pages import with_pages, with_policies
from flows.settings import store_folder
from residual.errors import RunError


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
    served = with_pages(create_app(final=True), rules, store_folder())
    return Guard(with_policies(served), rules)
