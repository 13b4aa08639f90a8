"""Keys of a configuration on the command line: ``key=value``, and what there is to say so."""

import ast
import inspect
import textwrap
from collections.abc import Iterator, Sequence
from dataclasses import fields
from itertools import pairwise
from pathlib import Path
from typing import Any

from skylight.errors import InputError
from skylight.training._config import (
    AutoencoderConfig,
    Config,
    DictionaryConfig,
    PlacesConfig,
    PriorConfig,
    allowed,
    keys_of,
    shipped_configs,
    typed,
)

_SWITCH = {"true": True, "yes": True, "on": True, "false": False, "no": False, "off": False}
_USAGE = """\
usage: python train.py CONFIG [KEY=VALUE ...]
       torchrun --nproc-per-node N train.py CONFIG [KEY=VALUE ...]

Trains what a configuration says. Given again, the command goes on with a run that was interrupted,
or that has ended and gets more epochs. --key value is the same as key=value.

CONFIG is a .yaml file, or the name of one that comes with skylight:"""


def read_overrides(kind: type[Config], texts: Sequence[str]) -> dict[str, Any]:
    """The values of ``key=value`` texts by key, each checked as in a file.

    Raises
    ------
    InputError
        Another text, a key that is not there or is given twice, a value of another type.
    """
    changes: dict[str, Any] = {}
    for text in texts:
        name, given, value = text.partition("=")
        if not given:
            raise InputError(f"{text!r} is no override of a key; write key=value, as epochs=9")
        key = keys_of(kind, text, [name])[name]
        if name in changes:
            raise InputError(f"{text}: `{name}` is given twice")
        changes[name] = typed(text, key, _meant(key.type, value))
    return changes


def _meant(kind: Any, text: str) -> Any:
    """What a text says where such a value is wanted; itself where it says none."""
    if kind is int or kind is float:
        try:
            return kind(text)
        except ValueError:
            return text
    if kind is bool:
        return _SWITCH.get(text.lower(), text)
    if kind == Path | None and text.lower() in ("", "none", "null"):
        return None
    if kind == tuple[str, ...]:
        return [each.strip() for each in text.strip("[]").split(",") if each.strip()]
    return text


def without_dashes(kind: type[Config], arguments: Sequence[str]) -> list[str]:
    """``--key value``, ``--key=value``, ``--flag`` and ``--no-flag`` as ``key=value``."""
    texts, left = [], list(arguments)
    while left:
        argument = left.pop(0)
        if not argument.startswith("--"):
            texts.append(argument)
            continue
        name, given, value = argument[2:].partition("=")
        name = name.replace("-", "_")
        on = keys_of(kind, argument, []).get(name.removeprefix("no_"))
        if on and on.name != name and on.type is bool and not given:
            texts.append(f"{on.name}=false")
            continue
        key = keys_of(kind, argument, [name])[name]
        if not given and key.type is bool and (not left or left[0].lower() not in _SWITCH):
            value = "true"
        elif not given and not left:
            raise InputError(f"{argument}: its value is missing; it must be {allowed(key)}")
        elif not given:
            value = left.pop(0)
            while key.type == tuple[str, ...] and left and not left[0].startswith("--"):
                value += f",{left.pop(0)}"
        texts.append(f"{name}={value}")
    return texts


def usage() -> str:
    """The page of ``train.py --help``."""
    lines = [_USAGE]
    for name, path in shipped_configs().items():
        comment = [line[1:].strip() for line in path.read_text(encoding="utf-8").splitlines()]
        about = " ".join(comment[: comment.index("")] if "" in comment else comment)
        lines += _wrapped(name, about.split(". ")[0] + ".")
    for kind in (AutoencoderConfig, PriorConfig, DictionaryConfig, PlacesConfig):
        lines += ["", *keys_page(kind())]
    return "\n".join(lines)


def keys_page(config: Config) -> Iterator[str]:
    """Each key of a configuration: its value there, the allowed ones and its meaning."""
    yield f"Keys of a configuration of kind {config.kind}:"
    meanings = _meanings(type(config))
    for key in fields(config):
        if key.name != "kind":
            value = getattr(config, key.name)
            shown = ",".join(value) if isinstance(value, tuple) else value
            if value is None or isinstance(value, bool):
                shown = str(value).lower()
            said = meanings.get(key.name, "")
            yield from _wrapped(f"{key.name}={shown}", f"{allowed(key)}. {said}".strip())


def _wrapped(left: str, right: str) -> list[str]:
    """``left`` with ``right`` beside it, or below it where it is long."""
    indent = " " * 26
    lines = textwrap.wrap(right, 100, initial_indent=indent, subsequent_indent=indent)
    if len(left) > 22:
        return [f"  {left}", *lines]
    return [f"  {left:<22}  {lines[0][26:]}", *lines[1:]]


def _meanings(kind: type[Config]) -> dict[str, str]:
    """The text below each field of a dataclass, from its source."""
    body = ast.parse(inspect.getsource(kind)).body[0]
    assert isinstance(body, ast.ClassDef)
    return {
        ast.unparse(one.target): " ".join(str(below.value.value).split())
        for one, below in pairwise(body.body)
        if isinstance(one, ast.AnnAssign)
        and isinstance(below, ast.Expr)
        and isinstance(below.value, ast.Constant)
    }
