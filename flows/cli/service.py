"""modelgap up, status and down: the server, worker and schedules of a store."""

import os
import sys

from flows.cli.options import Flag
from flows.cli.service_tables import print_status
from flows.errors import RunError
from flows.outputs import json_text
from flows.service.down import down as stop
from flows.service.foreground import stay
from flows.service.status import status as state_of
from flows.service.up import up as bring_up
from flows.service.wanted import DATABASE, Wanted, checked
from flows.settings import PREFECT, store_folder
from residual.errors import InputError


def up(
    *,
    port: int | None = None,
    host: str | None = None,
    workers: int | None = None,
    every: int | None = None,
    database: str | None = None,
    trust_network: Flag = False,
    foreground: Flag = False,
    store: str | None = None,
) -> None:
    """Start server, worker and schedules of a store, and return when they answer.

    ```
    modelgap up
    modelgap up --every 60 --port 4300
    modelgap status
    modelgap down
    ```

    Doing it again is no error: what runs is left alone and its address is printed,
    what was killed is started again. Nothing is sent anywhere; the server listens on
    this machine only.

    Args:
        port: Port of the server and its page; 4200 unless given.
        host: Address to listen on; anything but this machine needs --trust-network.
        workers: How many workers.
        every: Also start the nightly flow every so many seconds, until --every 0.
        database: postgresql://USER:PASSWORD@HOST/NAME for the history of flow runs;
            better given as $MODELGAP_DATABASE_URL, since others see command lines.
            Without it a file in the store.
        trust_network: Let others in the network reach the server. It has no password,
            and whoever reaches it can run programs as you.
        foreground: Stay until Ctrl-C, then stop everything; for service managers.
        store: Folder of the store; else $MODELGAP_STORE, else ./store.
    """
    database = database or os.environ.get(DATABASE) or None
    place = store_folder(store)
    wanted = Wanted(place, host, port, workers, every, database, trust_network)
    checked(wanted)
    running, was_up = bring_up(wanted, _say)
    if trust_network:
        _say("warning: the server has no password; whoever reaches it runs programs.")
    word = "already runs" if was_up else "is up"
    print(f"{place} {word}: {running.ui}")
    if foreground:
        stay(place, _say)
    else:
        print("modelgap status shows what is due; modelgap down stops it")


def status(*, json: Flag = False, store: str | None = None) -> None:
    """Show server, workers, what is due next, and the last flow runs.

    ```
    modelgap status
    modelgap status --json
    ```

    The exit code is 0 if the next schedule will fire and be run, else 1.

    Args:
        json: Print it as JSON.
        store: Folder of the store; else $MODELGAP_STORE, else ./store.
    """
    place = store_folder(store)
    found = state_of(place / PREFECT)
    if json:
        print(json_text(found.document()), end="")
    else:
        print_status(found, place)
    if not found.healthy:
        raise RunError(f"{place} is not healthy. Start what is missing: modelgap up")


def down(*, wait: float = 60.0, store: str | None = None) -> None:
    """Stop worker and server of a store; schedules and history stay.

    ```
    modelgap down
    modelgap down --wait 0
    ```

    Nothing new is begun, and flow runs that are under way may end. What takes longer
    than --wait is ended and marked as such; runs that it has stored are kept.

    Args:
        wait: How long flow runs may go on, in seconds.
        store: Folder of the store; else $MODELGAP_STORE, else ./store.
    """
    if not 0 <= wait < 1e6:
        raise InputError(f"--wait {wait:g}: expected 0 or more seconds.")
    place = store_folder(store)
    home = place / PREFECT
    stopped = stop(home, wait, _say) if home.is_dir() else None
    print(f"{place}: {'stopped' if stopped else 'nothing runs'}")


def _say(text: str) -> None:
    print(f"modelgap: {text}", file=sys.stderr, flush=True)
