"""Photographs of faces under one lamp relit to another, beside the photographs under that one."""

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from types import MappingProxyType

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float
from numpy import ndarray
from torch import Tensor

from skylight.errors import InputError
from skylight.evaluation._known_faces import EstimateOptions, FaceEvaluation, observe_largest
from skylight.evaluation._lamps import lamp_index, read_lamp_photo
from skylight.evaluation._relit_scores import (
    PHOTOGRAPH,
    RELIT,
    TRANSFER,
    TRUTH,
    UNCHANGED,
    best_exposed,
    colour_transfer,
    compared,
    head_mask,
    mean_over,
    score,
)
from skylight.evaluation._run import Check, Evaluation, Item, Rows
from skylight.faces._model import HeadModel
from skylight.faces._observe import hair_of
from skylight.imaging._photo import Photo, read_photo
from skylight.inverse._verdict import CAMERA
from skylight.io._files import write_png
from skylight.portrait._relit import FaceReflection, Portrait, light_in_photo, portrait_of
from skylight.sphere._envmap import EnvironmentMap
from skylight.sphere._frame import angle_between

LIT_SHARE = 0.6  # of a ball's disc, as the camera sees it
MAP_ROWS = 128  # the lamp is within cells of 1.4 degrees
RMSE_RATIO = 0.5  # of the mean, ours over the transfer's


