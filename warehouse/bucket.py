"""Object storage through obstore: addresses, credentials and a few operations.

Endpoint and credentials come from the variables of the AWS tools:
AWS_ENDPOINT_URL_S3 or AWS_ENDPOINT_URL, AWS_ACCESS_KEY_ID, AWS_SECRET_ACCESS_KEY,
AWS_SESSION_TOKEN, AWS_REGION or AWS_DEFAULT_REGION; without keys there from the profile
that botocore finds (AWS_PROFILE, ~/.aws).
"""

import ipaddress
import os
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from datetime import timedelta
from textwrap import shorten
from typing import Any
from urllib.parse import urlsplit

from residual.errors import InputError

_SCHEME = re.compile(r"([A-Za-z][A-Za-z0-9+.-]*):/")
_BUCKET = re.compile(r"[a-z0-9][a-z0-9.-]{1,61}[a-z0-9]")
# No character with a special meaning in a URL, a key or a file pattern.
_PART = re.compile(r"[A-Za-z0-9_=.-]{1,100}")

_SCALE = "Object storage needs the extra: pip install '.[scale]' in the checkout."
_RETRIES, _PATIENCE = 4, timedelta(seconds=60)
_NO_BUCKET = "NoSuchBucket"


def is_bucket_address(text: str) -> bool:
    """Return whether a word is an address rather than a folder: "scheme:/..."."""
    return _SCHEME.match(text) is not None


def parse_bucket_address(address: str) -> tuple[str, str]:
    """Return the bucket and the prefix in an address such as s3://bucket/prefix."""
    scheme, _, path = address.partition("://")
    bucket, _, prefix = path.rstrip("/").partition("/")
    parts = prefix.split("/") if prefix else []
    plain = all(p not in (".", "..") and _PART.fullmatch(p) for p in parts)
    if scheme.lower() != "s3" or not _BUCKET.fullmatch(bucket) or not plain:
        raise InputError(
            f"--store {address}: expected a folder, or s3://BUCKET/PREFIX; a folder of "
            f"that name is ./{address}. BUCKET has 3 to 63 small letters, digits, dots "
            "and hyphens, PREFIX letters, digits and . _ = - between slashes."
        )
    return bucket, prefix


def read_bucket_settings() -> dict:
    """Return the options of `obstore.store.S3Store` other than bucket and prefix."""
    keys, profile = _profile() if not os.environ.get("AWS_ACCESS_KEY_ID") else ({}, {})
    names = map(os.environ.get, ("AWS_REGION", "AWS_DEFAULT_REGION"))
    region = next(filter(None, names), None) or profile.get("region") or "us-east-1"
    endpoint = _endpoint(read_endpoint_url() or profile.get("endpoint_url"))
    return {"region": region, **keys, **endpoint}


def read_endpoint_url() -> str | None:
    """Return the endpoint that the variables name, None for that of AWS."""
    names = ("AWS_ENDPOINT_URL_S3", "AWS_ENDPOINT_URL", "AWS_ENDPOINT")
    return next((os.environ[name] for name in names if os.environ.get(name)), None)


def _endpoint(url: str | None) -> dict:
    if not url:
        return {}
    parts = urlsplit(url)
    may = os.environ.get("AWS_ALLOW_HTTP", "").lower() in ("1", "true")
    plain = parts.scheme == "http" and (may or is_loopback_host(parts.hostname or ""))
    if not parts.hostname or not (plain or parts.scheme == "https"):
        raise InputError(
            f"AWS_ENDPOINT_URL is '{url}', expected https://HOST or "
            "http://127.0.0.1:PORT. Plain http sends runs and keys unencrypted to "
            "another machine; to allow it, set AWS_ALLOW_HTTP=true."
        )
    return {"endpoint": url} | ({"client_options": {"allow_http": True}} if plain else {})


def is_loopback_host(host: str) -> bool:
    """Return whether a host name is this machine."""
    try:
        return host == "localhost" or ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def _profile() -> tuple[dict, dict]:
    """Return the source of the keys, and the settings of the user's profile."""
    try:
        from botocore.exceptions import BotoCoreError
        from botocore.session import Session
        from obstore.auth.boto3 import Boto3CredentialProvider
    except ImportError as error:
        raise InputError(_SCALE) from error
    try:
        session = Session()
        provider = Boto3CredentialProvider(session)
        return {"credential_provider": provider}, session.get_scoped_config()
    except (BotoCoreError, ValueError) as error:
        raise InputError(
            f"There are no usable keys for the object storage ({error}). Set "
            "AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY, or AWS_PROFILE."
        ) from error


class Bucket:
    """A bucket below a prefix; a failed operation raises InputError."""

    def __init__(self, store: Any, url: str) -> None:
        self._store = store
        self.url = url
        import obstore

        self._obstore = obstore

    def put_if_absent(self, key: str, data: bytes) -> bool:
        """Write an object unless it exists; return whether it was written."""
        with self._explained("write"):
            try:
                # In one request: a multipart upload cannot carry the condition.
                self._obstore.put(self._store, key, data, mode="create", use_multipart=False)
            except self._obstore.exceptions.AlreadyExistsError:
                return False
        return True

    def put(self, key: str, data: bytes) -> None:
        """Write an object, or a new version of it."""
        with self._explained("write"):
            self._obstore.put(self._store, key, data)

    def get(self, key: str) -> bytes | None:
        """Return an object, None where there is none."""
        with self._explained("read"):
            try:
                return bytes(self._obstore.get(self._store, key).bytes())
            except FileNotFoundError as error:
                if _NO_BUCKET in str(error):
                    raise
                return None

    def keys(self, prefix: str) -> list[str]:
        """Return all keys below whole parts of a key, such as "commits/samples"."""
        with self._explained("list"):
            pages = self._obstore.list(self._store, prefix)
            return sorted(each["path"] for page in pages for each in page)

    def names(self, prefix: str) -> list[str]:
        """Return the names that stand after a folder's name in keys, each once."""
        with self._explained("list"):
            listing = self._obstore.list_with_delimiter(self._store, prefix)
        files = (each["path"] for each in listing["objects"])
        return sorted(p.rpartition("/")[2] for p in (*listing["common_prefixes"], *files))

    def delete(self, keys: Sequence[str]) -> None:
        """Remove objects; one that is gone already is no error."""
        with self._explained("delete"), suppress(FileNotFoundError):
            self._obstore.delete(self._store, list(keys))

    @contextmanager
    def _explained(self, action: str) -> Iterator[None]:
        try:
            yield
        except (self._obstore.exceptions.BaseError, OSError) as error:
            if _NO_BUCKET in str(error):
                raise InputError(f"There is no bucket for {self.url}.") from error
            short = shorten(str(error).split("Debug source")[0], 200)
            raise InputError(
                f"{self.url} refused to {action}: {short}. Check the endpoint "
                "(AWS_ENDPOINT_URL), the bucket and the keys."
            ) from error


def open_bucket(address: str) -> Bucket:
    """Return the bucket of an address; makes no request."""
    bucket, prefix = parse_bucket_address(address)
    try:
        from obstore.store import S3Store
    except ImportError as error:
        raise InputError(_SCALE) from error
    retries = {"max_retries": _RETRIES, "retry_timeout": _PATIENCE}
    store = S3Store(bucket, prefix=prefix or None, retry_config=retries, **read_bucket_settings())
    return Bucket(store, f"s3://{bucket}/{prefix}".rstrip("/"))
