"""Skies of a run: converted, varied, prepared, and drawn in batches."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from skylight.errors import InputError
from skylight.skies._index import folder_hash, load_skies, normalise, read_index
from skylight.sphere._envmap import LUMINANCE
from skylight.sphere._frame import DirectionGrid
from skylight.training import _skies as module
from skylight.training._checkpoint import initial_network
from skylight.training._config import AutoencoderConfig
from skylight.training._skies import (
    BLOCK,
    CodedSkies,
    Corruption,
    augment,
    coded_skies,
    draw_batch,
    draw_corruption,
    load_data,
    open_cache,
    open_prepared,
    prepare,
)
from tests.own_network import TinyNetwork


@pytest.fixture
def folder(sky_folder: Path, tmp_path: Path) -> Path:
    """The same skies, without a cache."""
    for path in sky_folder.iterdir():
        if path.is_file():
            (tmp_path / path.name).symlink_to(path)
    return tmp_path


def silent(_: str) -> None:
    pass


def test_skies_are_split_by_day_and_mapped_from_disk(folder: Path) -> None:
    messages: list[str] = []
    data = load_data(folder, messages.append)
    records = read_index(folder)
    for name in ("train", "validation"):
        skies = getattr(data, name)
        expected = load_skies(folder, [r for r in records if r.split == name])
        assert isinstance(skies, np.memmap)
        assert np.array_equal(skies, expected.numpy())
    assert data.hash == folder_hash(folder, records)
    assert [m.split(": ")[1].split()[0] for m in messages] == ["reading", "reading"]
    assert not list((folder / ".cache").glob(".partial-*"))


def test_the_cache_is_made_once(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    first = load_data(folder, silent)
    monkeypatch.setattr(module, "load_skies", None)
    messages: list[str] = []
    again = load_data(folder, messages.append)
    assert messages == []
    assert np.array_equal(again.train, first.train)
    assert np.array_equal(open_cache(folder, first.hash).validation, first.validation)


@pytest.mark.parametrize("damage", ["truncated", "flipped", "empty", "no checksum"])
def test_a_damaged_cache_is_said_and_made_anew(folder: Path, damage: str) -> None:
    expected = np.array(load_data(folder, silent).train)
    (path,) = (folder / ".cache").glob("*-train.npy")
    content = bytearray(path.read_bytes())
    content[-100] ^= 1
    if damage == "no checksum":
        path.with_suffix(".sha256").unlink()
    else:
        path.write_bytes({"truncated": content[:-50], "flipped": content, "empty": b""}[damage])
    messages: list[str] = []
    assert np.array_equal(load_data(folder, messages.append).train, expected)
    assert len(messages) == 1
    assert messages[0].startswith(f"{path}: damaged")
    assert load_data(folder, messages.append)
    assert len(messages) == 1


def test_other_maps_get_another_cache(folder: Path) -> None:
    first = load_data(folder, silent)
    record = next(r for r in read_index(folder) if r.split == "train")
    other = next(r for r in read_index(folder) if r.split == "validation")
    path = folder / record.file
    path.unlink()
    path.symlink_to((folder / other.file).resolve())
    second = load_data(folder, silent)
    assert second.hash != first.hash
    assert not np.array_equal(second.train, first.train)


class Threads(ThreadPoolExecutor):
    """In the place of processes, which take seconds to start."""

    def __init__(self, workers: int, **_: object) -> None:
        super().__init__(workers)


@pytest.mark.parametrize("pool", [Threads, pytest.param(None, marks=pytest.mark.slow)])
def test_several_processes_keep_the_order(
    folder: Path, monkeypatch: pytest.MonkeyPatch, pool: type[Threads] | None
) -> None:
    if pool is not None:
        monkeypatch.setattr(module, "ProcessPoolExecutor", pool)
    alone = np.array(load_data(folder, silent).train)
    for path in (folder / ".cache").iterdir():
        path.unlink()
    monkeypatch.setattr(module, "CHUNK", 5)
    monkeypatch.setattr(module, "cores", lambda: 2)
    assert np.array_equal(load_data(folder, silent).train, alone)


def test_progress_is_told(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "CHUNK", 1)
    told: list[tuple[str, float]] = []
    skies = len(load_data(folder, silent, lambda *each: told.append(each)).train)
    assert skies > 10
    name, share = told[skies - 1]
    assert name.startswith(f"reading sky {skies} of {skies}")
    assert share == 1


def test_a_split_without_days(sky_folder: Path, tmp_path: Path) -> None:
    rows = (sky_folder / "index.csv").read_text().splitlines()
    train_rows = [
        row
        for row, record in zip(rows[1:], read_index(sky_folder), strict=True)
        if record.split == "train"
    ]
    (tmp_path / "index.csv").write_text("\n".join([rows[0], train_rows[0]]) + "\n")
    with pytest.raises(InputError, match="too few days"):
        load_data(tmp_path)


def test_mirroring_keeps_the_sun_in_its_column() -> None:
    skies = torch.rand(8, 32, 128, 3, generator=torch.Generator().manual_seed(0))
    plain, mirrored = (
        augment(skies, torch.Generator().manual_seed(1), AutoencoderConfig(mirror=mirror))
        for mirror in (False, True)
    )
    torch.testing.assert_close(mirrored[:, :, 64], plain[:, :, 64], rtol=0, atol=0)
    # column 64 + k of a mirrored sky is column 64 - k of the sky
    reflected = plain[:, :, (64 - (torch.arange(128) - 64)) % 128]
    flipped = [
        torch.equal(m, r) and not torch.equal(m, p)
        for m, r, p in zip(mirrored, reflected, plain, strict=True)
    ]
    kept = [torch.equal(m, p) for m, p in zip(mirrored, plain, strict=True)]
    assert all(a != b for a, b in zip(flipped, kept, strict=True))
    assert 0 < sum(flipped) < 8


def mean_luminance(skies: torch.Tensor) -> torch.Tensor:
    weight = DirectionGrid.sky(32).solid_angles.float() / (2 * torch.pi)
    return torch.einsum("n,bnc,c->b", weight, skies.flatten(1, 2), torch.tensor(LUMINANCE))


def test_every_sky_keeps_a_mean_of_one() -> None:
    skies = 3 * torch.rand(6, 32, 128, 3, generator=torch.Generator().manual_seed(0))
    config = AutoencoderConfig(surroundings=1.0, tint=0.2)
    varied = augment(skies, torch.Generator().manual_seed(1), config)
    torch.testing.assert_close(mean_luminance(varied), torch.ones(6), rtol=1e-4, atol=0)
    assert (varied >= 0).all()


def test_tint_changes_colours_alone() -> None:
    skies = torch.rand(4, 32, 128, 3, generator=torch.Generator().manual_seed(0)) + 0.1
    config = AutoencoderConfig(mirror=False, tint=0.2)
    varied = augment(skies, torch.Generator().manual_seed(1), config)
    gain = varied / skies
    torch.testing.assert_close(gain, gain[:, :1, :1].expand_as(gain), rtol=1e-4, atol=0)
    assert float((gain[:, 0, 0] / gain[:, 0, 0].mean(1, keepdim=True)).std()) > 0.05


@pytest.mark.parametrize("most", [0.4, 1.0])
def test_white_balance_goes_part_of_the_way_to_a_grey_mean(most: float) -> None:
    """The logs of the means' ratios shrink by a factor of their own, at least 1 - ``most``."""
    skies = torch.rand(40, 32, 128, 3, generator=torch.Generator().manual_seed(0)) + 0.1
    skies = skies * torch.tensor([0.5, 1.0, 2.0])
    config = AutoencoderConfig(mirror=False, white_balance=most)
    varied = augment(skies, torch.Generator().manual_seed(1), config)
    solid = DirectionGrid.sky(32).solid_angles.float()
    before, after = (
        torch.einsum("n,bnc->bc", solid, s.flatten(1, 2)).log() for s in (skies, varied)
    )
    left = [(x[:, [0, 2]] - x[:, 1:2]) for x in (before, after)]
    share = left[1] / left[0]
    torch.testing.assert_close(share[:, 0], share[:, 1], rtol=1e-3, atol=1e-3)
    assert 1 - most - 1e-4 <= float(share.min()) < 1 - 0.8 * most
    assert 0.9 < float(share.max()) < 1 + 1e-4
    assert torch.equal(augment(skies, torch.Generator().manual_seed(1), config), varied)


