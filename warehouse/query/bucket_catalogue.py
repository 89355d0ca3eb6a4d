"""The list of all records of a store on object storage, for SQL."""

from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path

import pyarrow as pa

from residual.errors import InputError
from warehouse.kinds import KINDS
from warehouse.objects.compact import all_records, append, replace
from warehouse.objects.listing import bring_rows, read_listing, read_rows
from warehouse.query.rows import Catalogue, read_new

# So many rows may be outside of the catalogue files before who reads them adds them.
_SPARE = 32

Places = Mapping[str, Mapping[str, str]]
Rows = Mapping[str, pa.Table]


def read_bucket(store: Path, before: Catalogue | None = None) -> Catalogue:
    """List a store, and bring its catalogue up to date where that pays.

    Args:
        before: What was read earlier; it is given back if nothing has changed.

    Raises:
        InputError: If the bucket does not answer, or its catalogue is damaged.
    """
    listing = read_listing(store)
    if not listing.head.number:
        return rebuild(store)[0]
    if before is not None and before.folders == _folders(store, listing.places):
        return before
    known = {k: read_rows(store, listing.head, kind) for k, kind in KINDS.items()}
    catalogue, new = _filled(store, listing.places, known)
    if sum(map(len, new.values())) > _SPARE:
        # Who may only read is served too, only slower.
        with suppress(InputError):
            append(store, new)
    return catalogue


def rebuild(store: Path) -> tuple[Catalogue, bool]:
    """Make the catalogue of a store again, from its records.

    Returns:
        The catalogue, and whether it could be written.

    Raises:
        InputError: If the bucket does not answer.
    """
    none = {name: kind.fields.empty_table() for name, kind in KINDS.items()}
    catalogue, rows = _filled(store, all_records(store), none)
    with suppress(InputError):
        return catalogue, replace(store, rows)
    return catalogue, False


def _folders(store: Path, places: Places) -> dict[str, dict[str, str]]:
    base = str(store)
    return {
        kind: {id: f"{base}/{folder}" for id, folder in found.items()}
        for kind, found in places.items()
    }


def _filled(store: Path, places: Places, known: Rows) -> tuple[Catalogue, Rows]:
    """Return the catalogue, and those of its rows that were read from records."""
    folders, rows, new, damaged = _folders(store, places), {}, {}, {}
    for name, kind in KINDS.items():
        missing = folders[name].keys() - set(known[name].column(kind.key).to_pylist())
        wanted = sorted(missing)
        bring_rows(store, [(name, id) for id in wanted], places)
        read, bad = read_new(wanted, kind, folders[name])
        new[name] = pa.concat_tables([kind.fields.empty_table(), *read])
        both = pa.concat_tables([known[name], new[name]]).combine_chunks()
        rows[name] = both.sort_by([("created", "ascending"), (kind.key, "ascending")])
        damaged[name] = tuple(bad)
    return Catalogue(folders, rows, damaged), new
