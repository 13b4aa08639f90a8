"""What native libraries print, kept out of a command's output."""

import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stdout

_native_output = threading.Lock()


@contextmanager
def muted() -> Iterator[None]:
    """Drop what the libraries print: the exception says it in one line.

    OpenEXR reports a damaged file through Python's ``print``, where it would spoil a command's
    result, and on the process's standard error; OpenCV on the latter. Both belong to the whole
    process, hence the lock.
    """
    with _native_output, open(os.devnull, "w") as nowhere, redirect_stdout(nowhere):
        kept = os.dup(2)
        try:
            os.dup2(nowhere.fileno(), 2)
            yield
        finally:
            os.dup2(kept, 2)
            os.close(kept)
