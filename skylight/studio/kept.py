"""Uploads and results kept in folders, within a size limit."""

import secrets
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, Generic, TypeVar

from starlette.responses import FileResponse
from starlette.types import Receive, Scope, Send

from skylight.studio.refusals import Refused

_TOKEN_BYTES = 16


@dataclass(kw_only=True)
class Item:
    """Something with an id that nobody can guess, and a folder that is its own."""

    id: str = field(default_factory=lambda: secrets.token_urlsafe(_TOKEN_BYTES))
    folder: Path
    readers: int = 0

    @property
    def bytes(self) -> int:
        """What its files take on the disk."""
        total = 0
        for file in self.folder.rglob("*"):
            with suppress(OSError):  # a job may just be writing there
                total += file.stat().st_size
        return total


AnyItem = TypeVar("AnyItem", bound=Item)


class Kept(Generic[AnyItem]):
    """Items by id, the oldest first."""

    def __init__(self, folder: Path, what: str, *, most: int, most_bytes: int) -> None:
        folder.mkdir()
        self._folder, self._what = folder, what
        self._most, self._most_bytes = most, most_bytes
        self._items: dict[str, AnyItem] = {}

    def __iter__(self) -> Iterator[AnyItem]:
        return iter(list(self._items.values()))

    def new_folder(self) -> Path:
        """A new empty folder for one item."""
        path = self._folder / secrets.token_hex(_TOKEN_BYTES)
        path.mkdir()
        return path

    def add(self, item: AnyItem) -> None:
        self._items[item.id] = item

    def get(self, token: str) -> AnyItem:
        """The item of that id, or 404."""
        if token not in self._items:
            raise Refused(404, f"there is no such {self._what} (any more); begin again")
        return self._items[token]

    def forget(self, item: AnyItem) -> None:
        """With its files; these as soon as nobody is :meth:`reading` them."""
        self._items.pop(item.id, None)
        if item.readers == 0:
            self.remove(item.folder)

    @contextmanager
    def reading(self, item: AnyItem) -> Iterator[None]:
        """Meanwhile its files stay, also where it is forgotten."""
        item.readers += 1
        try:
            yield
        finally:
            item.readers -= 1
            if item.readers == 0 and item.id not in self._items:
                self.remove(item.folder)

    def remove(self, folder: Path) -> None:
        """A folder that :meth:`new_folder` made."""
        shutil.rmtree(folder, ignore_errors=True)

    def make_room(self, is_used: Callable[[AnyItem], bool]) -> None:
        """Forget the oldest items that are not in use until the rest is few and small enough."""
        sizes = {item.id: item.bytes for item in self}
        count, total = len(sizes), sum(sizes.values())
        for item in self:
            if count <= self._most and total <= self._most_bytes:
                return
            if not is_used(item):
                self.forget(item)
                count, total = count - 1, total - sizes[item.id]


class KeptFile(FileResponse):
    """A file of an item as an answer: it goes out whole, also where the item is forgotten."""

    def __init__(self, kept: Kept[AnyItem], item: AnyItem, path: Path, **options: Any) -> None:
        super().__init__(path, **options)
        self._reading = partial(kept.reading, item)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        with self._reading():
            await super().__call__(scope, receive, send)
