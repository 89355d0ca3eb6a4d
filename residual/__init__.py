"""The core: from recordings to a verdict; `diagnosis/diagnose.py` is the method."""

from threadpoolctl import threadpool_limits

# The products are small: two threads on them wait for each other, up to twenty times
# longer than one works. A decorator of what does the work; what a program that
# imports us has set holds again when it is done.
one_blas_thread = threadpool_limits.wrap(limits=1, user_api="blas")
