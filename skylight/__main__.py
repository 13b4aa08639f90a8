"""The ``skylight`` command: all of it, or ``relight`` alone where only that is installed."""

import os
import sys

_PIPE_CLOSED = 141  # what a shell says of programs that SIGPIPE ended


def main() -> int:
    """Run one command and return its exit code; quietly, where nobody reads on (``| head``)."""
    try:
        try:
            return _run()
        finally:
            if sys.stdout is not None:  # it may be closed from the start
                sys.stdout.flush()
    except BrokenPipeError:
        # Python writes what is left when it ends
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
        return _PIPE_CLOSED
    except OSError as error:  # what a command says goes to a full disk
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
        print(f"skylight: cannot write to standard output: {error.strerror}", file=sys.stderr)
        return 1


def _run() -> int:
    try:
        from skylight.work._threads import prefer_one_thread

        prefer_one_thread()
        from skylight.cli import main
    except ModuleNotFoundError as error:
        if error.name not in ("skylight.work", "skylight.cli", "tyro"):
            raise
        from skylight.relight._command import main

        return main()
    from skylight.work._memory import collect_no_more, collect_seldom

    collect_seldom()
    code = main()
    collect_no_more()
    return code


if __name__ == "__main__":
    raise SystemExit(main())
