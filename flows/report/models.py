"""Models in the terminal: what was identified, its errors on logs, what was adopted."""

from collections.abc import Sequence

import numpy as np

from flows.report.document import Document, Section, Table, words_table
from flows.report.page import Pairs, render
from flows.report.words.phrases import texts
from flows.report.words.verdict import sentences
from flows.steps.adopt import AdoptionEntry, Judgment, Proposal
from residual.diagnosis.result import ErrorTables
from residual.errors import joints_listed
from residual.identification.prove import ValidatedIdentification
from residual.model.compare import EDITED, WHOLE
from residual.quantity import bare_percent, known, percent

_TEXT = texts()["proposal"]

_KINDS = (("raw", "as logged"), ("filtered", "filtered"), ("moving", "moving"))
_PREDICTED = (("held_out", "as logged"), ("filtered", "filtered"), ("moving", "moving"))
_WHICH = {WHOLE: "", EDITED: "\nedited"}
ADOPTED_KEY = "* the model that commands on this store go by"


def identification(outcome: ValidatedIdentification) -> list[str | Table]:
    """Return an identification: parameters, what to doubt, errors, proof."""
    return [
        _parameters(outcome),
        *_fit(outcome),
        *(f"warning: {w}" for w in outcome.warnings),
        _errors(outcome),
        *_proof(outcome),
    ]


def _parameters(outcome: ValidatedIdentification) -> Table:
    found, extra = outcome.free, outcome.consistent
    heads = ["parameter (as a sum of standard ones)", "unit", "nominal", "value"]
    heads += ["sd", "sd %"] + (["consistent"] if extra else [])
    base, estimate = found.base, found.estimate
    other = base.mapping @ extra.model.coefficients() if extra else None
    rows = []
    for i, lead in enumerate(base.leading):
        sds = [found.status[i], ""]
        if found.status[i] == "fitted":
            sds = [f"{estimate.sd[i]:.2g}", f"{100 * estimate.relative_sd[i]:.3g}"]
        row = [base.words(i), lead.unit, f"{found.nominal_theta[i]:.5g}"]
        row += [f"{estimate.theta[i]:.5g}", *sds]
        rows.append([*row, *([] if other is None else [f"{other[i]:.5g}"])])
    # What a parameter is made of may take several lines.
    return Table(heads, rows, left=(0, 1), most={0: 58})


def _fit(outcome: ValidatedIdentification) -> list[str]:
    found = outcome.free
    estimate = found.estimate
    noise = ", ".join(f"{n:.3g}" for n in estimate.noise)
    lines = [
        f"{found.options.method} on {estimate.counts.sum()} moving rows, worth "
        f"{estimate.independent.sum():.0f} independent ones; condition "
        f"{estimate.condition:.3g}",
        f"noise per joint [N m]: {noise}",
    ]
    if found.options.method == "irls":
        shares = ", ".join(f"{100 * s:.1f}" for s in estimate.outliers)
        lines.append(f"rows that hardly count [%]: {shares}")
    if found.essential is not None:
        gone = len(found.essential.dropped)
        lines.append(
            f"{gone} of {len(found.base)} parameters are not needed and were set to 0 "
            f"(F {found.essential.f_value:.3g}, limit {found.essential.f_limit:.3g})"
        )
    return lines


def _errors(outcome: ValidatedIdentification) -> Table:
    joints = range(1, outcome.robot.dof + 1)
    heads = ["error on held-out motion [%]", "model", *(f"J{j}" for j in joints), "all"]
    rows = [
        (
            words,
            name,
            *map(_short, errors.per_joint(kind)),
            _short(errors.overall(kind)),
        )
        for kind, words in _KINDS
        for name, errors in outcome.errors.items()
    ]
    rows += [
        ("acceleration", name, *map(_short, made.per_joint), _short(made.overall))
        for name, made in outcome.accelerations.items()
        if made is not None
    ]
    return Table(heads, rows, left=(0, 1))


def _short(value: float) -> str:
    return "–" if not np.isfinite(value) else f"{value:.3g}"


def _proof(outcome: ValidatedIdentification) -> list[str]:
    lines = []
    if outcome.consistent is not None:
        made = outcome.consistent
        free, own = (
            outcome.errors[n].overall("filtered") for n in ("identified", "consistent")
        )
        lines.append(
            f"consistent: every pseudo-inertia is positive (least eigenvalue "
            f"{made.least_eigenvalue.min():.2g} of its scale); error {own:.3g} % where "
            f"the free fit reaches {free:.3g} %"
        )
    for name, value in outcome.least_mass_matrix.items():
        lines.append(
            f"least eigenvalue of M(q), 10 000 random poses, {name}: {value:.3g} kg m^2"
        )
    return lines


