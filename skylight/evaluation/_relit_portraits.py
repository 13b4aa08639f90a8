"""Rendered people under one light relit to another, beside their rendering under that one.

The baseline is a global transfer of colour between pictures (Reinhard et al. 2001).
"""

from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType

import numpy as np
import torch
from jaxtyping import Bool, Float, UInt8
from numpy import ndarray
from skimage.color import lab2rgb, rgb2lab
from skimage.metrics import structural_similarity

from skylight.errors import InputError
from skylight.evaluation._known_faces import (
    FaceEvaluation,
    FaceSource,
    known_face,
)
from skylight.evaluation._pictures import caption, sized
from skylight.evaluation._run import Check, Item, Rows
from skylight.faces._model import HeadModel
from skylight.imaging._colour import linear_to_srgb, srgb_to_linear
from skylight.imaging._photo import photo_from_codes
from skylight.io._files import write_png
from skylight.people._files import RenderedFace, read_rendered_face
from skylight.portrait._relit import FaceReflection, light_in_photo, portrait_of, shared_light
from skylight.transport._rays import Raycaster
from skylight.transport._render import rasterize


def colour_transfer(
    picture: Float[ndarray, "h w 3"],
    target: Float[ndarray, "h w 3"],
    mask: Bool[ndarray, "h w"],
) -> Float[ndarray, "h w 3"]:
    """An sRGB picture (0 to 1) with the mean and deviation of ``target`` under the mask.

    Each channel of CIELAB by itself, where Reinhard et al. take their l-alpha-beta.
    """
    own, wanted = rgb2lab(picture), rgb2lab(target)
    deviation = np.maximum(own[mask].std(0), 1e-6)
    moved = (own - own[mask].mean(0)) / deviation * wanted[mask].std(0) + wanted[mask].mean(0)
    with np.errstate(invalid="ignore"):
        return np.clip(lab2rgb(moved), 0, 1).astype(np.float32)


RELIT, TRUE_LIGHT, TRUE_HEAD = "relit", "relit_true_light", "relit_true_head"
TRUE_BOTH = "relit_true_light_and_head"
BALD, TRANSFER, UNCHANGED = "relit_without_shell", "transfer", "unchanged"
RMSE_RATIO = 0.5  # of the mean, ours over the transfer's
TILE = 200  # pixels of a picture's side in the strips
EXPOSURES = np.exp2(np.linspace(-1.5, 1.5, 61))  # about that of equal medians


@dataclass(frozen=True, kw_only=True)
class RelitPortraits(FaceEvaluation):
    """People of ``data``/from relit to the light of the same people in ``data``/to.

    Both folders are made by ``skylight faces render``, the second one with ``--light-seed``.
    Landmarks, head and light of the first picture are estimated from it; the second light is given
    as its map. Rows: ``relit``; ``relit_true_light``, the same from the true first light;
    ``relit_true_head``, from the true head and the light found; ``relit_true_light_and_head``, from
    both, which leaves the errors of the method and of the specular scale found;
    ``relit_without_shell``, without the shell of hair; ``transfer``, the first picture with the
    mean and deviation in CIELAB of the true second one
    (:func:`~skylight.evaluation._relit_portraits.colour_transfer`), which a user would not
    have; and ``unchanged``. All but the transfer get the one exposure at which they are nearest to
    the truth. Scores are of sRGB values over the person (head and hair), and with ``_skin`` over
    the head's skin that no hair covers: root mean square error, and the mean of local SSIM (windows
    of 7 x 7). Of each item, ``shared light`` says how much of its two lights is the same
    (:func:`~skylight.portrait._relit.shared_light`).
    """

    title = "relit-portraits"
    needs = "folders from and to of the same people, made by 'skylight faces render --light-seed'"
    data_folder = "relit"
    quick = MappingProxyType({"count": 4})
    selects = ("data", "count")

    data: Path
    count: int | None = None

    def __post_init__(self) -> None:
        for folder in ("from", "to"):
            if not (self.data / folder).is_dir():
                raise InputError(
                    f"{self.data}: no folder {folder} in it; make it with: skylight faces render "
                    f"--out {self.data / folder}" + (" --light-seed N" if folder == "to" else "")
                )
        for name in self.items():
            old, new = (read_rendered_face(self.data / f / name) for f in ("from", "to"))
            if not np.array_equal(old.truth.vertices, new.truth.vertices):
                raise InputError(
                    f"{self.data / 'to' / name}: another person than in the folder from; render "
                    "both with the same --seed and options, and this one with --light-seed"
                )

    @property
    def sources(self) -> tuple[FaceSource, FaceSource]:
        first = FaceSource(data=self.data / "from", count=self.count)
        return first, replace(first, data=self.data / "to")

    def config(self) -> dict[str, object]:
        first, second = (source.config() for source in self.sources)
        return super().config() | {"from": first, "to": second}

    def items(self) -> list[str]:
        return self.sources[0].names()

    def measure(self, item: str, picture: Path) -> Item:
        old, new = (read_rendered_face(self.data / folder / item) for folder in ("from", "to"))
        light = self.options.light
        found = self.lit(known_face(old), (light,))
        fit, estimate = found.fit, found.estimates[light]
        photo = photo_from_codes(old.encoded)

        truth = _encoded(new.linear.numpy())
        person, skin = person_masks(old)
        reflection = FaceReflection.of(estimate, found.view.observation)
        light, unbent = light_in_photo(estimate), replace(reflection, head_error=None)
        portraits = {
            RELIT: portrait_of(photo, fit, reflection, light),
            TRUE_LIGHT: portrait_of(photo, fit, reflection, old.environment),
            TRUE_HEAD: portrait_of(photo, old.truth, unbent, light),
            TRUE_BOTH: portrait_of(photo, old.truth, unbent, old.environment),
            BALD: portrait_of(photo, fit, reflection, light, shell=False),
        }
        pictures = {name: one.under(new.environment)[0] for name, one in portraits.items()}
        pictures[UNCHANGED] = old.picture.numpy()
        shown = {
            name: _encoded(nearest_exposure(one, truth, person) * one)
            for name, one in pictures.items()
        }
        shown[TRANSFER] = colour_transfer(old.encoded / np.float32(255), truth, person)
        metrics = {
            name: score(one, truth, person) | _named(score(one, truth, skin), "_skin")
            for name, one in shown.items()
        }
        rows = {"photograph": old.encoded / np.float32(255), **shown, "truth": truth}
        write_png(picture, np.hstack([_tile(name, one) for name, one in rows.items()]))
        facts: dict[str, object] = {
            "skin tone": old.cluster,
            "direction": estimate.verdict.direction.word,
            "shared light": shared_light(old.environment, new.environment),
            **found.facts,
        }
        return Item(name=item, metrics=metrics, facts=facts)

    def checks(self, rows: Rows, items: list[Item]) -> dict[str, Check]:
        checks: dict[str, Check] = {}
        for over in ("", "_skin"):
            metric = f"srgb_rmse{over}"
            ratio = rows[RELIT][metric]["mean"] / rows[TRANSFER][metric]["mean"]
            checks[f"mean {metric} over that of {TRANSFER}"] = Check.at_most(ratio, RMSE_RATIO)
            metric = f"srgb_ssim{over}"
            higher = [
                item.metrics[RELIT][metric] > item.metrics[TRANSFER][metric]
                for item in items
                if item.metrics
            ]
            name = f"faces whose {metric} is above that of {TRANSFER}"
            checks[name] = Check.at_least(float(np.mean(higher)), 1.0)
        return checks


