"""The studio's server, which on SIGUSR1 writes what it holds into a file (Linux, glibc).

python -m tools.load.telling_server FILE.json
"""

import ctypes
import gc
import json
import signal
import sys
from pathlib import Path

from skylight.io._atomic import atomic_path
from skylight.studio._server import serve


class _Heap(ctypes.Structure):
    """glibc's struct mallinfo2."""

    _fields_ = [
        (name, ctypes.c_size_t)
        for name in (
            *("arena", "ordblks", "smblks", "hblks", "hblkhd", "usmblks", "fsmblks"),
            *("uordblks", "fordblks", "keepcost"),
        )
    ]


def main() -> None:
    path = Path(sys.argv[1])
    signal.signal(signal.SIGUSR1, lambda _number, _frame: _tell(path))
    serve(port=0, browser=False)


def _tell(path: Path) -> None:
    gc.collect()
    heap = ctypes.CDLL("libc.so.6")
    heap.mallinfo2.restype = _Heap
    info = heap.mallinfo2()
    told = {
        "heap_in_use_mb": info.uordblks / 1e6,
        "heap_free_mb": info.fordblks / 1e6,
        "python_blocks": sys.getallocatedblocks(),
        "python_objects": len(gc.get_objects()),
    }
    with atomic_path(path) as temporary:
        temporary.write_text(json.dumps(told))


if __name__ == "__main__":
    main()
