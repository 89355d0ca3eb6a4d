"""Draw the figures of the tutorial and the method page into docs/img/.

    python -m scripts.docs_site.figures

Those of a diagnosis are the charts of its report page, photographed in Chromium.
"""

import shutil
import subprocess
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from flows.cli import main
from flows.report import Chart, Document, Section, charts
from flows.report.page import render_html
from flows.requests import Diagnose
from flows.steps.diagnose import diagnose, diagnose_stored_runs, read_logs
from flows.storage import read_outcome
from residual.verdict.result import Diagnosis
from warehouse.queries import open_store

ROOT = Path(__file__).parents[2]
IMAGES, LOGS = ROOT / "docs" / "img", ROOT / "examples" / "hidden"
CHROMIUM = shutil.which("chromium") or "google-chrome"
WIDTH = 800  # px
# One arm, joint 2 with more dry friction than its model, at four levels.
CAMPAIGN = """
robot = "irb140"
seed = 11
[campaign]
sealed = false
[trajectory]
duration = 10.0
[plant]
seed = 5
[[plant.effect]]
name = "coulomb"
joints = [2]
level = 9.0
[grid]
plant.effect.level = [2.0, 8.0, 16.0, 32.0]
"""
LEVELS = """
    SELECT CAST(points.value AS DOUBLE) AS level, stage, avg(errors.value) AS error
    FROM points JOIN lineage ON parent = points.run_id AND role = 'fit'
    JOIN errors ON source_id = child
    WHERE axis = 'plant.effect.level' AND metric = 'moving' AND joint = 2
      AND stage IN ('nominal', 'identified', 'augmented')
    GROUP BY ALL ORDER BY ALL
"""
RIVAL_LEVEL = 8.0
BARE = """<style>header, .modebar, h2 { display: none }
section { border: 0; padding: 0 } main, body { margin: 0; padding: 0 }</style>"""


def diagnose_example() -> Diagnosis:
    """Return the diagnosis of the tutorial."""
    fit = tuple(str(LOGS / f"fit_{n}.csv") for n in (1, 2, 3))
    held_out = (str(LOGS / "held_out.csv"),)
    request = Diagnose(logs=fit, robot="irb140", held_out=held_out)
    return diagnose(request, read_logs(request))


def diagnose_campaign(store: Path) -> tuple[Diagnosis, list[dict]]:
    """Run the campaign, diagnose each run, return one diagnosis and errors by level."""
    spec = store.with_suffix(".toml")
    spec.write_text(CAMPAIGN, encoding="utf-8")
    assert main(["campaign", str(spec), "--store", str(store)]) == 0
    with open_store(store) as opened:
        points = opened.sql("SELECT run_id, value FROM points").to_pylist()
    shown = None
    for point in points:
        request = Diagnose(logs=(point["run_id"],), robot="irb140", store=store)
        ids = diagnose_stored_runs(request)
        if float(point["value"]) == RIVAL_LEVEL:
            shown = read_outcome(store, ids[1])
    with open_store(store) as opened:
        levels = opened.sql(LEVELS).to_pylist()
    assert shown
    assert levels
    return shown, levels


def chart_rivals(diagnosis: Diagnosis) -> Chart:
    """Return the residual of the named friction, with viscous friction beside it."""
    cloud = next(c for c in diagnosis.clouds if c.name == "coulomb" and c.joint == 2)
    chart = charts.chart_findings(diagnosis)[0][0]
    slope = float(cloud.x @ cloud.residual / (cloud.x @ cloud.x))
    rows = np.argsort(cloud.x)[:: max(1, len(cloud.x) // 200)]
    line = charts.line_style("viscous friction, fitted alone", "#d55e00", 2.0)
    line |= {"mode": "lines", "x": cloud.x[rows].tolist()}
    line["y"] = (slope * cloud.x[rows]).tolist()
    data = [*chart.plot["data"], line]
    data = [d | {"showlegend": True} for d in data]
    layout = {**chart.plot["layout"], "showlegend": True}
    return replace(chart, plot={"data": data, "layout": layout}, height=380)


def chart_levels(rows: list[dict]) -> Chart:
    """Return the error of joint 2 against the hidden friction, by model."""
    data = []
    for stage in ("nominal", "identified", "augmented"):
        of = [row for row in rows if row["stage"] == stage]
        line = charts.line_style(charts.LABELS[stage], charts.COLORS[stage], 2.0)
        line |= {"x": [r["level"] for r in of], "y": [r["error"] for r in of]}
        data.append(line | {"mode": "lines+markers"})
    x = charts.build_axis("hidden dry friction on joint 2 (N m)")
    y = charts.build_axis("error (% of torque)", rangemode="tozero")
    layout = charts.build_layout("Joint 2, unseen motion, moving", x, y)
    return Chart("", "Error by level", plot={"data": data, "layout": layout}, height=340)


def photograph(chart: Chart, name: str) -> None:
    """Write a chart of a page as a picture."""
    page = render_html(Document(chart.alt, "", "", [Section("f", "", [chart])]))
    with TemporaryDirectory() as folder:
        file = Path(folder, "page.html")
        file.write_text(page.replace("</head>", f"{BARE}</head>"), encoding="utf-8")
        size = f"{WIDTH},{chart.height + 20}"
        command = [CHROMIUM, "--headless", "--no-sandbox", "--disable-gpu"]
        command += ["--hide-scrollbars", "--virtual-time-budget=20000"]
        command += [f"--window-size={size}", f"--screenshot={IMAGES / name}"]
        subprocess.run([*command, file.as_uri()], check=True, capture_output=True)


if __name__ == "__main__":
    result = diagnose_example()
    (_, motion), *_ = charts.chart_held_out_motions(result)[0]
    photograph(replace(charts.chart_errors(result), caption=""), "errors.png")
    photograph(replace(motion[0], caption=""), "residual.png")
    with TemporaryDirectory() as place:
        named, levels = diagnose_campaign(Path(place, "store"))
        photograph(replace(chart_rivals(named), caption=""), "rival.png")
        photograph(chart_levels(levels), "levels.png")
