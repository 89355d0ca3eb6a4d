"""Score the answers of any program on an exported study. Needs NumPy and nothing else.

    python sealed/score.py answers.json [--json scores.json] [--answered-only]

What an answer is, and what each figure means, stands in README.md. This file is copied
into every export, so it imports nothing of the program that wrote it.
"""

import argparse
import json
import sys
from pathlib import Path

import numpy as np

LEVELS = ("name", "equivalent", "class")
COUNTS = ("exact", "true", "said", "found", "there")
KINDS = ("single", "pair", "none", "unknown")
BLOCK, EDGE = 25, 5  # samples that are averaged; averages dropped at both ends
OTHER = "other"


class AnswerError(Exception):
    """An answers file that does not say what it should."""


def main(words=None):
    """Read the answers, print the table, write the scores."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("answers", type=Path)
    parser.add_argument("--json", type=Path, help="file for all figures")
    parser.add_argument("--answered-only", action="store_true", help="no other cases")
    args = parser.parse_args(words)
    place = Path(__file__).resolve().parent / "truth.json"
    try:
        truth = json.loads(place.read_text(encoding="utf-8"))
        answers = json.loads(args.answers.read_text(encoding="utf-8"))
        rows = score_all(truth, answers, (place.parent, args.answers.parent))
    except (AnswerError, OSError, ValueError) as error:
        print(f"score.py: {error}", file=sys.stderr)
        return 2
    if args.answered_only:
        rows = [row for row in rows if row["answered"]]
    scores = summed(rows) | {"program": answers.get("program", "")}
    print(table(scores))
    if args.json:
        args.json.write_text(json.dumps(scores | {"cases": rows}, indent=1) + "\n")
    return 0


def score_all(truth, answers, folders):
    """Return one row per case; folders are those of the truth and of the answers."""
    said = answers.get("cases") if isinstance(answers, dict) else None
    if not isinstance(said, dict):
        raise AnswerError('expected an object with "cases": {"case_001": ...}')
    for case in sorted(set(said) - set(truth["cases"])):
        raise AnswerError(f"{case} is no case of this study")
    predictions = folders[1] / answers.get("predictions", "predictions")
    rows = []
    for case, true in truth["cases"].items():
        answer = read_answer(case, said.get(case), truth["classes"])
        row = judged(true, answer, truth["classes"])
        if case in said:
            own = folders[0] / case, predictions / case
            row |= torque_ratios(true, answer, truth["classes"], own)
        rows.append({"case": case, "answered": case in said, **row})
    return rows


def read_answer(case, entry, classes):
    """Return findings (each a list of names, its own first) and the flag."""
    if entry is None or isinstance(entry, str):
        if entry not in (None, "nothing", "unknown"):
            raise AnswerError(f'{case}: "{entry}", expected "nothing" or "unknown"')
        # No answer is neither: it is right about nothing.
        flag = {None: None, "nothing": False, "unknown": True}[entry]
        return {"findings": [], "flag": flag, "where": []}
    if isinstance(entry, list):
        entry = {"findings": entry}
    flag = entry.get("unknown", False)
    return {
        "findings": [named(case, f, classes) for f in entry.get("findings", [])],
        "flag": bool(flag) or isinstance(flag, list),
        "where": flag if isinstance(flag, list) else [],
    }


def named(case, finding, classes):
    """Return the names of one finding: its own, then those it may be instead."""
    out = []
    for one in (finding, *finding.get("or", [])):
        effect, joints = one.get("effect"), one.get("joints", [])
        if effect not in classes and effect not in classes.values():
            raise AnswerError(f"{case}: no effect is called {effect!r}; classes.json")
        if not all(isinstance(j, int) and j >= 1 for j in joints):
            raise AnswerError(f"{case}: joints are numbers from 1, got {joints}")
        out.append((effect, tuple(sorted(joints))))
    return out


def meets(one, other):
    """Whether two names of classes may be the same: of one class, on a common joint."""
    apart = one[1] and other[1] and not set(one[1]) & set(other[1])
    return one[0] == other[0] and not apart


def matched(truths, said, fits):
    """Return the number of a name for as many truths as can have one (Kuhn 1955)."""
    owner = {}

    def place(name, tried):
        for i, truth in enumerate(truths):
            if i not in tried and fits(truth, said[name]):
                tried.add(i)
                if i not in owner or place(owner[i], tried):
                    owner[i] = name
                    return True
        return False

    for name in range(len(said)):
        place(name, set())
    return owner


FITS = {
    "name": lambda truth, names: truth == names[0],
    "equivalent": lambda truth, names: truth in names,
    "class": meets,
}


def judged(true, answer, classes):
    """Return what an answer is worth on one case, at every level."""
    kind, flag = true["kind"], answer["flag"]
    there = [(e["effect"], tuple(sorted(e["joints"]))) for e in true["effects"]]
    # What has no name cannot be named: only the flag is right.
    there = [] if kind == "unknown" else there
    levels = {}
    for level in LEVELS:
        truths, said = there, answer["findings"]
        if level == "class":
            truths = as_classes(there, classes)
            said = as_classes([names[0] for names in said], classes)
        owner = matched(truths, said, FITS[level])
        found = len(owner) + (level == "class") * by_flag(truths, owner, answer)
        exact = found == len(truths) and len(owner) == len(said)
        if not there:
            exact = not said and flag is (kind == "unknown")
        counts = (exact, len(owner), len(said), found, len(truths))
        levels[level] = dict(zip(COUNTS, counts, strict=True))
    joints = {j for names in answer["findings"] for j in names[0][1]}
    real = {j for e in true["effects"] for j in e["joints"]}
    on = joints if joints else set(answer["where"])
    # Where there is nothing on a joint, or nothing said of one, none can be right.
    joint = bool(on & real) if real and on else None
    said = {"named": bool(answer["findings"]), "flagged": bool(flag)}
    return {"kind": kind, "levels": levels, **said, "joint": joint}


def as_classes(names, classes):
    """Return the class and the joints of each name, none of them twice."""
    return list(dict.fromkeys((classes.get(name, name), on) for name, on in names))


def by_flag(truths, owner, answer):
    """Return how many truths of the class "other" the word "unknown" stands for."""
    left = [t for i, t in enumerate(truths) if i not in owner and answer["flag"]]
    return sum(meets(t, (OTHER, tuple(answer["where"]))) for t in left)


def torque_ratios(true, answer, classes, folders):
    """Return errors over the oracle's: held-out, and of each effect taken out again."""
    sealed, own = folders
    logs = [log for log in true["held_out"] if (own / f"{log}.csv").is_file()]
    held = [miss(sealed / f"{log}.csv", own / f"{log}.csv") for log in logs]
    whole, edits = len(held) == len(true["held_out"]) > 0, []
    for log, number in true["after"].items():
        if number is None:
            continue
        effect = true["effects"][number]
        name = effect["effect"], tuple(sorted(effect["joints"]))
        k = stands_for(name, answer, classes)
        path = own / f"finding_{k}_{log}.csv"
        if k and path.is_file():
            edits.append(ratio([miss(sealed / f"{log}.csv", path)]))
    return {"held_out": ratio(held) if whole else None, "edits": edits}