def test_the_share_of_skies_with_surroundings_is_kept() -> None:
    skies = torch.ones(60, 32, 128, 3)
    config = AutoencoderConfig(mirror=False, surroundings=0.25)
    varied = augment(skies, torch.Generator().manual_seed(2), config)
    changed = (varied - 1).abs().amax(dim=(1, 2, 3)) > 0.01
    assert 0.1 < float(changed.float().mean()) < 0.4


CONFIG = AutoencoderConfig(surroundings=0.5, tint=0.1)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """Nine skies with a sun."""
    skies = torch.rand(9, 32, 128, 3, generator=torch.Generator().manual_seed(0))
    skies[:, 9, 64] = 3000.0
    np.save(tmp_path / "skies.npy", normalise(skies).numpy())
    return tmp_path / "skies.npy"


def test_they_are_what_the_network_makes_of_varied_skies(path: Path, tmp_path: Path) -> None:
    prepare(path, CONFIG, tmp_path / "out", [0, 2])
    found = [open_prepared(path, CONFIG, tmp_path / "out", copy) for copy in (0, 2)]
    network = initial_network(CONFIG)
    for copy, skies in zip((0, 2), found, strict=True):
        varied = augment(
            torch.from_numpy(np.load(path)),
            torch.Generator().manual_seed(copy * 1_000_003),
            CONFIG,
        )
        sun, rest = network.split(varied)
        np.testing.assert_allclose(skies.sun, sun.numpy(), rtol=1e-6)
        # half precision
        np.testing.assert_allclose(skies.coded, network.code(rest).numpy(), rtol=1e-3, atol=1e-4)
        one, coded = skies.batch([3])
        assert one.dtype == coded.dtype == torch.float32
        assert np.array_equal(coded.numpy()[0], skies.coded[3].astype(np.float32))
    assert not np.array_equal(found[0].coded, found[1].coded)


