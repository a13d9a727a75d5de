"""Ctrl-C while the command line imports the package, which takes a second: it ends without a traceback.

Importing this module begins that, so it comes before all other imports; `end` ends it.
"""

from __future__ import annotations

# The built-in part of `signal`, as the whole of it takes a while to import, too.
import _signal  # type: ignore[import-not-found]
import os
import sys

__all__ = ["end"]

_INTERRUPTED = 130


def end() -> None:
    """Give Ctrl-C back to Python: everything is imported."""
    if _signal.getsignal(_signal.SIGINT) is _leave:
        _signal.signal(_signal.SIGINT, _signal.default_int_handler)


def _leave(number: int, frame: object) -> None:
    # Nothing has been written that would have to be flushed, and an exception would end in a traceback.
    os._exit(_INTERRUPTED)


# Other programs that import the package keep their own handler, and so does a job in the background of a
# shell, which ignores Ctrl-C.
if (
    os.path.basename(sys.argv[0] if sys.argv else "").startswith("dappo-batch")
    and _signal.getsignal(_signal.SIGINT) is _signal.default_int_handler
):
    _signal.signal(_signal.SIGINT, _leave)
