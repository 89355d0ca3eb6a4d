"""modelgap bundle and unbundle: a record and its ancestors to another machine."""

from pathlib import Path

from flows.cli.options import Flag
from flows.outputs import check_outside
from flows.settings import store_folder
from warehouse.bundle import read_bundle, write_bundle
from warehouse.objects.mirror import shown


def bundle(
    id: str,
    /,
    *,
    out: str,
    without_seal: Flag = False,
    store: str | None = None,
) -> None:
    """Write a record with all that it was made from into one file.

    ```
    modelgap bundle 3f2a --out run.tar
    ```

    On the other machine, with this program at the same commit:

    ```
    modelgap unbundle run.tar --store there
    modelgap rerun 3f2a --verify --store there
    ```

    The sealed halves of simulated runs are in it: without them no run can be made
    again, with them its reader can look at what was hidden.

    Args:
        id: Its id; the beginning is enough.
        out: The file to write; its name ends in .tar.
        without_seal: Leave out what simulated runs hide.
        store: Folder of the store; else $MODELGAP_STORE, else ./store.
    """
    place = store_folder(store)
    check_outside("--out", out, place)
    made = write_bundle(place, id, Path(out), not without_seal)
    for kind, each in made.records:
        print(f"{kind:12} {each}")
    print(f"wrote {out}, {made.size / 1e6:.1f} MB")
    if made.seals:
        print("It has sealed halves: its reader can look at what was hidden.")
    if made.changes:
        print("It has uncommitted changes of the code, as a patch.")
    if made.left_out:
        print(
            f"{made.left_out} sealed halves were left out: those runs cannot be made "
            "again from it."
        )


def unbundle(file: str, /, *, store: str | None = None) -> None:
    """Add the records of a bundle to a store.

    ```
    modelgap unbundle run.tar --store there
    ```

    Paths, sizes and hashes are checked, and that each record is what its id says,
    before any of it is in the store. A record that is there already is left as it is.

    Args:
        file: A file that modelgap bundle wrote.
        store: Folder of the store; else $MODELGAP_STORE, else ./store.
    """
    place = store_folder(store)
    done = read_bundle(Path(file), place)
    for path in done.added:
        print(f"added   {path}")
    for path in done.known:
        print(f"is there {path}")
    print(f"{len(done.added)} added to {shown(place)}: modelgap show {done.about[:8]}")
