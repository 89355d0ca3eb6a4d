"""A benchmark by its name, by the command that other programs call (run.py)."""

import sys

from run import main

if __name__ == "__main__":
    raise SystemExit(main(sys.argv.pop(1) if len(sys.argv) > 1 else ""))
