"""Buckets that break at a given moment, and mirrors for buckets without an address."""

import itertools

from warehouse import mirror
from warehouse.bucket import Bucket
from warehouse.mirror import identity_of


class KilledError(BaseException):
    """What a kill is to a program: nothing after it is done."""


class Breaking(Bucket):
    """A bucket whose writer is killed at one of its changes."""

    def __init__(self, bucket, at):
        super().__init__(bucket._store, bucket._url)
        self._left = itertools.count(at, -1)

    def _change(self, change, *about):
        if next(self._left) <= 0:
            raise KilledError
        return change(*about)

    def put(self, key, data):
        return self._change(super().put, key, data)

    def put_if_absent(self, key, data):
        return self._change(super().put_if_absent, key, data)

    def delete(self, keys):
        return self._change(super().delete, keys)


class Careless(Bucket):
    """A server that ignores the condition of a put."""

    def put_if_absent(self, key, data):
        self.put(key, data)
        return True


def mirror_for(bucket, place):
    """Return the mirror of a bucket, as `mirror.mirror_of` does of an address."""
    card = {"url": bucket._url, "identity": identity_of(bucket)}
    mirror._open[place.name] = bucket
    mirror._renew(place, card)
    return place
