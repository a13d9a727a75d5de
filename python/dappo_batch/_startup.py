"""Exits without a traceback on Ctrl-C while the command line imports the package, which takes a second.

Importing this module installs the handler, so it is imported first; `end` removes it.
"""

from __future__ import annotations

# The built-in part of `signal`, because importing all of it takes a while.
import _signal  # type: ignore[import-not-found]
import os
import sys

__all__ = ["end"]

_INTERRUPTED = 130


def end() -> None:
    """Restore Python's handler of Ctrl-C after all imports."""
    if _signal.getsignal(_signal.SIGINT) is _leave:
        _signal.signal(_signal.SIGINT, _signal.default_int_handler)


def _leave(number: int, frame: object) -> None:
    # There is no output to flush, and an exception would print a traceback.
    os._exit(_INTERRUPTED)


# Other programs that import the package keep their own handler, and so do background jobs of a shell, which
# ignore Ctrl-C.
if (
    os.path.basename(sys.argv[0] if sys.argv else "").startswith("dappo-batch")
    and _signal.getsignal(_signal.SIGINT) is _signal.default_int_handler
):
    _signal.signal(_signal.SIGINT, _leave)
