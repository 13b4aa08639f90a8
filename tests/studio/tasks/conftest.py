"""An estimate by the studio's tasks, run in this process, and its person taken apart."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from skimage.data import astronaut

from skylight.estimation._photos import estimate_photo
from skylight.estimation._summary import PhotoEstimate
from skylight.portrait._relit import Portrait, portrait_of
from skylight.studio.tasks import _light as light_task, _portrait as portrait_task
from skylight.studio.tasks._portrait import FILE


@dataclass(frozen=True, kw_only=True)
class Told:
    """The estimate, the task's answer and stages, and its job's folder."""

    found: PhotoEstimate
    answer: dict[str, Any]
    stages: dict[str, list[float]]
    folder: Path


@pytest.fixture(scope="session")
def told(tmp_path_factory: pytest.TempPathFactory) -> Told:
    """Of a face that one lamp lights."""
    folder = tmp_path_factory.mktemp("job")
    (folder / "files").mkdir()
    Image.fromarray(astronaut()).resize((256, 256)).save(folder / "me.png")
    found: list[PhotoEstimate] = []
    stages: dict[str, list[float]] = {}

    def kept(*given: Any, **options: Any) -> PhotoEstimate:
        found.append(estimate_photo(*given, **options))
        return found[0]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(light_task, "estimate_photo", kept)
        answer = light_task.estimate_light(
            str(folder / "me.png"), "me.png", 10**6, str(folder / "files"), 1, "lamps",
            tell=lambda stage, share: stages.setdefault(stage, []).append(share),
        )  # fmt: skip
    return Told(found=found[0], answer=answer, stages=stages, folder=folder)


@dataclass(frozen=True, kw_only=True)
class TakenApart:
    """What the page gets of a person, the portrait that it is made of, and the photograph."""

    file: Path
    portrait: Portrait
    codes: np.ndarray


@pytest.fixture(scope="session")
def taken_apart(told: Told, tmp_path_factory: pytest.TempPathFactory) -> TakenApart:
    out, portraits = tmp_path_factory.mktemp("apart"), []

    def kept(*given: Any, **options: Any) -> Portrait:
        portraits.append(portrait_of(*given, **options))
        return portraits[0]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(portrait_task, "portrait_of", kept)
        portrait_task.take_apart(
            str(told.folder / "me.png"), "me.png", 10**6, str(told.folder), str(out),
            tell=lambda *_: None,
        )  # fmt: skip
    codes = told.found.photos[0].encoded
    return TakenApart(file=out / FILE, portrait=portraits[0], codes=codes)
