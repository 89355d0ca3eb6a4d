"""The benchmark plsr, by the command that other programs call (run.py)."""

from run import main

if __name__ == "__main__":
    raise SystemExit(main("plsr"))