@dataclass(frozen=True, kw_only=True)
class RelitLamps(FaceEvaluation):
    """Photographs of ``data``/lamps.json, as :class:`~skylight.evaluation._lamps.Lamps` reads them,
    relit from their own lamp to that of another photograph of the same person, in the same pose.

    Of each person, the lamps that light a good part of the face, ``(1 + z) / 2 >= 0.6``, stand in a
    random circle; the first ``sources`` are each relit to the ``targets`` that follow. Head and
    light are estimated from the one photograph, once. The other lamp is given as a map that is
    black beside it, in the colour that the light found has for a surface which faces the camera:
    both lamps are of a kind. What the room adds is not in it, so shadows may be too dark.

    Rows: ``relit``; ``transfer``, the photograph with the true one's mean and deviation in CIELAB;
    ``unchanged``; and ``peers``, of each its name and a folder of pictures by others, ``PAIR.png``
    in sRGB (the pairs are named in results.json, their first photograph is relit to the lamp of the
    second). All but the transfer get the exposure that is nearest to the truth. Scores
    (:func:`~skylight.evaluation._relit_scores.score`) are over the head fitted to the first
    photograph, where no hair covers it.
    """

    title = "relit-lamps"
    needs = "photographs of faces and a lamps.json, as for lamps, two of a person or more"
    data_folder = "lamps"
    quick = MappingProxyType({"sources": 1, "targets": 1})
    selects = ("sources", "targets")

    data: Path
    sources: int = 3
    targets: int = 3
    peers: tuple[tuple[str, Path], ...] = ()

    def __post_init__(self) -> None:
        pairs = self.pairs()
        if not pairs:
            raise InputError(
                f"{self.data}: no person of its lamps.json has two photographs whose lamp stands "
                "well before the face; give two of one person (names begin with the person's, up "
                "to the first _)"
            )
        for name, folder in self.peers:
            if name in (RELIT, TRANSFER, UNCHANGED, PHOTOGRAPH, TRUTH):
                raise InputError(f"{name} is a picture of ours: give the peer another name")
            if not any((folder / f"{pair}.png").is_file() for pair in pairs):
                usual = f"{next(iter(pairs))}.png"
                raise InputError(f"{folder}: no relit picture of a pair in it, such as {usual}")

    def config(self) -> dict[str, object]:
        """With the hashes of the peers' pictures."""
        digests: dict[str, str] = {}
        for name, folder in self.peers:
            digest = hashlib.sha256()
            for path in sorted(folder.glob("*.png")):
                digest.update(path.name.encode() + path.read_bytes())
            digests[name] = digest.hexdigest()
        return super().config() | {"peers": digests}

    def with_peers(self, peers: Mapping[str, Path]) -> "Evaluation":
        return replace(self, peers=tuple(peers.items()))

    def items(self) -> list[str]:
        return list(self.pairs())

    def pairs(self) -> dict[str, tuple[str, str]]:
        """Files (from, to) by the pair's name."""
        people: dict[str, list[str]] = {}
        for name, lamp in sorted(lamp_index(self.data).items()):
            if (1 + lamp[2]) / 2 >= LIT_SHARE:
                people.setdefault(name.partition("_")[0], []).append(name)
        rng, pairs = np.random.default_rng(self.seed), {}
        for names in people.values():
            circle = [names[i] for i in rng.permutation(len(names))]
            for i, one in enumerate(circle[: self.sources]):
                for k in range(1, min(self.targets + 1, len(circle))):
                    other = circle[(i + k) % len(circle)]
                    stems = (file.rpartition(".")[0] for file in (one, other))
                    pairs["--".join(stems).replace("/", "_")] = (one, other)
        return pairs

    def measure(self, item: str, picture: Path) -> Item:
        one, other = self.pairs()[item]
        source = _taken_apart(self.data / one, self.options)
        truth = read_lamp_photo(self.data / other).encoded / np.float32(255)
        own = source.photo.encoded / np.float32(255)
        if truth.shape != own.shape:
            raise InputError(f"{other}: of another size than {one}, so no pair; crop both alike")
        before, lamp = (
            torch.tensor(lamp_index(self.data)[name], dtype=torch.float64) for name in (one, other)
        )
        black = EnvironmentMap(radiance=torch.zeros(MAP_ROWS, 2 * MAP_ROWS, 3))
        light = black.with_light(lamp, source.received)
        linear = {RELIT: source.portrait.under(light, keep="brightness")[0]}
        linear[UNCHANGED] = source.photo.pixels.numpy()
        for name, folder in self.peers:
            path = folder / f"{item}.png"
            if path.is_file():
                linear[name] = _of_size(read_photo(path).pixels.numpy(), truth.shape[:2])
        shown = {name: best_exposed(each, truth, source.skin) for name, each in linear.items()}
        shown[TRANSFER] = colour_transfer(own, truth, source.skin)
        write_png(picture, compared({PHOTOGRAPH: own, **shown, TRUTH: truth}))
        return Item(
            name=item,
            metrics={
                name: score(each, truth, source.skin, "_skin") for name, each in shown.items()
            },
            facts={
                "person": one.partition("_")[0],
                "degrees between the lamps": float(torch.rad2deg(angle_between(before, lamp))),
                "direction": source.direction,
            },
        )

    def checks(self, rows: Rows, items: list[Item]) -> dict[str, Check]:
        ratio = mean_over(items, "srgb_rmse_skin", TRANSFER)
        checks = {f"mean srgb_rmse_skin over that of {TRANSFER}": Check.at_most(ratio, RMSE_RATIO)}
        for other in (UNCHANGED, *(name for name, _ in self.peers if name in rows)):
            for metric in ("srgb_rmse_skin", "blotch_skin"):
                ratio = mean_over(items, metric, other)
                checks[f"mean {metric} over that of {other}"] = Check.at_most(ratio, 1.0)
            ratio = mean_over(items, "srgb_ssim_skin", other)
            checks[f"mean srgb_ssim_skin over that of {other}"] = Check.at_least(ratio, 1.0)
        return checks


@dataclass(frozen=True, kw_only=True)
class _Source:
    """A photograph to be relit; ``received``: by a surface that faces the camera, linear."""

    photo: Photo
    portrait: Portrait
    skin: Bool[ndarray, "h w"]
    received: Float[Tensor, "3"]
    direction: str


@lru_cache(maxsize=1)  # its pairs follow each other
def _taken_apart(path: Path, options: EstimateOptions) -> _Source:
    photo = read_lamp_photo(path)
    fit, view = observe_largest(photo, path.name)
    estimate = options.estimate(view.observation, options.light)
    found = light_in_photo(estimate)
    reflection = FaceReflection.of(estimate, view.observation)
    return _Source(
        photo=photo,
        portrait=portrait_of(photo, fit, reflection, found),
        skin=head_mask(fit) & (hair_of(photo.pixels, HeadModel.load(), fit) < 0.5),
        received=found.irradiance(CAMERA.float()).double(),
        direction=estimate.verdict.direction.word,
    )


def _of_size(picture: Float[ndarray, "k l 3"], size: tuple[int, int]) -> Float[ndarray, "h w 3"]:
    """Some methods answer in a size of their own."""
    if picture.shape[:2] == size:
        return picture
    return cv2.resize(picture, size[::-1], interpolation=cv2.INTER_AREA)
