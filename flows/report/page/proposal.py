"""A proposal as a page and as text: the model that is, and the one that could be."""

from flows.report.made import Made
from flows.report.page.base import environment
from flows.report.terminal.adoptions import seen_lines
from flows.report.words.verdict import sentences
from flows.steps.loop.propose import Proposal
from residual.diagnosis.result import Finding
from residual.quantity import bare_percent


def render(proposal: Proposal, made: Made | None = None) -> str:
    """Return the page of a proposal: one HTML document that needs nothing else."""
    page = environment().get_template("proposal.html")
    return page.render(
        robot=proposal.verdict.robot,
        headline=sentences(proposal.verdict)[0],
        now=proposal.now,
        diagnosis=proposal.judged.diagnosis,
        rows=_rows(proposal),
        errors=_errors(proposal),
        seen=seen_lines(proposal.judged),
        made=made,
    )


def markdown(proposal: Proposal) -> str:
    """Return the same as text, for the pages of Prefect."""
    rows = [("", proposal.now, "proposed"), *_rows(proposal)]
    rows += [(f"error of joint {j}, %", a, b) for j, a, b in _errors(proposal)]
    lines = [f"| {' | '.join(row)} |" for row in rows]
    return "\n".join(
        [
            *sentences(proposal.verdict)[:1],
            "",
            lines[0],
            "| --- | --- | --- |",
            *lines[1:],
            "",
            *(f"- {line}" for line in seen_lines(proposal.judged)),
        ]
    )


def _rows(proposal: Proposal) -> list[tuple[str, str, str]]:
    """What, now, proposed."""
    worth = proposal.judged.worth
    rows = []
    if worth:
        errors = bare_percent(worth.before), bare_percent(worth.after)
        rows.append(("error on held-out moving samples, %", *errors))
    return rows + [
        (f"{finding.where}: {key}", "–", str(value))
        for finding in proposal.verdict.effects
        for key, value in _known(finding)
    ]


def _known(finding: Finding) -> list[tuple[str, object]]:
    return list(finding.parameters.items())


def _errors(proposal: Proposal) -> list[tuple[str, str, str]]:
    """Joint, and its error as filtered by the model now and by the one proposed."""
    table = proposal.verdict.error.filtered
    before, after = (table.get(k) or () for k in ("nominal", "augmented"))
    return [
        (str(joint), bare_percent(a), bare_percent(b))
        for joint, (a, b) in enumerate(zip(before, after, strict=False), 1)
    ]
