"""What must be reached on arms in use, as figures of the rows of all groups."""

from collections.abc import Callable, Mapping, Sequence
from statistics import median

from benchmarks.diagnosis_parts.bars import FAMILIES
from benchmarks.figures import Figures, figure, missing
from benchmarks.seeded import Rows, crash_figures, group_figures, undecided
from flows.blind.score import CLASS, RIGHT
from flows.blind.sums import is_clear, is_right, wilson

Hit = Callable[[Mapping], bool]

_NO_BAR = "for information, no bar of its own"
# Told of an arm of before this was thought of: no size of drift is known there.
_DRIFT_ASSUMED = 0.03

# What every joint of an arm in use has: a name of these is true of it. Cold or warm,
# with its load and at low speed, friction is not what the file declares either.
TRUE_OF_ANY_JOINT = {
    "stribeck",
    "load_friction",
    "coulomb",
    "viscous",
    "coulomb_asymmetry",
    "warmup",
    "ripple",
    "torque_gain",
    "elasticity",
    "delay",
}


def case_figures(rows: Mapping[str, Rows], deciding: bool) -> Figures:
    """Return the figures of all groups that were run.

    Args:
        rows: Rows of each group.
        deciding: Whether these are the seeds and the counts that the bars are for.
    """
    makers: Mapping[str, Callable[[Rows], Figures]] = {
        "unchanged": lambda r: _unchanged("unchanged", r, 0.02),
        "worn": lambda r: _unchanged("worn", r, 0.05),
        "change": _change,
        "detection": _detection,
        "alone": _alone,
        "strange": _strange,
    }
    figures = group_figures(rows, makers)
    if "drift" in rows:
        still = [r for g in ("drift", "unchanged", "worn") for r in rows.get(g, ())]
        figures |= _drift([r for r in still if "outcome" in r])
    figures |= crash_figures(rows)
    return figures if deciding else undecided(figures)


def cost_figures(pairs: Sequence[tuple[Mapping, Mapping]], deciding: bool) -> Figures:
    """Return the time of an arm in use over that of a clean one, in the same motions.

    Args:
        pairs: Row of the clean arm and of the same one in use.
        deciding: Whether this is a whole run.
    """
    good = [p for p in pairs if not any("error" in row for row in p)]
    if not good:
        return {"cost_ratio": missing(1.5, "no pair of arms came to its end")}
    ratios = [dirty["seconds"] / clean["seconds"] for clean, dirty in good]
    all_ = [[clean["seconds"], dirty["seconds"]] for clean, dirty in good]
    out = {"cost_ratio": figure(median(ratios), 1.5, len(ratios), seconds=all_)}
    return out if deciding else undecided(out)


def _unchanged(group: str, rows: Rows, bar: float) -> Figures:
    flagged = _most(rows, lambda r: bool(r["unexplained"]), None)
    named = _most(rows, lambda r: r["named"] > 0, bar)
    named |= {"names": _count(n[0] for r in rows for n in r["names"])}
    time = median(r["seconds"] for r in rows) if rows else None
    return {
        f"{group}_named": named,
        f"{group}_flagged": flagged,
        f"{group}_seconds": figure(time, None, len(rows), why=_NO_BAR),
    }


def _drift(rows: Rows) -> Figures:
    known = [r for r in rows if r["true_factor"] is not None]
    large = [r for r in known if abs(r["true_factor"] - 1) >= _least(r)]
    told = [r for r in known if r["drift"]]

    def near(row: Mapping) -> bool:
        drift = row["drift"]
        return abs(drift["factor"] - row["true_factor"]) <= 2 * drift["std"]

    return {
        "drift_told": _at_least(large, _told, 0.90),
        "drift_within_two_deviations": _at_least(told, near, None),
        "drift_told_where_small": _most(
            [r for r in known if abs(r["true_factor"] - 1) < 0.5 * _least(r)],
            lambda r: bool(r["drift"]),
            None,
        ),
    }


def _least(row: Mapping) -> float:
    known = row["drift_detectable"]
    return _DRIFT_ASSUMED if known is None else float(known)


def _told(row: Mapping) -> bool:
    """Whether drift is told, and in the right direction."""
    drift = row["drift"]
    return bool(drift) and (drift["factor"] - 1) * (row["true_factor"] - 1) > 0


