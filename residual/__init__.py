"""The core: from recordings to a verdict; `diagnosis/diagnose.py` is the method."""

from collections.abc import Callable
from functools import wraps
from typing import ParamSpec, TypeVar

P, T = ParamSpec("P"), TypeVar("T")


def one_blas_thread(function: Callable[P, T]) -> Callable[P, T]:
    """Run a function with a single BLAS thread.

    The products are small: two threads spend up to twenty times longer waiting for each
    other than one needs for the work.
    """

    @wraps(function)
    def call(*arguments: P.args, **options: P.kwargs) -> T:
        from threadpoolctl import threadpool_limits

        with threadpool_limits(limits=1, user_api="blas"):
            return function(*arguments, **options)

    return call
