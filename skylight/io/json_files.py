"""JSON files: reading those with a "kind", atomic writing."""

import json
from collections.abc import Mapping
from pathlib import Path

from skylight.errors import InputError
from skylight.io.atomic import atomic_path
from skylight.io.bounded import json_content


def read_object(path: str | Path, kind: str) -> dict[str, object]:
    """The JSON object in a file whose "kind" says that it is the one wanted."""
    path = Path(path)
    try:
        content = json_content(path)
    except OSError as error:
        raise InputError(f"cannot read {path}: {error.strerror}; give a {kind} file") from error
    except ValueError as error:
        reason = " ".join(str(error).split())
        raise InputError(f"{path}: no JSON ({reason}); give a {kind} file") from error
    if not isinstance(content, dict) or content.get("kind") != kind:
        raise InputError(f'{path}: no {kind} file (its "kind" is not {kind!r}); give another')
    return content


def require_keys(path: str | Path, content: Mapping[str, object], names: list[str]) -> None:
    """Refuse a file that lacks one of these keys."""
    missing = [name for name in names if name not in content]
    if missing:
        raise InputError(f'{path}: "{missing[0]}" is missing; write the file anew')


def read_number(content: Mapping[str, object], name: str) -> float:
    """The number of that key; the message leaves the file's name to the caller."""
    value = content[name]
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise InputError(f'"{name}" must be a number, got {value!r}')
    return float(value)


def read_whole(content: Mapping[str, object], name: str) -> int:
    """The same for a whole number."""
    value = content[name]
    if isinstance(value, bool) or not isinstance(value, int):
        raise InputError(f'"{name}" must be a whole number, got {value!r}')
    return value


def write_json(path: str | Path, content: object) -> None:
    """Write strict JSON: a NaN or infinity is a ValueError, since other readers refuse it."""
    text = json.dumps(content, indent=2, ensure_ascii=False, allow_nan=False) + "\n"
    with atomic_path(path) as temporary:
        temporary.write_text(text, encoding="utf-8")
