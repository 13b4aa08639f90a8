"""Commands whose output nobody reads on end quietly, as after ``| head``."""

import os
import subprocess
import sys

import pytest


@pytest.mark.parametrize("arguments", [["--help"], ["estimate", "--help"], ["--version"]])
def test_a_closed_pipe(arguments: list[str]) -> None:
    reading, writing = os.pipe()
    os.close(reading)
    try:
        done = subprocess.run(
            [sys.executable, "-m", "skylight", *arguments],
            stdout=writing,
            stderr=subprocess.PIPE,
            text=True,
            check=False,
        )
    finally:
        os.close(writing)
    assert (done.returncode, done.stderr) == (141, "")


def test_no_output_at_all() -> None:
    program = "import sys; sys.stdout = None; from skylight.__main__ import main; sys.argv[1:] = "
    done = subprocess.run(
        [sys.executable, "-c", program + "['--version']; sys.exit(main())"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode, done.stderr) == (0, "")
