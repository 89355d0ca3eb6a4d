"""modelgap pages: every page over a store as files, without a server."""

from pathlib import Path

from flows.outputs import check_new_folder, check_outside, write_all
from flows.report.night.look import unknown
from flows.report.night.site import Site
from flows.service.api import Api, answers, past_of
from flows.service.state import read_running, store_key
from flows.settings import PREFECT, store_folder


def pages(*, out: str, store: str | None = None) -> None:
    """Write the pages of all nights, robots and reports into a folder.

    ```
    modelgap pages --out morning
    ```

    They are those that modelgap up serves: a page per night and per robot, an index of
    all reports, and a page of every record that one of them links. They need no server
    and load nothing from elsewhere; open index.html, or send the folder to somebody.
    What failed in a night is known to the server of the store only: while that does
    not run, the pages say so.

    Args:
        out: Folder to write them into; a new one, or an empty one.
        store: Folder of the store; else $MODELGAP_STORE, else ./store.
    """
    place, folder = store_folder(store), Path(out)
    check_new_folder("--out", folder)
    check_outside("--out", out, place)
    count = 0
    for address, page in _site(place).files():
        path = folder / address
        path.parent.mkdir(parents=True, exist_ok=True)
        write_all({path: page})
        count += 1
    print(f"{count} pages: {folder / 'index.html'}")


def _site(store: Path) -> Site:
    home = store / PREFECT
    running = read_running(home)
    if running is None or not running.server or not answers(running.url):
        return Site(store, None, unknown)
    return Site(store, f"{running.ui}/", past_of(Api(running.url, store_key(home))))
