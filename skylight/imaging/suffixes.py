"""Endings of the files that photographs are read from, without what reads them."""

from skylight.imaging.raw import RAW_SUFFIXES
from skylight.io.hdr import SUFFIXES as HDR_SUFFIXES

PHOTO_SUFFIXES = frozenset({".jpg", ".jpeg", ".png", ".tif", ".tiff", *HDR_SUFFIXES, *RAW_SUFFIXES})
