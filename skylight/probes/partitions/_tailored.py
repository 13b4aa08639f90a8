"""Designs optimised for a set of lights, and their error on held-out ones."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch

from skylight.errors import InputError
from skylight.probes.partitions._cells import Cells
from skylight.probes.partitions._optimise import (
    RelightingError,
    SearchSettings,
    optimise_design,
    symmetric_design,
    turned_about_vertical,
)
from skylight.probes.partitions._seeds import ProbeDesign
from skylight.probes.partitions._sun_path import MAP_HEIGHT, Lights
from skylight.sphere._envmap import luminance
from skylight.transport._scene import evaluation_scene
from skylight.work._progress import StageProgress

_SCENE_HEIGHT = 20  # pixels: 390 points, a third of them on objects and in their shadows
_LIGHTS = 288  # that the search sees at least, maps times their turns


@dataclass(frozen=True, kw_only=True)
class Score:
    """MAE of relit shading over its mean, on the lights searched on and on the others."""

    training: float
    held_out: float


@dataclass(frozen=True, kw_only=True, eq=False)
class Optimised:
    """A design, the scores of it and of others by name, and the lights of both sets.

    ``scores`` begin with the symmetric design and end with this one.
    """

    design: ProbeDesign
    scores: dict[str, Score]
    training: tuple[str, ...]
    held_out: tuple[str, ...]

    @property
    def gain(self) -> float:
        """Share of the symmetric design's held-out error that this one saves."""
        held = [score.held_out for score in self.scores.values()]
        return 1 - held[-1] / held[0]


def optimise_for(
    lights: Lights,
    name: str,
    count: int,
    *,
    held_out: float = 0.5,
    seed: int = 0,
    settings: SearchSettings | None = None,
    rivals: Sequence[ProbeDesign] = (),
    tell: StageProgress = lambda _stage, _share: None,
) -> Optimised:
    """Search on a training set of the lights, and compare with other designs on the test set.

    The test set is a share ``held_out``, drawn at random. The search uses luminance, the scores
    all colours.
    """
    others = (symmetric_design(count), *rivals)
    if name in [other.name for other in others]:
        raise InputError(f"there is a design {name!r} already: choose another name")
    generator = torch.Generator().manual_seed(seed)
    training, test = _divide(lights.groups, held_out, generator)
    scene = evaluation_scene(_SCENE_HEIGHT, MAP_HEIGHT)
    transport = scene.albedo[:, :1] * scene.transport.matrix

    def error_on(which: Sequence[int], *, coloured: bool = True) -> RelightingError:
        maps = lights.maps[list(which)]
        if not coloured:
            maps = luminance(maps)[..., None]
        turns = 1 if lights.oriented else max(1, math.ceil(_LIGHTS / len(which)))
        # from equal generators, so that grey and coloured lights are turned alike
        same = torch.Generator().manual_seed(seed)
        turned = turned_about_vertical(maps, turns, same) if turns > 1 else maps.flatten(1, 2)
        return RelightingError(transport, turned, scene.grid)

    design = optimise_design(
        name,
        count,
        error_on(training, coloured=False),
        generator,
        settings=settings,
        oriented=lights.oriented,
        progress=tell,
    )
    on_training, on_test = error_on(training), error_on(test)
    scores = {}
    for each in (*others, design):
        cells = Cells.of(each)
        scores[each.name] = Score(
            training=on_training.of_cells(cells), held_out=on_test.of_cells(cells)
        )
    return Optimised(
        design=design,
        scores=scores,
        training=tuple(lights.names[i] for i in training),
        held_out=tuple(lights.names[i] for i in test),
    )


def _divide(
    groups: Sequence[int], held_out: float, generator: torch.Generator
) -> tuple[list[int], list[int]]:
    """Places of the lights to search on, and of the others; groups stay whole."""
    known = sorted(set(groups))
    if not 0 < held_out < 1:
        raise InputError(f"the share held out must be between 0 and 1, got {held_out:g}")
    if len(known) < 2:
        raise InputError(
            "one map or weather is too few: give one to search on and one to test with"
        )
    order = torch.randperm(len(known), generator=generator).tolist()
    kept_back = min(max(1, round(held_out * len(known))), len(known) - 1)
    test = {known[i] for i in order[:kept_back]}
    places = range(len(groups))
    return [i for i in places if groups[i] not in test], [i for i in places if groups[i] in test]
