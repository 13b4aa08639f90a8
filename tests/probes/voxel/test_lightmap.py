"""Lightmaps: where slots lie in the picture, what texture coordinates find there, files."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from skylight.errors import InputError
from skylight.probes.voxel._lightmap import Lightmap, load_lightmap, texture_coordinates
from skylight.probes.voxel._model import exposed_faces, star_probe


def numbered(size: int = 4) -> Lightmap:
    """Red says the slot, green the row, blue the column."""
    slot = torch.arange(192.0).reshape(6, 32, 1, 1).expand(-1, -1, size, size)
    row = torch.arange(float(size))[:, None].expand(6, 32, size, size)
    return Lightmap(
        radiance=torch.stack([slot, row, row.transpose(2, 3)], -1),
        coverage=torch.ones(6, 32),
        confidence=torch.full((6, 32), 0.5),
    )


def test_texture_coordinates_find_their_slot_and_its_corners() -> None:
    size = 4
    image = numbered(size).image()
    height, width, _ = image.shape
    faces = exposed_faces(star_probe(5))
    uv = texture_coordinates(faces.orientation, faces.configuration, inset=0.5 / size)
    # at texel centres, so that the nearest texel is meant exactly
    column = (uv[..., 0] * width - 0.5).round().long()
    row = ((1 - uv[..., 1]) * height - 0.5).round().long()
    found = image[row, column]
    slot = (faces.orientation * 32 + faces.configuration).float()
    assert (found[..., 0] == slot[:, None]).all()
    last = size - 1
    # left-backward, right-backward, right-forward, left-forward
    assert found[0, :, 1:].tolist() == [[last, 0], [last, last], [0, last], [0, 0]]


def test_picture_has_two_rows_for_each_orientation() -> None:
    image = numbered(2).image()
    assert image.shape == (24, 32, 3)
    assert image[0, :, 0].tolist() == [i // 2 for i in range(32)]
    assert image[2, 0, 0] == 16  # the first with a ceiling
    assert image[4, 0, 0] == 32  # the next orientation


def test_files_keep_everything(tmp_path: Path) -> None:
    turn = torch.tensor([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]], dtype=torch.float64)
    faces = torch.arange(192).reshape(6, 32) - 1
    one = replace(numbered(), rotation=turn, faces=faces)
    one.save(tmp_path / "a.npz")
    again = load_lightmap(tmp_path / "a.npz")
    for name in ("radiance", "coverage", "confidence", "faces", "rotation"):
        torch.testing.assert_close(getattr(again, name), getattr(one, name))
    assert again.known.all()
    assert not Lightmap.blank().known.any()


def test_files_that_are_no_lightmaps_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.npz"
    numbered().save(path)
    whole = path.read_bytes()
    for damaged in (b"nothing", whole[: len(whole) // 2], whole[:200] + b"x" * 300 + whole[500:]):
        path.write_bytes(damaged)
        with pytest.raises(InputError, match="cannot be read"):
            load_lightmap(path)
    np.save(tmp_path / "b.npy", np.ones(3))
    with pytest.raises(InputError, match="cannot be read"):
        load_lightmap(tmp_path / "b.npy")
    some = dict.fromkeys(("radiance", "coverage", "confidence", "faces", "rotation"), 0)
    np.savez(path, version=np.array(99), **some)
    with pytest.raises(InputError, match="version 99"):
        load_lightmap(path)
    dark = numbered()
    dark.radiance[1, 1] = -1.0
    dark.save(path)
    with pytest.raises(InputError, match="no light"):
        load_lightmap(path)
    skewed = replace(numbered(), rotation=2 * torch.eye(3, dtype=torch.float64))
    skewed.save(path)
    with pytest.raises(InputError, match="rotation is none"):
        load_lightmap(path)
    one = numbered()
    one.radiance[0, 0, 0, 0, 0] = float("nan")
    one.save(path)
    with pytest.raises(InputError, match="not finite"):
        load_lightmap(path)
