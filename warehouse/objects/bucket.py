"""The few things that a store asks of object storage, through obstore."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import datetime, timedelta
from typing import Any

from residual.errors import InputError
from warehouse.objects.access import settings
from warehouse.objects.address import Address

_RETRIES = {"max_retries": 4, "retry_timeout": timedelta(seconds=60)}
# So many keys go in one request to delete.
_AT_ONCE = 1000
_NO_BUCKET = "NoSuchBucket"


class BucketError(InputError):
    """The object storage did not do what it was asked to."""


@dataclass(frozen=True, slots=True)
class Listed:
    """One object of a listing.

    Attributes:
        key: Its key, without the prefix of the store.
        size: Its size [bytes].
        modified: When it was written, by the clock of the server.
    """

    key: str
    size: int
    modified: datetime


class Bucket:
    """A bucket below a prefix.

    Args:
        store: A store of obstore, which has the prefix.
        url: What people call it.
    """

    def __init__(self, store: Any, url: str) -> None:
        self._store = store
        self._url = url
        self._obstore = _library()

    def put_if_absent(self, key: str, data: bytes) -> bool:
        """Write an object if there is none; whether it is this one.

        Raises:
            BucketError: If it cannot be written.
        """
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
        """Write an object, or a new version of it.

        Raises:
            BucketError: If it cannot be written.
        """
        with self._told("write"):
            self._obstore.put(self._store, key, data)

    def get(self, key: str) -> bytes | None:
        """Return an object, None where there is none.

        Raises:
            BucketError: If it cannot be read.
        """
        with self._told("read"):
            try:
                return bytes(self._obstore.get(self._store, key).bytes())
            except FileNotFoundError as error:
                if _NO_BUCKET in str(error):
                    raise
                return None

    def get_range(self, key: str, start: int, end: int) -> bytes:
        """Return the bytes of an object from `start` to before `end`.

        Raises:
            BucketError: If it is not there, or cannot be read.
        """
        with self._told("read"):
            return bytes(
                self._obstore.get_range(self._store, key, start=start, end=end)
            )

    def objects(self, prefix: str) -> list[Listed]:
        """Return all objects whose keys begin with a folder's name, in their order.

        Args:
            prefix: Whole parts of a key, such as "_index/tail".

        Raises:
            BucketError: If they cannot be listed.
        """
        with self._told("list"):
            pages = self._obstore.list(self._store, prefix)
            found = [
                Listed(each["path"], each["size"], each["last_modified"])
                for page in pages
                for each in page
            ]
        return sorted(found, key=lambda each: each.key)

    def folders(self, prefix: str) -> list[str]:
        """Return the names that stand after a folder's name in keys, each once.

        Raises:
            BucketError: If they cannot be listed.
        """
        with self._told("list"):
            found = self._obstore.list_with_delimiter(self._store, prefix)
        return sorted(each.rpartition("/")[2] for each in found["common_prefixes"])

    def delete(self, keys: Sequence[str]) -> None:
        """Remove objects; one that is gone already is no error.

        Raises:
            BucketError: If they cannot be removed.
        """
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
    """Return a bucket of S3, or of what speaks like it; nothing is asked of it yet.

    Raises:
        InputError: If there are no credentials, or the extra is not installed.
    """
    make, prefix = _library().store.S3Store, address.prefix or None
    store = make(address.bucket, prefix=prefix, retry_config=_RETRIES, **settings())
    return Bucket(store, address.url)


def _library() -> Any:
    try:
        import obstore
    except ImportError as error:
        raise InputError(
            "Object storage needs the extra: pip install '.[scale]' in the checkout."
        ) from error
    return obstore


def _short(error: Exception) -> str:
    text = " ".join(str(error).split("Debug source")[0].split())
    return text if len(text) <= 200 else f"{text[:197]}..."
