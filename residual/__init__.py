"""The core: from recordings to a verdict; `diagnosis/diagnose.py` is the method."""

from collections.abc import Callable
from functools import wraps
from typing import ParamSpec, TypeVar

P, T = ParamSpec("P"), TypeVar("T")


def one_blas_thread(function: Callable[P, T]) -> Callable[P, T]:
    """Let a function compute with one thread of BLAS, and others as before.

    The products are small: two threads on them wait for each other, up to twenty times
    longer than one works.
    """

    @wraps(function)
    def call(*arguments: P.args, **options: P.kwargs) -> T:
        from threadpoolctl import threadpool_limits

        with threadpool_limits(limits=1, user_api="blas"):
            return function(*arguments, **options)

    return call
