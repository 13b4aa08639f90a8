"""``python -m skylight``: the command line."""

from skylight.cli import main

if __name__ == "__main__":
    raise SystemExit(main())
