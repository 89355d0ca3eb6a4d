"""Where a store on object storage is: what s3://BUCKET/PREFIX may say."""

import re
from dataclasses import dataclass

from residual.errors import InputError

_SCHEME = re.compile(r"([A-Za-z][A-Za-z0-9+.-]*):/")
_BUCKET = re.compile(r"[a-z0-9][a-z0-9.-]{1,61}[a-z0-9]")
# No sign that a URL, a key or a pattern of file names takes for something else.
_PART = re.compile(r"[A-Za-z0-9_=.-]{1,100}")


@dataclass(frozen=True, slots=True)
class Address:
    """A place in a bucket.

    Attributes:
        bucket: Name of the bucket.
        prefix: What the keys of the store begin with, without a slash at the end.
    """

    bucket: str
    prefix: str

    @property
    def url(self) -> str:
        """As --store takes it."""
        return f"s3://{self.bucket}/{self.prefix}".rstrip("/")


def is_address(word: str) -> bool:
    """Return whether a word is an address rather than a folder: "scheme:/..."."""
    return _SCHEME.match(word) is not None


def parse(word: str) -> Address:
    """Return the address in a word.

    Args:
        word: As s3://bucket/prefix.

    Raises:
        InputError: If it is another scheme, or no bucket and prefix.
    """
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