def stands_for(truth, answer, classes):
    """Return the number (from 1) of the finding that stands for an effect, or None."""
    for level in LEVELS:
        for number, names in enumerate(answer["findings"], start=1):
            one, two = truth, names
            if level == "class":
                (one,), (two,) = (as_classes([n], classes) for n in (truth, names[0]))
            if FITS[level](one, two):
                return number
    return None


def miss(sealed, own):
    """Return squared errors of program and oracle where joints move [N^2 m^2]."""
    every = np.loadtxt(sealed, delimiter=",", skiprows=1, ndmin=2)[:, 1:]
    tau, oracle, moves = np.split(every, 3, axis=1)
    told = np.loadtxt(own, delimiter=",", skiprows=1, ndmin=2)
    if told.shape != tau.shape or not np.isfinite(told).all():
        raise AnswerError(f"{own}: {told.shape}, expected {tau.shape}, all finite")
    # At standstill any torque up to friction holds.
    inside = smooth(moves) > 1 - 1e-6
    return [float((smooth(x - tau)[inside] ** 2).sum()) for x in (told, oracle)]


def smooth(rows):
    """Return means of samples in blocks, without the ends. Shape (n // BLOCK, dof)."""
    n = len(rows) // BLOCK
    return rows[: n * BLOCK].reshape(n, BLOCK, -1).mean(axis=1)[EDGE:-EDGE]


