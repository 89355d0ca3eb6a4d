"""The command line: `modelgap`.

Exit codes: 0 done, whatever the verdict; 1 the run failed; 2 bad usage or input; 130
interrupted.
"""

import errno
import os
import re
import sys
import traceback
from collections.abc import Sequence

from cyclopts import CycloptsError

from flows.cli.app import run
from flows.errors import RunError
from residual.errors import ModelgapError
from residual.names import LINE, plain, shortened

# Also a file that may not grow, by a quota or by ulimit -f.
_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
_NO_SPACE = "No space left"  # where a library gives no number
_NO_NAME = (errno.ENAMETOOLONG, errno.ELOOP)  # no file can be called so
_LOOP = "Symlink loop"  # what pathlib says, up to Python 3.12, without a number
_WORD = re.compile(rf"\S{{{2 * LINE},}}")
TRACEBACK = "MODELGAP_TRACEBACK"


def main(words: Sequence[str] | None = None) -> int:
    """Run one command.

    Args:
        words: Command line without the program's name; None for the process's own.

    Returns:
        The exit code.
    """
    try:
        # Inside, so that an interruption while loading is answered too.
        run(sys.argv[1:] if words is None else list(words))
        sys.stdout.flush()
    except KeyboardInterrupt:
        return _say("interrupted", 130)
    except BrokenPipeError:
        # The reader of our output has gone; what is left must not fail at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except Exception as error:
        return _explain(error)
    return 0


def _explain(error: Exception) -> int:
    if os.environ.get(TRACEBACK):
        traceback.print_exception(error)
    if isinstance(error, ModelgapError):
        return _say(str(error), 2)
    if isinstance(error, RunError):
        return _say(str(error), 1)
    if isinstance(error, CycloptsError):
        return _say(f"{' '.join(str(error).split())} See modelgap --help.", 2)
    if (isinstance(error, OSError) and error.errno in _NO_NAME) or _LOOP in str(error):
        named = getattr(error, "filename", None) or str(error).partition("'")[2]
        why = getattr(error, "strerror", None) or "a link to itself"
        return _say(
            f"'{shortened(str(named).strip(chr(39)))}' is the name of no file: {why}. "
            "Expected the path of a file or a folder.",
            2,
        )
    what = " ".join(f"{type(error).__name__}: {error}".split())
    if (isinstance(error, OSError) and error.errno in _FULL) or _NO_SPACE in what:
        return _say(
            "the disk is full; nothing was lost: what was not finished is not stored, "
            "all else is as it was.\nMake room and give the same command again.",
            1,
        )
    if isinstance(error, OSError) and error.errno == errno.EROFS:
        return _say(
            f"{error.filename or 'the disk'} is on a read-only disk; nothing was "
            "written and nothing was lost.",
            1,
        )
    return _say(f"unexpected failure: {what}\nSet {TRACEBACK}=1 to see where.", 1)


def _say(text: str, code: int) -> int:
    # What came out of a stranger's file must do nothing to the terminal.
    short = _WORD.sub(lambda word: shortened(word[0]), text)
    print(f"modelgap: {plain(short)}", file=sys.stderr)
    return code
