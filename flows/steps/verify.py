"""Verify a whole store: what the command says, and the flow that does it by night."""

from collections import Counter
from collections.abc import Iterator
from pathlib import Path

from flows.errors import RunError
from residual.errors import InputError
from warehouse.objects.mirror import bucket_of, shown
from warehouse.verify import open_to_others, verify_all


def verify(place: Path) -> Iterator[str]:
    """Read a store and say what is not as it was written, a line each.

    Raises:
        InputError: If there is none.
        RunError: After the last line, if something is damaged or missing.
    """
    if not place.is_dir():
        raise InputError(
            f"There is no store at {shown(place)}. Say where: --store FOLDER."
        )
    counts: Counter = Counter()
    damaged = unsummed = 0
    for each in verify_all(place):
        counts[each.kind] += 1
        unsummed += not each.summed
        damaged += bool(each.faults)
        for line in each.faults:
            yield f"DAMAGED  {each.kind} {each.id}: {line}"
    told = ", ".join(f"{count} {kind}" for kind, count in counts.items())
    yield f"verified {told or 'an empty store'}"
    if unsummed:
        yield (
            f"{unsummed} of them have no sums of their files, being of an earlier "
            "version: their values were verified, and not what lies around them."
        )
    if bucket_of(place) is None and open_to_others(place):
        yield f"note: other users of this machine may look into it: chmod 700 {place}"
    again = " and run modelgap compact" if bucket_of(place) else ""
    if damaged:
        raise RunError(
            f"{damaged} of {counts.total()} are damaged. Take their folders out of the "
            f"store{again}; what can be made again is, by the same command as before."
        )