def ratio(misses):
    """Return the program's error over the oracle's, of all logs together."""
    own, oracle = np.sum(misses, axis=0)
    return float(np.sqrt(own / oracle)) if oracle > 0 else None


def summed(rows):
    """Return all figures by kind of case; "all" for every case."""
    kinds = {kind: [r for r in rows if r["kind"] == kind] for kind in KINDS}
    figures = {kind: figures_of(own) for kind, own in kinds.items() if own}
    return {
        "answered": sum(row["answered"] for row in rows),
        "of": len(rows),
        "kinds": figures | {"all": figures_of(rows)},
    }


def figures_of(rows):
    """Return the figures of some cases."""

    def total(level, key):
        return sum(row["levels"][level][key] for row in rows)

    levels = {
        level: {
            "exact": rate(total(level, "exact"), len(rows)),
            "precision": rate(total(level, "true"), total(level, "said")),
            "recall": rate(total(level, "found"), total(level, "there")),
        }
        for level in LEVELS
    }
    joint = [row["joint"] for row in rows if row["joint"] is not None]
    held = [row["held_out"] for row in rows if row.get("held_out") is not None]
    edits = [e for row in rows for e in row.get("edits", ()) if e is not None]
    return {
        "n": len(rows),
        "levels": levels,
        "named": rate(sum(row["named"] for row in rows), len(rows)),
        "flagged": rate(sum(row["flagged"] for row in rows), len(rows)),
        "joint": rate(sum(joint), len(joint)),
        "held_out_over_oracle": middle(held),
        "edit_over_oracle": middle(edits),
    }


def rate(hits, n):
    """Return a rate with its 95 % interval (Wilson 1927)."""
    if not n:
        return {"value": None, "hits": 0, "n": 0, "interval": [0.0, 1.0]}
    z, p = 1.959964, hits / n
    centre = p + z * z / (2 * n)
    half = z * np.sqrt(p * (1 - p) / n + z * z / (4 * n * n))
    ends = np.clip(np.array([centre - half, centre + half]) / (1 + z * z / n), 0, 1)
    interval = [round(float(x), 4) for x in ends]
    return {"value": p, "hits": int(hits), "n": int(n), "interval": interval}


def middle(values):
    """Return the median of some numbers, None of none."""
    return {"median": float(np.median(values)) if values else None, "n": len(values)}


def table(scores):
    """Return the figures as text, a line per kind of case and level."""
    lines = ["{program}: {answered} of {of} answered".format(**scores)]
    lines += [f"{'cases':8} {'level':10} exact set      precision      recall"]
    for kind, own in scores["kinds"].items():
        for level, figures in own["levels"].items():
            cells = [figures[k] for k in ("exact", "precision", "recall")]
            text = "  ".join(f"{c['hits']:4} of {c['n']:<5}" for c in cells)
            lines.append(f"{kind:8} {level:10} {text}".rstrip())
        more = [f"named {own['named']['hits']}", f"flagged {own['flagged']['hits']}"]
        more.append(f"joint {own['joint']['hits']} of {own['joint']['n']}")
        for key in ("held_out_over_oracle", "edit_over_oracle"):
            if own[key]["n"]:
                more.append(f"{key} {own[key]['median']:.3g} ({own[key]['n']})")
        lines.append(f"{'':8} {', '.join(more)}")
    return "\n".join(lines)


if __name__ == "__main__":
    sys.exit(main())
