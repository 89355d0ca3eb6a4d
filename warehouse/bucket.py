"""What a store asks of object storage, through obstore: where it is, and a few verbs.

Endpoint and credentials are from where every program looks for them, the variables of
the AWS tools: AWS_ENDPOINT_URL_S3 or AWS_ENDPOINT_URL, AWS_ACCESS_KEY_ID,
AWS_SECRET_ACCESS_KEY, AWS_SESSION_TOKEN, AWS_REGION or AWS_DEFAULT_REGION; without keys
in them the profile (AWS_PROFILE, ~/.aws) as botocore reads it.
"""

import ipaddress
import os
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from typing import Any
from urllib.parse import urlsplit

from residual.errors import InputError

_SCHEME = re.compile(r"([A-Za-z][A-Za-z0-9+.-]*):/")
_BUCKET = re.compile(r"[a-z0-9][a-z0-9.-]{1,61}[a-z0-9]")
# No sign that a URL, a key or a pattern of file names takes for something else.
_PART = re.compile(r"[A-Za-z0-9_=.-]{1,100}")

_SCALE = "Object storage needs the extra: pip install '.[scale]' in the checkout."
# A profile may renew its keys; they are asked for again after this time.
_FRESH = timedelta(minutes=10)
_RETRIES = {"max_retries": 4, "retry_timeout": timedelta(seconds=60)}
# So many keys go in one request to delete.
_AT_ONCE = 1000
_NO_BUCKET = "NoSuchBucket"


@dataclass(frozen=True, slots=True)
class Address:
    """A place in a bucket."""

    bucket: str
    prefix: str  # what the keys of the store begin with, without a slash at the end

    @property
    def url(self) -> str:
        """As --store takes it."""
        return f"s3://{self.bucket}/{self.prefix}".rstrip("/")


def is_address(word: str) -> bool:
    """Return whether a word is an address rather than a folder: "scheme:/..."."""
    return _SCHEME.match(word) is not None


def parse(word: str) -> Address:
    """Return the address in a word, such as s3://bucket/prefix."""
    found = _SCHEME.match(word)
    if found is None or found[1].lower() != "s3" or not word[3:].startswith("//"):
        raise InputError(
            f"--store {word}: expected a folder, or s3://BUCKET/PREFIX for object "
            f"storage. A folder of that name is ./{word}."
        )
    bucket, _, rest = word[5:].partition("/")
    prefix = rest.rstrip("/")
    parts = prefix.split("/") if prefix else []
    if not _BUCKET.fullmatch(bucket):
        raise InputError(
            f"--store {word}: '{bucket}' is no name of a bucket. Expected "
            "s3://BUCKET/PREFIX with 3 to 63 small letters, digits, dots and hyphens."
        )
    if any(p in (".", "..") or not _PART.fullmatch(p) for p in parts):
        raise InputError(
            f"--store {word}: the prefix may have letters, digits and . _ = - between "
            "its slashes."
        )
    return Address(bucket, prefix)


def settings() -> dict:
    """Return what `obstore.store.S3Store` takes beside bucket and prefix."""
    profile = None if os.environ.get("AWS_ACCESS_KEY_ID") else _Profile()
    endpoint = endpoint_url() or (profile and profile.endpoint)
    region = os.environ.get("AWS_REGION") or os.environ.get("AWS_DEFAULT_REGION")
    region = region or (profile and profile.region) or "us-east-1"
    asked: dict = {"region": region, **_endpoint(endpoint)}
    if profile:
        asked["credential_provider"] = profile.keys
    return asked


def endpoint_url() -> str | None:
    """Return the endpoint that the variables name, None for that of AWS."""
    names = ("AWS_ENDPOINT_URL_S3", "AWS_ENDPOINT_URL", "AWS_ENDPOINT")
    return next((os.environ[name] for name in names if os.environ.get(name)), None)


def _endpoint(url: str | None) -> dict:
    if not url:
        return {}
    parts = urlsplit(url)
    if parts.scheme not in ("http", "https") or not parts.hostname:
        raise InputError(
            f"AWS_ENDPOINT_URL is '{url}', expected https://HOST or http://127.0.0.1:PORT."
        )
    if parts.scheme == "https":
        return {"endpoint": url}
    said = os.environ.get("AWS_ALLOW_HTTP", "").lower() in ("1", "true")
    if not said and not _is_loopback(parts.hostname):
        raise InputError(
            f"The endpoint {url} is not encrypted and on another machine: runs and "
            "keys would cross the network in the open. Use https, or say that it may "
            "be so: AWS_ALLOW_HTTP=true."
        )
    return {"endpoint": url, "client_options": {"allow_http": True}}


def _is_loopback(host: str) -> bool:
    try:
        return host == "localhost" or ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


