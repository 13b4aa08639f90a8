"""Limits of a server."""

import math
from dataclasses import dataclass

from skylight.errors import InputError

MEGABYTE = 1_000_000
MEGAPIXEL = 1_000_000


@dataclass(frozen=True, kw_only=True)
class Limits:
    """``upload_mb`` (10^6 bytes) and ``megapixels`` of one file; ``jobs`` waiting or running.

    ``upload_s`` is how long a request may take to come in.

    A picture takes up to about 32 bytes a pixel until its light is known: 1.6 GB for 50 megapixels.

    Photographs and maps are each kept until there are more than ``uploads`` of them or more than
    ``kept_mb``, jobs until there are more than ``results`` or ``kept_mb``; then the oldest that no
    job is using are forgotten.
    """

    upload_mb: float = 50.0
    upload_s: float = 600.0
    megapixels: float = 50.0
    jobs: int = 4
    uploads: int = 32
    results: int = 32
    kept_mb: float = 2000.0

    def __post_init__(self) -> None:
        for name in ("upload_mb", "upload_s", "megapixels", "kept_mb"):
            value = getattr(self, name)
            if not 0 < value < math.inf:
                raise InputError(f"{name} must be above 0 and finite, got {value}")
        for name in ("jobs", "uploads", "results"):
            if getattr(self, name) < 1:
                raise InputError(f"{name} must be 1 or more, got {getattr(self, name)}")

    @property
    def upload_bytes(self) -> int:
        return int(self.upload_mb * MEGABYTE)

    @property
    def pixels(self) -> int:
        return int(self.megapixels * MEGAPIXEL)

    @property
    def kept_bytes(self) -> int:
        return int(self.kept_mb * MEGABYTE)
