"""A server of S3 on loopback, in this process, for tests that need more than memory."""

import logging
from contextlib import contextmanager
from uuid import uuid4

VARIABLES = {
    "AWS_ACCESS_KEY_ID": "test",
    "AWS_SECRET_ACCESS_KEY": "test",
    "AWS_REGION": "us-east-1",
    "AWS_EC2_METADATA_DISABLED": "true",
}


@contextmanager
def served():
    # Late: it is a slow import, and few tests need it.
    from moto.server import ThreadedMotoServer

    logging.getLogger("werkzeug").setLevel(logging.ERROR)
    server = ThreadedMotoServer(ip_address="127.0.0.1", port=0, verbose=False)
    server.start()
    try:
        yield "http://127.0.0.1:{1}".format(*server.get_host_and_port())
    finally:
        server.stop()


def new_bucket(endpoint):
    from boto3 import client

    name = f"bucket-{uuid4().hex[:8]}"
    keys = {k.lower(): v for k, v in VARIABLES.items() if "KEY" in k}
    client(
        "s3",
        endpoint_url=endpoint,
        region_name=VARIABLES["AWS_REGION"],
        aws_access_key_id=keys["aws_access_key_id"],
        aws_secret_access_key=keys["aws_secret_access_key"],
    ).create_bucket(Bucket=name)
    return f"s3://{name}/cell"


def variables(endpoint, cache):
    return {**VARIABLES, "AWS_ENDPOINT_URL": endpoint, "MODELGAP_CACHE": str(cache)}
