"""Which store is at an address, and whether its server keeps conditions.

`_store.json` is the first object of a store. It is written under the condition that it
is not there, twice: a server that takes both ignores the condition, and would let two
writers of one record believe that they were first. Such servers exist; nothing is
written to them.
"""

import json
import uuid

from residual.errors import InputError
from warehouse.objects.bucket import Bucket

IDENTITY = "_store.json"
_FORM = 1


def identity_of(bucket: Bucket) -> str | None:
    """Return the identity of the store in a bucket, None where there is no store.

    Raises:
        InputError: If there is one of another form, or the bucket does not answer.
    """
    text = bucket.get(IDENTITY)
    if text is None:
        return None
    try:
        told = json.loads(text)
        if told["schema"] == _FORM:
            return str(told["store"])
    except (ValueError, KeyError, TypeError):
        pass
    raise InputError(f"{IDENTITY} in the bucket is of no store of this version.")


def make_identity(bucket: Bucket, shown: str) -> str:
    """Make a store in a bucket, if there is none, and try the condition of its server.

    Raises:
        InputError: If the server ignores the condition of a put.
    """
    told = {"schema": _FORM, "store": uuid.uuid4().hex}
    bucket.put_if_absent(IDENTITY, json.dumps(told).encode())
    text = bucket.get(IDENTITY)
    # The same once more: where it is taken, no harm is done but to our trust.
    if text is None or bucket.put_if_absent(IDENTITY, text):
        raise InputError(
            f"The server of {shown} ignores the condition of a put (If-None-Match): of "
            "eight writers of one record all eight would believe to be the first. "
            f"Nothing but {IDENTITY} was written. Use one that keeps it: AWS S3, "
            "SeaweedFS, MinIO (docs/object_storage.md)."
        )
    identity = identity_of(bucket)
    if identity is None:
        raise InputError(f"{shown} has lost what was written to it a moment ago.")
    return identity
