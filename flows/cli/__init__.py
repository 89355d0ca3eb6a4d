"""The command line: `modelgap`.

Exit codes: 0 done, whatever the verdict; 1 the run failed; 2 bad usage or input; 130
interrupted.
"""

from flows.cli.app import main

__all__ = ["main"]