def _change(rows: Rows) -> Figures:
    # As in the sealed study: where torque is in proportion to no size, a usual one.
    clear = [r for r in rows if is_clear(r) or r["multiple"] is None]
    sized = [r for r in clear if r["z"] is not None]
    return {
        "change_right_first": _at_least(clear, _right_first, 0.90) | _by_effect(clear),
        "change_false_beside": _most(clear, lambda r: r["extra"] > 0, 0.05)
        | {"names": _count(n for r in clear for n in _beside(r))},
        "change_size_within_two_deviations": _at_least(
            sized, lambda r: abs(r["z"]) <= 2, 0.90
        ),
        "change_too_small": figure(
            len(rows) - len(clear), None, len(rows), why=_NO_BAR
        ),
    }


def _detection(rows: Rows) -> Figures:
    small = [r for r in rows if r["multiple"] is not None and r["multiple"] <= 1.2]
    entry = _rate(small, _right_first)
    inside = entry["value"] is not None and 0.35 <= entry["value"] <= 0.65
    every = {"detection": {**entry, "bar": 0.65, "low": 0.35, "ok": inside}}
    for family, names in FAMILIES.items():
        own = [r for r in small if r["effect"] in names]
        key = f"detection_{family.replace(' ', '_')}"
        every[key] = _rate(own, _right_first) | {"why": _NO_BAR}
    return every


def _alone(rows: Rows) -> Figures:
    clear = [r for r in rows if is_clear(r) or r["multiple"] is None]
    said = [(r, names) for r in rows for names in r["classes"]]
    true = sum(_is_true(r, names) for r, names in said)
    folded = [(r, [n]) for r in rows for n in r["background_names"]]
    well = sum(_is_true(r, names) for r, names in folded)
    return {
        "alone_names_true": _share(true, len(said), 0.97)
        | {"false": _count(n[0][0] for r, n in said if not _is_true(r, n))},
        "alone_background_true": _share(well, len(folded), None),
        "alone_main_listed": _at_least(clear, lambda r: r["found"] > 0, 0.90)
        | _by_effect(clear),
        "alone_main_first": _at_least(clear, is_right, 0.80),
    }


def _strange(rows: Rows) -> Figures:
    flagged = _at_least(rows, lambda r: bool(r["unexplained"]), 0.90)
    return {"unknown_flagged": flagged | _by_effect(rows)}


def _right_first(row: Mapping) -> bool:
    """Whether the change is the first name, or of its class, whatever stands beside."""
    return row["outcome"] in (RIGHT, CLASS)


def _is_true(row: Mapping, names: Sequence) -> bool:
    """Whether a name, or one that the logs cannot tell from it, is true of the arm."""
    hidden = [row["effect"], row["joints"]]
    return any(list(n) == hidden or n[0] in TRUE_OF_ANY_JOINT for n in names)


def _beside(row: Mapping) -> list[str]:
    hidden = [row["effect"], row["joints"]]
    return [c[0][0] for c in row["classes"] if hidden not in [list(n) for n in c]]


def _count(names) -> dict[str, int]:
    out: dict[str, int] = {}
    for name in names:
        out[name] = out.get(name, 0) + 1
    return dict(sorted(out.items(), key=lambda item: -item[1]))


def _rate(rows: Rows, hit: Hit) -> dict:
    """Return a rate with its interval, and its counts on each kind of arm."""
    n, hits = len(rows), sum(bool(hit(r)) for r in rows)
    each = {k: [r for r in rows if r["data"] == k] for k in {r["data"] for r in rows}}
    of = {k: [sum(bool(hit(r)) for r in v), len(v)] for k, v in sorted(each.items())}
    value = hits / n if n else None
    return figure(value, None, n, hits=hits, interval=wilson(hits, n), data=of)


def _at_least(rows: Rows, hit: Hit, bar: float | None) -> dict:
    return _with_bar(_rate(rows, hit), bar)


def _share(hits: int, n: int, bar: float | None) -> dict:
    value = hits / n if n else None
    return _with_bar(figure(value, None, n, interval=wilson(hits, n)), bar)


def _with_bar(entry: dict, bar: float | None) -> dict:
    if bar is None:
        return entry | {"why": _NO_BAR}
    ok = None if entry["value"] is None else bool(entry["value"] >= bar)
    return entry | {"bar": bar, "ok": ok, "at_least": True}


def _most(rows: Rows, hit: Hit, bar: float | None) -> dict:
    entry = _rate(rows, hit)
    if bar is None:
        return entry | {"why": _NO_BAR}
    ok = None if entry["value"] is None else bool(entry["value"] <= bar)
    return entry | {"bar": bar, "ok": ok}


def _by_effect(rows: Rows, hit: Hit | None = None) -> dict:
    each: dict[str, list[bool]] = {}
    for row in rows:
        right = (hit or _right_first)(row)
        each.setdefault(row["effect"], []).append(right)
    return {"per_effect": {k: [sum(v), len(v)] for k, v in sorted(each.items())}}
