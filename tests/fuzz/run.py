"""Fuzz every reader for some minutes: python -m tests.fuzz.run --minutes 10

One line per reader: examples, seconds, findings. A finding is minimised and written
to tests/fuzz/corpus/, which tests/fuzz/test_corpus.py replays; the exit code is 1 then.
"""

import argparse
import sys
import tempfile
from pathlib import Path
from time import monotonic

from hypothesis.configuration import set_hypothesis_home_dir

from tests.fuzz.campaign import CORPUS, fuzz
from tests.fuzz.logs import LOGS
from tests.fuzz.records import RECORDS
from tests.fuzz.store import STORES
from tests.fuzz.tables import TABLES

# A new format gets an entry in a file of its family.
READERS = {reader.name: reader for reader in (*LOGS, *TABLES, *RECORDS, *STORES)}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--minutes", type=float, default=1.0, help="per reader")
    parser.add_argument("--readers", nargs="+", choices=READERS, default=list(READERS))
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--corpus", type=Path, default=CORPUS)
    args = parser.parse_args()
    # What hypothesis reads from the code it keeps outside of the checkout, as in tests.
    set_hypothesis_home_dir(Path(tempfile.gettempdir()) / "modelgap-hypothesis")
    found = 0
    for name in args.readers:
        start = monotonic()
        examples, findings = fuzz(READERS[name], 60 * args.minutes, args.seed, args.corpus)
        spent = monotonic() - start
        print(
            f"{name:10} {examples:8} examples {spent:6.0f} s {len(findings):3} findings", flush=True
        )
        for line in findings:
            print(f"    {line}", flush=True)
        found += len(findings)
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
