"""The page of a blind study in the store, and its figures in the terminal."""

from dataclasses import replace
from pathlib import Path

from rich.console import Console
from rich.table import Table

from flows.blind.draw import Asked
from flows.blind.run import Study
from flows.outputs import say
from flows.report.made import made_of
from flows.report.page.study import headline, lines, render
from warehouse.commit import commit_record
from warehouse.ids import record_folder


def store_page(asked: Asked, study: Study, store: Path) -> Path:
    """Write the page of a study into the store."""
    about = {
        "robot": asked.robot,
        "seed": asked.seed,
        "n": asked.n,
        "id": study.id,
        "failed": list(study.failed),
    }
    words = f"--n {asked.n} --seed {asked.seed} --background {asked.background}"
    words += f" --duration {asked.duration:g}"
    made = made_of(store, study.id)
    made = replace(made, what="study", command=f"modelgap blind {words}")
    page = render(study.rows, study.summary, about, made).encode()
    kind = {"robot": asked.robot, "kind": "blind"}
    parents, files = {"study": [study.id]}, {"report.html": page}
    id = commit_record(store, "reports", kind, None, parents, files)
    return record_folder(store, "reports", id) / "report.html"


def tell_study(study: Study, console: Console) -> None:
    """Print the figures of a study and every case that is not plainly right."""
    console.print(f"{headline(study.summary)}\n", markup=False, highlight=False)
    table = Table(box=None, pad_edge=False, show_header=False)
    table.add_column()
    table.add_column(justify="right")
    table.add_column(style="dim")
    for row in lines(study.summary):
        table.add_row(*row)
    console.print(table)
    known = f"{study.known} of {len(study.rows)} cases were in the store already"
    if study.known:
        console.print(f"\n{known}", markup=False, highlight=False)
    for line in study.failed:
        say(console, f"failed: {line}")
