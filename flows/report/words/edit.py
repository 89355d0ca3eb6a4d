"""The edit test in words."""

from flows.report.words.phrases import phrase, sentence_case
from residual.diagnosis.causes.edit.edits import Edit
from residual.diagnosis.result import Place, Verdict
from residual.quantity import known, percent


def edit_sentence(edit: Edit) -> str:
    """Return what is left of one effect that was taken out of the model again."""
    words = f"take it out again: error {percent(edit.error)} of torque"
    if known(edit.least_squares):
        words += f"; least squares {percent(edit.least_squares)}"
    if known(edit.reference):
        words += f"; true parameters {percent(edit.reference)}"
    return sentence_case(f"{words}.")


def baseline_sentences(verdict: Verdict) -> list[str]:
    """Return what is left on the baseline of each effect of a verdict, by name."""
    out = []
    for edit in verdict.edit or ():
        if not known(edit.error):
            continue
        named = sentence_case(phrase(Place(edit.name, edit.joints)))
        words = f"{named}, taken out again: error {percent(edit.error)} of torque"
        if known(edit.kept):
            words += f" on the baseline, {percent(edit.kept)} with it"
        if known(edit.least_squares):
            words += f"; least squares {percent(edit.least_squares)}"
        if known(edit.reference):
            words += f"; the baseline's own model {percent(edit.reference)}"
        out.append(f"{words}.")
    return out
