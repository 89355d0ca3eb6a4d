"""What a verdict is worth beside the one truth of a demonstration."""

from residual.diagnosis.result import Verdict


def judge(truth: list | None, verdict: Verdict) -> dict:
    """Score a verdict.

    Right: the first finding is the truth, or the truth is among its equivalents. Wrong:
    there is a first finding and it is not that. For a truth out of the vocabulary
    ("x_..."), right is a flag on its joint without a name. Further names are extra.

    Args:
        truth: Name and joints, None for a null case.
    """
    found = verdict.effects
    names = [_key(e.name, e.joints) for e in found]
    flagged = list(verdict.unexplained.joints)
    unnamed = truth is not None and truth[0].startswith("x_")
    if truth is None or unnamed:
        seen = bool(unnamed and truth[1][0] in flagged)
        score = "wrong" if names else "right" if truth is None or seen else "nothing"
        extra = names[1:]
    elif not names:
        score, extra = "nothing", []
    else:
        classes = [_key(e.name, e.joints) for e in found[0].equivalent]
        score = "right" if truth in [names[0], *classes] else "wrong"
        extra = [name for name in names[1:] if name != truth]
    shown = [
        [*_key(e.name, e.joints), e.evidence.by, e.evidence.nats, e.evidence.held_out]
        for e in found
    ]
    return {
        "score": score,
        "first": names[0] if names else None,
        "exact": bool(names) and names[0] == truth,
        "extra": extra,
        "found": shown,
        "verdict": verdict.verdict,
        "unexplained": flagged,
        "warnings": list(verdict.warnings),
    }


def told(record: dict) -> str:
    """Return what was found, in a few words."""
    if record["score"] == "crash":
        return record["error"]
    names = [f"{f[0]} {f[1]} ({f[2]}, {f[3]:.0f} nats)" for f in record["found"]]
    return "; ".join(names) or f"nothing (unexplained {record['unexplained']})"


def _key(name: str, joints: object) -> list:
    return [name, sorted(int(j) for j in joints)]
