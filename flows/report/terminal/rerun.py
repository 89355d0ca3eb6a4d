"""The outcome of a rerun in words, and as JSON."""

from collections.abc import Mapping
from dataclasses import asdict

_SHOWN = 12  # channels that are listed for people


def lines(made) -> list[str]:
    """Return what a rerun gave, line by line."""
    about = f"{made.kind} {made.id}"
    if made.reproduced and made.imported:
        return [f"{about}: measured; its values are those that were imported"]
    if made.reproduced:
        code = "" if made.same_code else "; the code is another, the values are not"
        out = [f"{about}: same, bit for bit{code}"]
    else:
        out = [f"{about}: not the same"]
        out += [f"  {channel.words}" for channel in made.apart[:_SHOWN]]
        if len(made.apart) > _SHOWN:
            out.append(f"  and {len(made.apart) - _SHOWN} more")
        out.append(f"cause, most probably: {made.cause.kind}: {made.cause.why}")
    out.append(made.changes)
    if made.made:
        out.append(f"stored, a rerun of it: modelgap show {made.made}")
    if made.noted:
        out.append(f"kept on record: modelgap show {made.noted}")
    return out


def record(made) -> Mapping:
    """Return the same as JSON can hold it."""
    cause = made.cause and {"kind": made.cause.kind, "why": made.cause.why}
    return {
        "id": made.id,
        "kind": made.kind,
        "reproduced": made.reproduced,
        "same_code": made.same_code,
        "imported": made.imported,
        "differences": [asdict(channel) for channel in made.apart],
        "cause": cause,
        "changes": made.changes,
        "made": made.made,
        "noted": made.noted,
    }
