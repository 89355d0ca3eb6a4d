"""How many files of ours one diagnosis enters: what a reader has to know of."""

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]
# With a report; 32 of them are an effect each. It was 160; 95 is aimed at. Three came
# with bodies that can exist and with known values, two with the body on a link.
MOST = 109
ENTERED = """
import sys, threading
from pathlib import Path
from flows.cli import main

OF_A_FUNCTION, root, entered = 1, sys.argv[1], set()
def see(frame, event, argument):
    if event == "call" and frame.f_code.co_flags & OF_A_FUNCTION:
        entered.add(frame.f_code.co_filename)
threading.setprofile(see)
sys.setprofile(see)
failed = main(sys.argv[2:])
sys.setprofile(None)
ours = (f"{root}/{room}/" for room in ("flows", "residual", "sim", "warehouse"))
code = [name for name in entered if name.endswith(".py")]
names = {name for room in ours for name in code if name.startswith(room)}
Path(sys.argv[-1]).with_suffix(".txt").write_text("\\n".join(sorted(names)))
sys.exit(failed)
"""


def test_a_diagnosis_with_a_report_enters_no_more_files_than_it_did(tmp_path):
    logs = [f"examples/hidden/{n}.csv@:10" for n in ("fit_1", "fit_2")]
    words = ["diagnose", *logs, "--holdout", "examples/hidden/held_out.csv"]
    words += ["--robot", "irb140", "--report", str(tmp_path / "report.html")]
    asked = [sys.executable, "-c", ENTERED, str(ROOT), *words]
    done = subprocess.run(asked, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    names = (tmp_path / "report.txt").read_text(encoding="utf-8").split()
    assert any(name.endswith("residual/method/diagnose.py") for name in names)
    assert len(names) <= MOST, names
