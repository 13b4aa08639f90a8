"""Every failure a user can cause or meet, as one small family.

The command line prints the message of a :class:`SkylightError` as one line and exits with its
``exit_code``; anything else is a bug and shows a traceback.
"""


class SkylightError(Exception):
    """Base class; ``str(error)`` says what is wrong and what to do about it."""

    exit_code = 1


class InputError(SkylightError):
    """What the user gave cannot be used: a file, an option, a picture without a face."""

    exit_code = 2


class AssetError(SkylightError):
    """A file that skylight itself needs (checkpoint, prior, head model) is missing or damaged."""


class OutputError(SkylightError):
    """A result could not be written."""


class DependencyError(SkylightError):
    """An optional package is needed for this command and is not installed."""
