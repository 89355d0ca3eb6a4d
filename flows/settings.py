"""Folders, environment variables, and the settings of Prefect."""

import errno
import os
import socket
import tomllib
from contextlib import suppress
from getpass import getuser
from pathlib import Path

from residual.errors import InputError
from warehouse.bucket import is_bucket_address

HEALTHY = "healthy"  # tag of the runs of a healthy arm, unless a project sets another
PROJECT = "modelgap.toml"  # file of a project
ROOT = Path(__file__).resolve().parents[1]
# Folder of prefect.yaml and the examples; a wheel has copies of them (setup.py).
SHARED = ROOT if (ROOT / "prefect.yaml").is_file() else ROOT / "flows" / "shared"
STORE, API = "MODELGAP_STORE", "PREFECT_API_URL"
# Address of the pages of the server, for its workers.
PAGES = "MODELGAP_PAGES"
PREFECT = "_prefect"  # folder of Prefect in the store
ONE_THREAD = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}


def resolve_store_folder(option: str | None = None) -> Path:
    """Return the store: --store, $MODELGAP_STORE, that of modelgap.toml, or ./store.

    Of s3://BUCKET/PREFIX it is the local folder (`warehouse.remote_store`).
    """
    word = option or os.environ.get(STORE)
    if not word:  # `flows.project` checks the rest of the file
        with suppress(OSError, ValueError, RecursionError):
            word = tomllib.loads(Path(PROJECT).read_text(encoding="utf-8")).get("store")
    word = str(word) if word and isinstance(word, str | Path) else "store"
    if is_bucket_address(word):
        from warehouse.remote_store import find_local_copy

        return find_local_copy(word)
    place = Path(word).resolve()
    for folder in (place, *place.parents):
        if folder.exists():
            if folder.is_dir():
                return place
            raise InputError(f"--store {place}: {folder} is a file, not a folder.")
    return place


def build_page_address(address: str, otherwise: Path) -> str:
    """Return the address of a page of the store, such as "index.html"."""
    first = os.environ.get(PAGES)
    return f"{first}/{address}" if first else otherwise.as_uri()


def read_user_name() -> str:
    """Return the name of the user, for records."""
    try:
        return getuser()
    except (KeyError, OSError):  # a container may have no name for its user
        return "unknown"


def count_cores() -> int:
    """Return the number of cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1  # Windows and macOS have no affinity


def port_is_free(host: str, port: int) -> bool:
    """Return whether no program listens on a port."""
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    with socket.socket(family) as probe:
        # As the server does: a connection that has just ended does not count.
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((host, port))
        except PermissionError:
            raise InputError(
                f"--port {port} needs administrator rights; choose 1024 or more."
            ) from None
        except OSError as error:
            if error.errno == errno.EADDRINUSE:
                return False
            raise InputError(f"--host {host}: {error.strerror}.") from error
    return True


def prefect_home(store: Path) -> Path:
    """Return Prefect's home, created if needed, readable by its owner only."""
    home = store / PREFECT
    store.mkdir(mode=0o700, parents=True, exist_ok=True)
    home.mkdir(mode=0o700, exist_ok=True)
    if home.stat().st_mode & 0o077:  # created by hand, or unpacked
        home.chmod(0o700)
    return home


def build_prefect_environment(home: Path) -> dict[str, str]:
    """Return the environment in which Prefect sends nothing and writes to `home` only.

    It must be set before Prefect is imported.
    """
    return {
        # Both are needed: either alone leaves a heartbeat with a traceback.
        "DO_NOT_TRACK": "1",
        "PREFECT_SERVER_ANALYTICS_ENABLED": "false",
        # Logs of flows and tasks go to the server.
        "PREFECT_LOGGING_HANDLERS_CONSOLE_LEVEL": "CRITICAL",
        "PREFECT_RESULTS_DEFAULT_SERIALIZER": "json",
        # Not those of the user, nor a file in the working directory.
        "PREFECT_PROFILES_PATH": str(home / "profiles.toml"),
        "PREFECT_HOME": str(home),
    }
