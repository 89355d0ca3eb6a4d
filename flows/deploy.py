"""Put the deployments of prefect.yaml on a server: python -m flows.deploy.

Needs nothing but a server that was just started: waits until it answers, makes the
work pool, deploys. Doing it again changes nothing.
"""

import os
import subprocess
import sys
from pathlib import Path
from time import monotonic, sleep

from flows.server import answers
from flows.settings import API

ROOT = Path(__file__).resolve().parents[1]
POOL = "modelgap"
_PATIENCE = 90.0  # s; the first start of a server makes its database


def main() -> int:
    """Deploy, and return the exit code."""
    url = os.environ.get(API)
    if not url:
        return _say("Set PREFECT_API_URL to the server's address, as README shows.", 2)
    begun = monotonic()
    while not answers(url):
        if monotonic() - begun > _PATIENCE:
            return _say(f"No Prefect server answers at {url}. Start it first.", 1)
        sleep(1)
    # Its own python first: the shell may have none, or another one.
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
    place = os.pathsep.join(filter(None, [str(ROOT), os.environ.get("PYTHONPATH")]))
    plain = {**os.environ, "PATH": path, "PYTHONPATH": place}
    for words in (
        ("work-pool", "create", POOL, "--type", "process", "--overwrite"),
        ("--no-prompt", "deploy", "--all"),
    ):
        command = [sys.executable, "-m", "prefect", *words]
        done = subprocess.run(command, cwd=ROOT, env=plain, check=False)
        if done.returncode:
            return _say(f"prefect {' '.join(words)} failed.", 1)
    return 0


def _say(text: str, code: int) -> int:
    print(f"deploy: {text}", file=sys.stderr)
    return code


if __name__ == "__main__":
    sys.exit(main())
