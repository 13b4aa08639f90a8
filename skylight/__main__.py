"""The ``skylight`` command: all of it, or ``relight`` alone where only that is installed."""


def main() -> int:
    """Run one command and return its exit code."""
    from skylight.work._threads import prefer_one_thread

    prefer_one_thread()
    try:
        from skylight.cli import main
    except ModuleNotFoundError as error:
        if error.name not in ("skylight.cli", "tyro"):
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
