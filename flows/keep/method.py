"""Which version of the method made a null, and whether it is this one."""

import hashlib
from collections.abc import Sequence
from functools import cache
from pathlib import Path

from residual.diagnosis.null_record import Null
from residual.robot.robot import Robot

_JUDGES = ("steps.py", "row.py", "score.py", "size.py")


def of_this_version(
    nulls: Sequence[Null], robot: Robot
) -> tuple[tuple[Null, ...], tuple[str, ...]]:
    """Return the nulls that this version of the method made, and what to say of others.

    What chance gives is what the search makes of it: another search, another null.

    Args:
        robot: The arm to be diagnosed; nothing is said of nulls of others.
    """
    if not nulls:
        return (), ()
    now = method_hash()
    old = [n for n in nulls if n.method != now and n.key.robot == robot.content_hash]
    good = tuple(n for n in nulls if n.method == now)
    if not old or any(n.key.robot == robot.content_hash for n in good):
        return good, ()
    said = old[0].method or "which it does not name"
    return good, (
        f"null {old[0].id} is not used: it was calibrated with another version of the "
        f"method ({said}, this is {now}); make it again with modelgap calibrate-null",
    )


@cache
def method_hash() -> str:
    """Return the hash of the code that diagnoses and judges, 16 hex digits."""
    root, total = Path(__file__).parents[2], hashlib.sha256()
    files = [
        *(root / "residual").rglob("*.py"),
        *(root / "flows" / "blind" / f for f in _JUDGES),
    ]
    for path in sorted(files):
        total.update(path.relative_to(root).as_posix().encode())
        total.update(path.read_bytes())
    return total.hexdigest()[:16]