def prediction(errors: ErrorTables) -> Table | str:
    """Return errors per joint, of the model and of the edited one.

    Args:
        errors: Errors against the measured torque [%].
    """
    columns = [
        (getattr(errors, kind)[name], f"{head}{word}")
        for kind, head in _PREDICTED
        for name, word in _WHICH.items()
        if name in errors.overall
    ]
    dof = max((len(values) for values, _ in columns if values), default=0)
    if not dof:
        return "The logs have no measured torque to compare with."
    heads = ["joint", *(head for _, head in columns)]
    rows = [
        (str(j + 1), *(_known(values and values[j]) for values, _ in columns))
        for j in range(dof)
    ]
    every = (errors.overall, errors.overall_filtered, errors.overall_moving)
    names = [name for name in _WHICH if name in errors.overall]
    rows.append(("all", *(_known(of.get(name)) for of in every for name in names)))
    return Table(heads, rows, f"Error in % of torque ({', '.join(errors.logs)})")


def _known(value: float | None) -> str:
    return bare_percent(value) if known(value) else "–"


def adoptions(listed: Sequence[AdoptionEntry]) -> Table:
    """Return the models that robots had, the first one first."""
    last = {(made.robot, made.serial): id for id, made, _ in listed}
    rows = [
        (
            f"{int(id)}{' *' if last[made.robot, made.serial] == id else ''}",
            since,
            " ".join(filter(None, (made.robot, made.serial))),
            made.model_id[:8] if made.model_id else "nominal",
            _fall(made.before, made.after),
            made.action,
            made.who,
            made.note,
        )
        for id, made, since in listed
    ]
    heads = ("no.", "since", "robot", "model", "held-out error", "what", "who", "note")
    return words_table(heads, rows)


def adoption_lines(number: str, judgment: Judgment) -> list[str]:
    """Return what was adopted, and what the gate saw, a line each."""
    return [
        f"adoption {int(number)}: {judgment.model.robot.name} now has the model of "
        f"diagnosis {judgment.diagnosis[:8]}; modelgap rollback takes it back",
        *seen_lines(judgment),
    ]


def seen_lines(judgment: Judgment) -> list[str]:
    """Return what the gate saw of a model, a line each."""
    lines = [f"against the gate: {doubt}" for doubt in judgment.doubts]
    if judgment.worth is None:
        return lines
    errors = _fall(judgment.worth.before, judgment.worth.after)
    lines.append(f"error on held-out motion: {errors}")
    for one in judgment.worth.effects:
        where = f" on {joints_listed(one.joints)}" if one.joints else ""
        shown = "is not shown by it"
        if one.part is not None:
            shown = f"is there {one.part:.2f} times"
        lines.append(f"{one.name}{where} {shown}")
    return lines


def _fall(before: float | None, after: float | None) -> str:
    if before is None or after is None:
        return "–"
    return f"{percent(before)} -> {percent(after)}"


def proposal_page(proposal: Proposal, made: Pairs = ()) -> str:
    """Return the page of a proposal: one HTML document that needs nothing else."""
    diagnosis, errors = proposal.judgment.diagnosis, _joint_errors(proposal)
    rows = _compared(proposal)
    rows += [
        (f"error of joint {joint} on held-out motion, filtered, %", before, after)
        for joint, before, after in errors
    ]
    heads = ("", proposal.now, f"proposed: diagnosis {diagnosis[:8]}")
    robot = proposal.verdict.robot
    page = Document(
        title=f"{robot}: another model is proposed",
        about=f"modelgap proposal for {robot}",
        headline="Another model is proposed",
        lead=sentences(proposal.verdict)[:1],
        sections=(
            Section("two", "Side by side", [words_table(heads, rows)]),
            Section("gate", "What the gate saw", [seen_lines(proposal.judgment)]),
            Section(
                "answer",
                "How to answer",
                [_TEXT["answer"], f"modelgap adopt {diagnosis}"],
            ),
        ),
        foot=made,
    )
    return render(page)


def proposal_markdown(proposal: Proposal) -> str:
    """Return the same as text, for the pages of Prefect."""
    rows = [("", proposal.now, "proposed"), *_compared(proposal)]
    rows += [(f"error of joint {j}, %", a, b) for j, a, b in _joint_errors(proposal)]
    lines = [f"| {' | '.join(row)} |" for row in rows]
    return "\n".join(
        [
            *sentences(proposal.verdict)[:1],
            "",
            lines[0],
            "| --- | --- | --- |",
            *lines[1:],
            "",
            *(f"- {line}" for line in seen_lines(proposal.judgment)),
        ]
    )


def _compared(proposal: Proposal) -> list[tuple[str, str, str]]:
    """What, now, proposed."""
    worth = proposal.judgment.worth
    rows = []
    if worth:
        errors = bare_percent(worth.before), bare_percent(worth.after)
        rows.append(("error on held-out moving samples, %", *errors))
    return rows + [
        (f"{finding.where}: {key}", "–", str(value))
        for finding in proposal.verdict.effects
        for key, value in finding.parameters.items()
    ]


def _joint_errors(proposal: Proposal) -> list[tuple[str, str, str]]:
    """Joint, and its error as filtered by the model now and by the one proposed."""
    table = proposal.verdict.error.filtered
    before, after = (table.get(k) or () for k in ("nominal", "augmented"))
    return [
        (str(joint), bare_percent(a), bare_percent(b))
        for joint, (a, b) in enumerate(zip(before, after, strict=False), 1)
    ]
