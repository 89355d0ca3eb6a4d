"""What can go wrong in a run, apart from its input."""


class RunError(Exception):
    """A run did not come to its end, through no fault of its input; exit code 1."""
