"""Set before numpy is loaded, so that a bare `pytest` runs as `make test` does."""

import os

from hypothesis import settings

# Two test processes with two BLAS threads each fight over two cores.
for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

# The first example of a compiled function takes seconds; and no run is a lottery.
settings.register_profile("modelgap", deadline=None, derandomize=True)
settings.load_profile("modelgap")
