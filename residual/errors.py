"""What can go wrong with input, said in words that help."""


class ModelgapError(Exception):
    """Root of the errors that a user can mend; the command line exits with 2."""


class InputError(ModelgapError):
    """A file, value or option is not usable: expected this, got that, do so."""


class RobotError(InputError):
    """The robot description is not usable."""


class RecordingError(InputError):
    """The samples of a log are not usable."""


class UnknownNameError(InputError):
    """A name is not known; the message gives the nearest one that is."""
