"""A benchmark of a single room by its name, by the command that other programs call."""

import sys

from run import main

if __name__ == "__main__":
    sys.exit(main(sys.argv.pop(1) if len(sys.argv) > 1 else ""))