def person_masks(face: RenderedFace) -> tuple[Bool[ndarray, "h w"], Bool[ndarray, "h w"]]:
    """(head and hair, the head where no hair covers it) by the true mesh, neck included."""
    vertices = torch.from_numpy(face.truth.vertices)
    faces = torch.from_numpy(HeadModel.load().faces.copy())
    surface = rasterize(face.truth.camera, vertices, faces, Raycaster(vertices, faces))
    head = surface.image(torch.ones(len(surface), 1))[..., 0].numpy() > 0
    return head | face.hair, head & ~face.hair


def nearest_exposure(
    linear: Float[ndarray, "h w 3"], truth: Float[ndarray, "h w 3"], mask: Bool[ndarray, "h w"]
) -> float:
    """The factor, of :data:`EXPOSURES`, at which a linear picture is nearest to an sRGB one."""
    seen, wanted = linear[mask], truth[mask]
    middle = float(np.median(_encoded(seen)))
    level = _linear(float(np.median(wanted))) / max(_linear(middle), 1e-6)
    errors = [float(np.square(_encoded(level * k * seen) - wanted).mean()) for k in EXPOSURES]
    return level * float(EXPOSURES[int(np.argmin(errors))])


def score(
    picture: Float[ndarray, "h w 3"], truth: Float[ndarray, "h w 3"], mask: Bool[ndarray, "h w"]
) -> dict[str, float]:
    """Of sRGB values from 0 to 1, over a mask."""
    # with full=True it answers (mean, map)
    similar = np.asarray(
        structural_similarity(picture, truth, channel_axis=2, data_range=1.0, full=True)[1]
    )
    return {
        "srgb_rmse": float(np.sqrt(np.square(picture - truth)[mask].mean())),
        "srgb_ssim": float(similar[mask].mean()),
    }


def _named(metrics: dict[str, float], suffix: str) -> dict[str, float]:
    return {name + suffix: value for name, value in metrics.items()}


def _linear(encoded: float) -> float:
    return float(srgb_to_linear(torch.tensor(encoded, dtype=torch.float64)))


def _encoded(linear: Float[ndarray, "*s"]) -> Float[ndarray, "*s"]:
    return linear_to_srgb(torch.from_numpy(np.clip(linear, 0, 1)).float()).numpy()


def _tile(name: str, encoded: Float[ndarray, "h w 3"]) -> UInt8[ndarray, "k l 3"]:
    codes = np.round(255 * encoded).astype(np.uint8)
    return np.vstack([caption(name, TILE), sized(codes, TILE, TILE)])