def test_they_are_made_once(path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    told: list[tuple[str, float]] = []
    prepare(path, CONFIG, tmp_path / "out", [0], lambda *each: told.append(each))
    assert told == [("preparing sky 9 of 9", 1.0)]
    prepare(path, replace(CONFIG, seed=1), tmp_path / "out", [0])
    monkeypatch.setattr(module, "in_order", None)
    prepare(path, CONFIG, tmp_path / "out", [0])
    one, other = (
        open_prepared(path, config, tmp_path / "out", 0)
        for config in (CONFIG, replace(CONFIG, seed=1))
    )
    assert not np.array_equal(one.coded, other.coded)


def test_another_code_is_another_copy(
    path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of a class that the user has changed since."""
    config = replace(CONFIG, network="tests.own_network:TinyNetwork")
    monkeypatch.setattr(module, "is_importable", lambda _: False)  # in this process
    ways = (tmp_path / "out", [0], lambda *_: None, TinyNetwork)
    prepare(path, config, *ways)
    before = open_prepared(path, config, tmp_path / "out", 0).coded
    monkeypatch.setattr(TinyNetwork, "code", lambda _, sky: sky.permute(0, 3, 1, 2).sqrt())
    prepare(path, config, *ways)
    assert not np.array_equal(open_prepared(path, config, tmp_path / "out", 0).coded, before)


def test_what_was_interrupted_is_made_again(
    path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "_CHUNK", 4)

    def broken(*_: object) -> object:
        yield coded_skies(initial_network(CONFIG), torch.from_numpy(np.load(path)[:4]))
        raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr(module, "in_order", broken)
        with pytest.raises(KeyboardInterrupt):
            prepare(path, CONFIG, tmp_path / "out", [0])
    assert not list((tmp_path / "out").iterdir())
    prepare(path, CONFIG, tmp_path / "out", [0])
    assert len(open_prepared(path, CONFIG, tmp_path / "out", 0)) == 9


def test_a_sun_in_linear_code_stays_finite(path: Path) -> None:
    """A network without a sun head sees it; half precision ends at 65,504."""
    config = AutoencoderConfig(network="convolutions", coding="linear", sun=False)
    skies = torch.from_numpy(np.load(path)) * 1e3
    found = coded_skies(initial_network(config), skies)
    assert found.sun.shape == (9, 0)
    assert np.isfinite(found.coded).all()
    assert found.coded.max() > 5e4


WHOLE = slice(None)
BATCHES = AutoencoderConfig(batch=4)


def marked(count: int, copies: int = 1) -> list[CodedSkies]:
    """Sky i is i everywhere, its sun 1,000 times the number of the copy."""
    values = np.arange(count, dtype=np.float16)[:, None, None, None]
    coded = np.broadcast_to(values, (count, 3, 32, 128)).copy()
    return [
        CodedSkies(np.full((count, 5), 1000 * copy, np.float32), coded) for copy in range(copies)
    ]


def numbers(batch: torch.Tensor) -> list[int]:
    assert batch.dtype == torch.float32
    return batch[:, 0, 0, 0].int().tolist()


def test_batches_cover_an_epoch_once_and_differ_between_epochs() -> None:
    skies = marked(12)
    seen = [numbers(draw_batch(skies, BATCHES, 0, i, WHOLE)[1]) for i in range(3)]
    assert sorted(number for batch in seen for number in batch) == list(range(12))
    _, again, drawn = draw_batch(skies, BATCHES, 0, 1, WHOLE)
    assert numbers(again) == seen[1]
    for ours, same in zip(drawn, draw_batch(skies, BATCHES, 0, 1, WHOLE)[2], strict=True):
        assert torch.equal(ours, same)
    assert not torch.equal(drawn.noise, draw_batch(skies, BATCHES, 0, 2, WHOLE)[2].noise)
    assert numbers(draw_batch(skies, BATCHES, 1, 1, WHOLE)[1]) != seen[1]


def test_copies_take_turns() -> None:
    skies = marked(8, copies=3)
    suns = [draw_batch(skies, BATCHES, epoch, 1, WHOLE)[0] for epoch in range(5)]
    assert [int(sun[0, 0]) for sun in suns] == [0, 1000, 2000, 0, 1000]


def test_corruption_is_as_strong_as_the_configuration_says() -> None:
    config = replace(BATCHES, noise_sigma=0.2, masked=0.25, sun_noise=0.1)
    drawn = draw_corruption(200, (32, 128), torch.Generator().manual_seed(0), config)
    assert float(drawn.noise.std()) == pytest.approx(0.2, rel=0.01)
    assert float(drawn.noise.mean()) == pytest.approx(0, abs=1e-3)
    assert float(drawn.sun.std()) == pytest.approx(0.1, rel=0.1)
    assert float(1 - drawn.kept.mean()) == pytest.approx(0.25, abs=0.02)
    blocks = drawn.kept.reshape(200, 4, BLOCK, 16, BLOCK)
    assert torch.equal(blocks.amin((2, 4)), blocks.amax((2, 4)))  # whole blocks


def test_shares_together_are_the_batch() -> None:
    config = replace(BATCHES, latent_noise=0.1, sun_noise=0.1)
    sun, sky, drawn = draw_batch(marked(8), config, 2, 1, WHOLE)
    halves = [draw_batch(marked(8), config, 2, 1, part) for part in (slice(0, 2), slice(2, 4))]
    assert torch.equal(torch.cat([half[0] for half in halves]), sun)
    assert torch.equal(torch.cat([half[1] for half in halves]), sky)
    for ours, wanted in zip(Corruption.stack([half[2] for half in halves]), drawn, strict=True):
        assert torch.equal(ours, wanted)


def test_the_skies_on_disk_stay_as_they_are() -> None:
    skies = marked(4)
    sun, sky, _ = draw_batch(skies, BATCHES, 0, 0, WHOLE)
    sky += 1
    sun += 1
    assert np.array_equal(skies[0].coded, marked(4)[0].coded)
    assert np.array_equal(skies[0].sun, marked(4)[0].sun)
