from pathlib import Path

import pytest
import torch
from safetensors.torch import save_file

from skylight.io._tensors import read_tensors, write_tensors

TENSORS = {
    "a": torch.arange(6.0).reshape(2, 3).T,
    "b": torch.tensor([True, False]),
    "c": torch.tensor(1.5, dtype=torch.bfloat16),
    "none": torch.zeros(0, 3, dtype=torch.float64),
}


def test_there_and_back(tmp_path: Path) -> None:
    path = tmp_path / "a.safetensors"
    write_tensors(path, TENSORS, {"kind": "test", "name": "märchen"})
    tensors, metadata = read_tensors(path)
    assert metadata == {"kind": "test", "name": "märchen"}
    assert tensors.keys() == TENSORS.keys()
    for name, tensor in TENSORS.items():
        assert torch.equal(tensors[name], tensor)
        assert tensors[name].dtype == tensor.dtype


def test_equal_content_makes_equal_files(tmp_path: Path) -> None:
    paths = [tmp_path / f"{n}.safetensors" for n in range(6)]
    for path in paths:
        write_tensors(path, TENSORS, {"x": "1", "y": "2", "z": "3"})
    assert len({path.read_bytes() for path in paths}) == 1


def test_every_flipped_bit_is_found(tmp_path: Path) -> None:
    path = tmp_path / "a.safetensors"
    write_tensors(path, TENSORS, {"kind": "test"})
    whole = path.read_bytes()
    for place in range(len(whole)):
        content = bytearray(whole)
        content[place] ^= 1 << (place % 8)
        path.write_bytes(content)
        try:
            tensors, metadata = read_tensors(path)
        except (OSError, ValueError):
            continue
        # white space of the header and the like
        assert metadata == {"kind": "test"}
        assert all(torch.equal(tensors[name], t) for name, t in TENSORS.items())


def test_every_cut_is_found(tmp_path: Path) -> None:
    path = tmp_path / "a.safetensors"
    write_tensors(path, TENSORS)
    whole = path.read_bytes()
    for length in range(0, len(whole), max(1, len(whole) // 16)):
        path.write_bytes(whole[:length])
        with pytest.raises(ValueError, match=r"."):
            read_tensors(path)


def test_a_file_without_a_hash_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.safetensors"
    save_file({"a": torch.ones(2)}, path)
    with pytest.raises(ValueError, match="no SHA-256"):
        read_tensors(path)


@pytest.mark.parametrize(
    ("header", "message"),
    [
        ('[["sha256", "x"], [1, 2], ["a", 3]]', "header is damaged"),
        ("5", "header is damaged"),
        ('{"a": 5}', "header is damaged"),
        ("[" * 10_000, "deeply"),
        (r'{"a": "\ud800"}', "no character"),
    ],
)
def test_a_header_that_is_no_object_of_texts_is_refused(
    tmp_path: Path, header: str, message: str
) -> None:
    path = tmp_path / "a.safetensors"
    save_file({"a": torch.ones(2)}, path, metadata={"skylight": header})
    with pytest.raises(ValueError, match=message):
        read_tensors(path)
