"""Rendered people under one light relit to another, beside their rendering under that one."""

from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType

import numpy as np
from jaxtyping import Bool
from numpy import ndarray

from skylight.errors import InputError
from skylight.evaluation._known_faces import (
    FaceEvaluation,
    FaceSource,
    known_face,
)
from skylight.evaluation._relit_scores import (
    PHOTOGRAPH,
    RELIT,
    TRANSFER,
    TRUTH,
    UNCHANGED,
    best_exposed,
    colour_transfer,
    compared,
    encoded,
    head_mask,
    mean_over,
    score,
)
from skylight.evaluation._run import Check, Item, Rows
from skylight.imaging._photo import photo_from_codes
from skylight.io._files import write_png
from skylight.people._files import RenderedFace, read_rendered_face
from skylight.portrait._relit import FaceReflection, light_in_photo, portrait_of, shared_light

TRUE_LIGHT, TRUE_HEAD = "relit_true_light", "relit_true_head"
TRUE_BOTH, BALD = "relit_true_light_and_head", "relit_without_shell"
# Of the person and of skin: mean RMSE, ours over the transfer's, and mean PSNR in dB.
GOALS = {"": (0.5, 26.0), "_skin": (0.45, 28.0)}
LEAST_SSIM = 0.88  # in the mean
BLOTCH_RATIO = 0.7  # of each face, ours over the transfer's


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
    (:func:`~skylight.evaluation._relit_scores.colour_transfer`), which a user would not
    have; and ``unchanged``. All but the transfer get the one exposure at which they are nearest to
    the truth. Scores (:func:`~skylight.evaluation._relit_scores.score`) are of sRGB values over
    the person (head and hair), and with ``_skin`` over the head's skin that no hair covers. Of
    each item, ``shared light`` says how much of its two lights is the same
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

        truth = encoded(new.linear.numpy())
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
        shown = {name: best_exposed(one, truth, person) for name, one in pictures.items()}
        shown[TRANSFER] = colour_transfer(old.encoded / np.float32(255), truth, person)
        metrics = {
            name: score(one, truth, person) | score(one, truth, skin, "_skin")
            for name, one in shown.items()
        }
        rows = {PHOTOGRAPH: old.encoded / np.float32(255), **shown, TRUTH: truth}
        write_png(picture, compared(rows))
        facts: dict[str, object] = {
            "skin tone": old.cluster,
            "direction": estimate.verdict.direction.word,
            "shared light": shared_light(old.environment, new.environment),
            **found.facts,
        }
        return Item(name=item, metrics=metrics, facts=facts)

    def checks(self, rows: Rows, items: list[Item]) -> dict[str, Check]:
        checks: dict[str, Check] = {}
        measured = [item for item in items if item.metrics]
        for over, (most, least_db) in GOALS.items():
            rmse, psnr, ssim = (f"srgb_{name}{over}" for name in ("rmse", "psnr", "ssim"))
            ratio = mean_over(measured, rmse, TRANSFER)
            checks[f"mean {rmse} over that of {TRANSFER}"] = Check.at_most(ratio, most)
            ours = rows[RELIT]
            checks[f"mean {psnr}, dB"] = Check.at_least(ours[psnr]["mean"], least_db)
            checks[f"mean {ssim}"] = Check.at_least(ours[ssim]["mean"], LEAST_SSIM)
            higher = [item.metrics[RELIT][ssim] > item.metrics[TRANSFER][ssim] for item in measured]
            name = f"faces whose {ssim} is above that of {TRANSFER}"
            checks[name] = Check.at_least(float(np.mean(higher)), 1.0)
        worst = max(mean_over([item], "blotch", TRANSFER) for item in measured)
        checks[f"largest blotch over that of {TRANSFER}"] = Check.at_most(worst, BLOTCH_RATIO)
        return checks


def person_masks(face: RenderedFace) -> tuple[Bool[ndarray, "h w"], Bool[ndarray, "h w"]]:
    """(head and hair, the head where no hair covers it) by the true mesh, neck included."""
    head = head_mask(face.truth)
    return head | face.hair, head & ~face.hair
