"""Group 2: synthetic arms that hide one effect, or none."""

from collections import Counter, defaultdict
from time import perf_counter

from benchmarks.figures import Figures, figure
from flows.blind.sums import wilson
from residual.close import close_the_loop
from residual.diagnosis.result import Verdict
from sim.draw import usual_effects
from sim.synthetic.logs import standard_case

EFFECTS = tuple(usual_effects())
_FEW = "too few draws, or not the deciding ones; the full run decides"
_NO_BAR = "for information, no bar of its own"


def run_single(task: tuple[str | None, int]) -> dict:
    """Draw one case, diagnose it and judge the answer.

    Args:
        task: Name of the hidden effect (None for a null case) and seed.

    Returns:
        Truth, findings and score: "right", "wrong", "nothing" or "crash".
    """
    effect, seed = task
    case = standard_case(effect, seed)
    truth = None if case.truth is None else _key(case.truth.name, case.truth.joints)
    record = {"effect": effect, "seed": seed, "truth": truth}
    start = perf_counter()
    try:
        verdict = close_the_loop(
            case.robot, case.fit, case.baseline, case.held_out, case.declared
        ).verdict
    except Exception as error:
        # A benchmark of hundreds of cases reports a crash as a result and goes on.
        text = f"{type(error).__name__}: {error}"
        return {**record, "score": "crash", "error": text, "extra": []}
    record |= judge(truth, verdict)
    record["size"] = {} if case.truth is None else _size(case.truth.parameters)
    record["seconds"] = round(perf_counter() - start, 2)
    return record


def judge(truth: list | None, verdict: Verdict) -> dict:
    """Score a verdict.

    Right: the first finding is the truth, or the truth is among its equivalents. Wrong:
    there is a first finding and it is not that. For a truth out of the vocabulary
    ("x_..."), right is a flag on its joint without a name. Further names are extra.

    Args:
        truth: Name and joints, None for a null case.
        verdict: The verdict.
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


def singles_figures(records: list[dict], small: bool) -> Figures:
    """Return rates of right and wrong first names, extra names, and false alarms.

    Args:
        records: Judged cases.
        small: Whether there are too few, or not the deciding ones, to hold to a bar.
    """
    singles = [r for r in records if r["effect"] in EFFECTS]
    nulls = [r for r in records if r["effect"] is None]
    crashes = sum(r["score"] == "crash" for r in [*singles, *nulls])
    false_names = sum(r["score"] == "wrong" for r in nulls)
    each = _per_effect(singles)
    figures = {
        "singles_right": _rate([r["score"] == "right" for r in singles], 0.85, True)
        | {"per_effect": each},
        "singles_wrong": _rate([r["score"] == "wrong" for r in singles], 0.02),
        "nulls_named": figure(false_names if nulls else None, 0, len(nulls))
        | {"interval": wilson(false_names, len(nulls))},
        "crashes": figure(crashes, 0, len(singles) + len(nulls)),
        "singles_right_worst_effect": figure(
            min(each.values(), default=None), None, len(singles), why=_NO_BAR
        ),
        # The rest of the right ones have the truth in the class of the first name.
        "singles_right_by_name": _rate([r.get("exact", False) for r in singles], None),
        "singles_with_extra_names": _rate([bool(r["extra"]) for r in singles], None),
    }
    if small:
        for name in ("singles_right", "singles_wrong", "nulls_named"):
            figures[name] |= {"ok": None, "why": _FEW}
    return figures


def _rate(hits: list[bool], bar: float | None, at_least: bool = False) -> dict:
    n = len(hits)
    entry = figure(sum(hits) / n if n else None, bar, n)
    if at_least and n:
        entry |= {"ok": bool(entry["value"] >= bar), "at_least": True}
    if bar is None:
        entry["why"] = _NO_BAR
    return entry | {"interval": wilson(sum(hits), n)}


def show_singles(records: list[dict]) -> None:
    """Print one line per effect and every case that is not plainly right."""
    scores: dict = defaultdict(Counter)
    for record in records:
        scores[record["effect"] or "none"][record["score"]] += 1
        scores[record["effect"] or "none"]["extra"] += bool(record["extra"])
    heads = ("right", "wrong", "nothing", "crash", "extra")
    print(f"\n{'hidden effect':20}" + "".join(f"{h:>9}" for h in heads))
    for effect in sorted(scores):
        row = "".join(f"{scores[effect][h]:9}" for h in heads)
        print(f"{effect:20}{row}")
    for r in records:
        if r["score"] != "right" or r["extra"]:
            print(f"  {r['score']:8} {r['truth']} seed {r['seed']}: {told(r)}")


def told(record: dict) -> str:
    """Return what was found, in a few words."""
    if record["score"] == "crash":
        return record["error"]
    names = [f"{f[0]} {f[1]} ({f[2]}, {f[3]:.0f} nats)" for f in record["found"]]
    return "; ".join(names) or f"nothing (unexplained {record['unexplained']})"


def _per_effect(singles: list[dict]) -> dict[str, float]:
    totals, right = Counter(), Counter()
    for record in singles:
        totals[record["effect"]] += 1
        right[record["effect"]] += record["score"] == "right"
    return {name: round(right[name] / totals[name], 3) for name in sorted(totals)}


def _key(name: str, joints: object) -> list:
    return [name, sorted(int(j) for j in joints)]


def _size(parameters: object) -> dict[str, float]:
    return {key: round(float(value), 5) for key, value in parameters.items()}
