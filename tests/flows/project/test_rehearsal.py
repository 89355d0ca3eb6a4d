"""A dry run knows what will fail; progress off a terminal is plain lines."""

from flows.cli import main
from flows.outputs import PAUSE, plain_lines

CAMPAIGN = """schema = 1
robot = "irb140"
[trajectory]
kind = "fourier"
duration = 4.0
[grid]
trajectory.periods = [1, 60]
"""


def test_a_dry_run_plans_the_motions_and_says_which_break_a_limit(tmp_path, capsys):
    (tmp_path / "c.toml").write_text(CAMPAIGN)
    words = ["campaign", str(tmp_path / "c.toml"), "--dry-run", "--store"]
    assert main([*words, str(tmp_path / "store")]) == 0
    out = capsys.readouterr().out
    assert "2 to run, 0 in" in out
    assert "; 1 will fail" in out
    (line,) = [line for line in out.splitlines() if "  fails  " in line]
    assert "60" in line
    assert not (tmp_path / "store").exists()


def test_progress_off_a_terminal_is_a_line_now_and_then():
    now, said = [0.0], []
    tell = plain_lines(said.append, lambda: now[0])
    tell("reading", 0.1)
    assert said == []
    now[0] = PAUSE
    tell("fitting", 0.25)
    tell("fitting", 0.26)
    assert said == [" 25% fitting"]
