"""Signatures of progress callbacks, and the forms in which commands show progress."""

from collections.abc import Callable
from typing import Literal

Progress = Callable[[float], None]  # the share that is done, 0 to 1
StageProgress = Callable[[str, float], None]  # a stage's name, and the share of it that is done
CountProgress = Callable[[int, int], None]  # items done, items in all
Tell = Callable[[str], None]  # a line for people
ProgressForm = Literal["bar", "json"]  # for people; for programs that start a command
