"""Where things are kept, and how Prefect is told to be quiet and stay at home."""

import errno
import os
import socket
import tomllib
from pathlib import Path

from residual.errors import InputError
from warehouse.bucket import is_address

HEALTHY = "healthy"  # tag of the runs of an arm in good order, unless a project has one
PROJECT = "modelgap.toml"  # file of a project, which names its store
ROOT = Path(__file__).resolve().parents[1]
# Where prefect.yaml and the examples lie: a wheel has copies of them (setup.py).
SHARED = ROOT if (ROOT / "prefect.yaml").is_file() else ROOT / "flows" / "shared"
STORE, API = "MODELGAP_STORE", "PREFECT_API_URL"
# Where the server of a store serves its pages; its workers are told.
PAGES = "MODELGAP_PAGES"
PREFECT = "_prefect"  # folder of Prefect in the store
ONE_THREAD = {
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "MKL_NUM_THREADS": "1",
}


def store_folder(option: str | None = None) -> Path:
    """Return the store: --store, else $MODELGAP_STORE, else that of a project, ./store.

    A project is a working directory with a modelgap.toml.

    Args:
        option: A folder, or s3://BUCKET/PREFIX, of which the folder of this machine
            beside it is returned (`warehouse.remote`).
    """
    word = str(option or os.environ.get(STORE) or _of_project())
    if is_address(word):
        from warehouse.remote import local_folder

        return local_folder(word)
    place = Path(word).resolve()
    for folder in (place, *place.parents):
        if folder.exists():
            if folder.is_dir():
                return place
            raise InputError(f"--store {place}: {folder} is a file, not a folder.")
    return place


def page_link(address: str, otherwise: Path) -> str:
    """Return where a browser finds a page of the store.

    Args:
        address: Below the first folder of the pages, such as "index.html".
    """
    first = os.environ.get(PAGES)
    return f"{first}/{address}" if first else otherwise.as_uri()


def _of_project() -> str:
    # What else is in it is checked where it is used (`flows.project.read`).
    try:
        named = tomllib.loads(Path(PROJECT).read_text(encoding="utf-8")).get("store")
    except (OSError, ValueError, RecursionError):
        named = None
    return named if isinstance(named, str) and named else "store"


def cores() -> int:
    """Return the number of cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1  # Windows and macOS tie no process to some


def port_is_free(host: str, port: int) -> bool:
    """Return whether nobody listens there."""
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    with socket.socket(family) as probe:
        # As the server will do it: what has just ended does not count.
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((host, port))
        except PermissionError:
            raise InputError(
                f"--port {port} is for the administrator; take 1024 or more."
            ) from None
        except OSError as error:
            if error.errno == errno.EADDRINUSE:
                return False
            raise InputError(f"--host {host}: {error.strerror}.") from error
    return True


def prefect_home(store: Path) -> Path:
    """Return Prefect's home, made if it is not there: for the owner's eyes only."""
    home = store / PREFECT
    store.mkdir(mode=0o700, parents=True, exist_ok=True)
    home.mkdir(mode=0o700, exist_ok=True)
    if home.stat().st_mode & 0o077:  # made by hand, or unpacked
        home.chmod(0o700)
    return home


def quiet_prefect(home: Path) -> dict[str, str]:
    """Return the settings under which Prefect calls nobody and stays in its folder.

    They must be in the environment before Prefect is imported.

    Args:
        home: Where its files go; nothing of it lies about anywhere else.
    """
    return {
        # Both are needed: either alone leaves a heartbeat with a traceback.
        "DO_NOT_TRACK": "1",
        "PREFECT_SERVER_ANALYTICS_ENABLED": "false",
        # Logs of flows and tasks go to the server; people read our own progress.
        "PREFECT_LOGGING_HANDLERS_CONSOLE_LEVEL": "CRITICAL",
        "PREFECT_RESULTS_DEFAULT_SERIALIZER": "json",
        # Not those of the user, nor a file in the working directory.
        "PREFECT_PROFILES_PATH": str(home / "profiles.toml"),
        "PREFECT_HOME": str(home),
    }
