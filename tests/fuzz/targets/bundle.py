"""Folders of trained light models: the manifest, and each part with the checksums right.

A part is a description of tensors (:mod:`tests.fuzz.tensor_files`). The fingerprint ``right``
stands for that of the tensors. To make a network takes a hundred times as long as the rest, so
only contents that have one get one.
"""

import json

import torch
from torch import Tensor

from skylight.io._tensors import read_tensors, tensors_sha256
from skylight.models._bundle import (
    BANK,
    LATENT_PRIOR,
    NETWORK,
    SHIPPED,
    SUNSKY_PRIOR,
    load_bundle,
)
from skylight.models._manifest import MANIFEST, BundleManifest
from tests.fuzz.files import PLACE, joined, parted
from tests.fuzz.tensor_files import described, write_described

_FOLDER = PLACE / "bundle"
_PARTS = {NETWORK: "network", LATENT_PRIOR: "prior", BANK: "latents", SUNSKY_PRIOR: "sunsky"}
_RIGHT = b'"right"'
_FEW = 6  # latents: five are the sun's


def seeds() -> list[bytes]:
    manifest = BundleManifest(name="small", skies=9, data_sha256="0", fingerprint="right")
    shipped, _ = read_tensors(SHIPPED / NETWORK)
    parts = {
        MANIFEST: json.dumps(manifest.entries()).encode(),
        BANK: _bank(_FEW),
        LATENT_PRIOR: _mixture(_FEW),
        SUNSKY_PRIOR: _mixture(9),
    }
    wide = {BANK: _bank(64), LATENT_PRIOR: _mixture(64)}
    return [
        joined(parts),
        joined(parts | wide | {NETWORK: described(shipped, with_data=False)}),
        joined(parts | {NETWORK: described({"linear.weight": torch.ones(1, _FEW)})}),
    ]


def read(content: bytes) -> None:
    _FOLDER.mkdir(exist_ok=True)
    members, tensors = parted(content), {}
    for name, part in _PARTS.items():
        (_FOLDER / name).unlink(missing_ok=True)
        if name in members:
            found = write_described(_FOLDER / name, members[name])
            tensors |= {f"{part}.{key}": _kept(part, each) for key, each in found.items()}
    manifest = members.get(MANIFEST, b"")
    if NETWORK in members:
        right = tensors_sha256(tensors, {"coding": "log"})
        manifest = manifest.replace(_RIGHT, f'"{right}"'.encode())
    (_FOLDER / MANIFEST).write_bytes(manifest)
    light = load_bundle(_FOLDER).light()
    assert all(bool(each.isfinite().all()) for each in light.state_dict().values())
    with torch.no_grad():
        light(light.starts()[:1])


def _kept(part: str, tensor: Tensor) -> Tensor:
    """As it is saved: weights have half precision."""
    return tensor.half() if part == "network" else tensor


def _bank(latents: int) -> bytes:
    return described(
        {
            "latent_mean": torch.zeros(latents),
            "latent_scale": torch.eye(latents),
            "bank": torch.zeros(6, latents),
            "bank_zenith_rad": torch.ones(6),
        }
    )


def _mixture(size: int) -> bytes:
    return described(
        {
            "weights": torch.ones(1),
            "means": torch.zeros(1, size),
            "precision_factors": torch.eye(size)[None],
        }
    )