class _Profile:
    """Keys, region and endpoint of the user's profile."""

    def __init__(self) -> None:
        try:
            from botocore.exceptions import BotoCoreError
            from botocore.session import Session
        except ImportError as error:
            raise InputError(_SCALE) from error
        try:
            session = Session()
            self._found = session.get_credentials()
            self.region = session.get_config_variable("region")
            self.endpoint = session.get_scoped_config().get("endpoint_url")
        except BotoCoreError as error:
            raise InputError(f"The AWS profile is not usable: {error}") from error
        if self._found is None:
            raise InputError(
                "There are no keys for the object storage. Set AWS_ACCESS_KEY_ID and "
                "AWS_SECRET_ACCESS_KEY, or AWS_PROFILE."
            )

    def keys(self) -> dict:
        """Return the keys of the moment, as obstore asks for them."""
        now = self._found.get_frozen_credentials()
        return {
            "access_key_id": now.access_key,
            "secret_access_key": now.secret_key,
            "token": now.token,
            "expires_at": datetime.now(UTC) + _FRESH,
        }


class BucketError(InputError):
    """The object storage did not do what it was asked to."""


@dataclass(frozen=True, slots=True)
class Listed:
    """One object of a listing."""

    key: str  # its key, without the prefix of the store
    size: int  # its size [bytes]
    modified: datetime  # when it was written, by the clock of the server


class Bucket:
    """A bucket below a prefix; a verb that it does not do raises BucketError."""

    def __init__(self, store: Any, url: str) -> None:
        self._store = store
        self._url = url
        self._obstore = _library()

    def put_if_absent(self, key: str, data: bytes) -> bool:
        """Write an object if there is none; whether it is this one."""
        with self._told("write"):
            try:
                # In one request: of several parts the condition would stand at none.
                self._obstore.put(
                    self._store, key, data, mode="create", use_multipart=False
                )
            except self._obstore.exceptions.AlreadyExistsError:
                return False
        return True

    def put(self, key: str, data: bytes) -> None:
        """Write an object, or a new version of it."""
        with self._told("write"):
            self._obstore.put(self._store, key, data)

    def get(self, key: str) -> bytes | None:
        """Return an object, None where there is none."""
        with self._told("read"):
            try:
                return bytes(self._obstore.get(self._store, key).bytes())
            except FileNotFoundError as error:
                if _NO_BUCKET in str(error):
                    raise
                return None

    def get_range(self, key: str, start: int, end: int) -> bytes:
        """Return the bytes of an object from `start` to before `end`."""
        with self._told("read"):
            return bytes(
                self._obstore.get_range(self._store, key, start=start, end=end)
            )

    def objects(self, prefix: str) -> list[Listed]:
        """Return all objects below whole parts of a key, such as "_index/tail"."""
        with self._told("list"):
            pages = self._obstore.list(self._store, prefix)
            found = [
                Listed(each["path"], each["size"], each["last_modified"])
                for page in pages
                for each in page
            ]
        return sorted(found, key=lambda each: each.key)

    def names(self, prefix: str) -> list[str]:
        """Return the names that stand after a folder's name in keys, each once."""
        with self._told("list"):
            found = self._obstore.list_with_delimiter(self._store, prefix)
        files = (each["path"] for each in found["objects"])
        return sorted(p.rpartition("/")[2] for p in (*found["common_prefixes"], *files))

    def delete(self, keys: Sequence[str]) -> None:
        """Remove objects; one that is gone already is no error."""
        with self._told("delete"):
            for first in range(0, len(keys), _AT_ONCE):
                self._obstore.delete(self._store, list(keys[first : first + _AT_ONCE]))

    @contextmanager
    def _told(self, what: str) -> Iterator[None]:
        try:
            yield
        except FileNotFoundError as error:
            if _NO_BUCKET in str(error):
                raise BucketError(f"There is no bucket for {self._url}.") from error
            if what == "delete":  # a server that tells of what is gone
                return
            raise BucketError(
                f"{self._url}: an object that should be there is not ({_short(error)})."
            ) from error
        except (self._obstore.exceptions.BaseError, OSError) as error:
            raise BucketError(
                f"{self._url} does not let us {what}: {_short(error)}. Check the "
                "endpoint (AWS_ENDPOINT_URL), the bucket and the keys."
            ) from error


def open_bucket(address: Address) -> Bucket:
    """Return a bucket of S3, or of what speaks like it; nothing is asked of it yet."""
    make, prefix = _library().store.S3Store, address.prefix or None
    store = make(address.bucket, prefix=prefix, retry_config=_RETRIES, **settings())
    return Bucket(store, address.url)


def _library() -> Any:
    try:
        import obstore
    except ImportError as error:
        raise InputError(_SCALE) from error
    return obstore


def _short(error: Exception) -> str:
    text = " ".join(str(error).split("Debug source")[0].split())
    return text if len(text) <= 200 else f"{text[:197]}..."
