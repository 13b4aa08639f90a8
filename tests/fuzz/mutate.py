"""Mutated files from a seed, without looking at coverage: the same ones on every machine."""

import random
import re
from collections.abc import Iterator

_NUMBERS = (0, 1, -1, 127, 255, 2**15, 2**16 - 1, 2**31 - 1, 2**31, 2**32 - 1, -(2**31))
_WORDS = (
    b"0", b"-1", b"1e999", b"NaN", b"null", b"[]", b"{}", b"[[[[", b"true", b'"', b"9" * 25,
    b"99999999999", b"\n", b"\0", b"..", b"/", b"%00",
)  # fmt: skip
_VALUES = (
    b"0", b"-1", b"1e999", b"-1e308", b"1e-320", b"0.5", b"NaN", b"Infinity", b"null", b"true",
    b"[]", b"{}", b"[[1, 2], 3]", b'{"a": 1}', b'""', b'"a"', b'"\\u0000"', b'"\\ud800"', b'"\\n"',
    b'"../../a"', b"9" * 25, b"9" * 400, b"[0, 0, 0]", b"[1e38, -1e38, 1]",
)  # fmt: skip
_VALUE = re.compile(
    rb"""(?<=[:,\[ ])("[^"\\]{0,99}"|-?\d[\d.eE+-]*|true|false|null|\[[^\[\]]{0,99}\])"""
)
_MOST_BYTES = 65_536


def mutated(seeds: list[bytes], count: int, seed: int) -> Iterator[bytes]:
    """All seeds, then ``count - len(seeds)`` of one to six changes each."""
    yield from seeds[:count]
    draw = random.Random(seed)
    for _ in range(count - len(seeds)):
        content = bytearray(draw.choice(seeds))
        for _ in range(draw.choice((1, 1, 1, 2, 3, 6))):
            draw.choice(_CHANGES)(content, draw, seeds)
        yield bytes(content[:_MOST_BYTES])


def changed(content: bytes, seeds: list[bytes], seed: int) -> bytes:
    """A single change, for a fuzzer that looks at coverage."""
    draw = random.Random(seed)
    whole = bytearray(content)
    draw.choice(_CHANGES)(whole, draw, seeds)
    return bytes(whole)


def _flip(content: bytearray, draw: random.Random, _seeds: list[bytes]) -> None:
    if content:
        content[draw.randrange(len(content))] ^= 1 << draw.randrange(8)


def _set(content: bytearray, draw: random.Random, _seeds: list[bytes]) -> None:
    if content:
        content[draw.randrange(len(content))] = draw.randrange(256)


def _cut(content: bytearray, draw: random.Random, _seeds: list[bytes]) -> None:
    del content[draw.randrange(len(content) + 1) :]


def _remove(content: bytearray, draw: random.Random, _seeds: list[bytes]) -> None:
    start = draw.randrange(len(content) + 1)
    del content[start : start + draw.randint(1, 16)]


def _repeat(content: bytearray, draw: random.Random, _seeds: list[bytes]) -> None:
    start = draw.randrange(len(content) + 1)
    part = bytes(content[start : start + draw.randint(1, 64)])
    content[start:start] = part * draw.choice((1, 2, 50))


def _number(content: bytearray, draw: random.Random, _seeds: list[bytes]) -> None:
    size = draw.choice((1, 2, 4, 8))
    order = draw.choice(("little", "big"))
    value = draw.choice(_NUMBERS) % 256**size
    start = draw.randrange(len(content) + 1)
    content[start : start + size] = value.to_bytes(size, order)


def _word(content: bytearray, draw: random.Random, _seeds: list[bytes]) -> None:
    start = draw.randrange(len(content) + 1)
    content[start : start + draw.choice((0, 1, 3))] = draw.choice(_WORDS)


def _value(content: bytearray, draw: random.Random, _seeds: list[bytes]) -> None:
    """Another value in what is like JSON, which stays so: its readers get further."""
    places = [found.span(1) for found in _VALUE.finditer(content)]
    if places:
        start, end = draw.choice(places)
        content[start:end] = draw.choice(_VALUES)


def _splice(content: bytearray, draw: random.Random, seeds: list[bytes]) -> None:
    other = draw.choice(seeds)
    start = draw.randrange(len(other) + 1)
    place = draw.randrange(len(content) + 1)
    content[place : place + draw.randint(0, 64)] = other[start : start + draw.randint(1, 64)]


_CHANGES = (
    _flip, _set, _cut, _remove, _repeat, _number, _number, _word, _word, _value, _value, _splice,
)  # fmt: skip
