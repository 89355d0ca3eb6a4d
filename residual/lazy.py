"""What is loaded: modules when first asked for, and one thread of linear algebra."""

from importlib import import_module

from threadpoolctl import threadpool_limits


class Lazy:
    """A module by its name, in place of the module: not every run needs it.

    Stands at the top of a file, where an import would. For what is slow to load
    (compiled loops, SQL, an object store) or of use to a few commands only.
    """

    def __init__(self, name: str) -> None:
        """Name the module."""
        self._name = name

    def __getattr__(self, attribute: str):
        return getattr(import_module(self._name), attribute)


# The one place that limits threads of the linear algebra.


# The products are small: two threads on them wait for each other, up to twenty times
# longer than one works. A decorator of what does the work; what a program that
# imports us has set holds again when it is done.
one_blas_thread = threadpool_limits.wrap(limits=1, user_api="blas")
