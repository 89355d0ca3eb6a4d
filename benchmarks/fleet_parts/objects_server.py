"""A server of S3 on loopback, in a process of its own, and stores in it."""

import os
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from urllib.request import urlopen

from boto3 import client

_PATIENCE = 60.0  # s until it must answer
_KEYS = {
    "AWS_ACCESS_KEY_ID": "benchmark",
    "AWS_SECRET_ACCESS_KEY": "benchmark",
    "AWS_REGION": "us-east-1",
}


@contextmanager
def serve(folder: Path) -> Iterator[Callable[[], str]]:
    """Serve S3; gives a function that returns the address of a new store.

    Args:
        folder: Where this process, and those that it starts, keep copies.
    """
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    words = [sys.executable, "-m", "moto.server", "-H", "127.0.0.1", "-p", str(port)]
    process = subprocess.Popen(
        words, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    endpoint = f"http://127.0.0.1:{port}"
    os.environ.update(_KEYS, AWS_ENDPOINT_URL=endpoint, MODELGAP_CACHE=str(folder))
    try:
        _wait(endpoint)
        made = iter(range(1000))

        def new_store() -> str:
            name = f"benchmark-{next(made)}"
            s3 = client("s3", endpoint_url=endpoint, region_name="us-east-1")
            s3.create_bucket(Bucket=name)
            return f"s3://{name}/store"

        yield new_store
    finally:
        process.kill()
        process.wait()


def _wait(endpoint: str) -> None:
    end = time.monotonic() + _PATIENCE
    while time.monotonic() < end:
        with suppress(OSError), urlopen(f"{endpoint}/moto-api/data.json", timeout=5):
            return
        time.sleep(0.2)
    raise TimeoutError(f"{endpoint} does not answer.")
