"""Environment maps converted between projections and conventions."""

from pathlib import Path

import torch

from skylight._names import PLAIN_READING, Convention, MapReading, Projection
from skylight.errors import InputError
from skylight.io._files import read_environment_map, read_light, write_environment_map, write_light
from skylight.sphere._projections import from_latlong, horizontal_cross, to_latlong

# rows of each picture over those of a lat-long map with as much detail at the horizon
_ROWS: dict[Projection, float] = {
    "latlong": 1.0,
    "cube": 1.5,
    "octahedral": 1.0,
    "angular": 2.0,
    "mirrorball": 2.0,
}


def convert_file(
    source: Path,
    out: Path,
    *,
    projection: Projection,
    convention: Convention = "skylight",
    source_projection: Projection = "latlong",
    source_convention: Convention = "skylight",
    height: int | None = None,
    half: bool = False,
    reading: MapReading = PLAIN_READING,
) -> tuple[int, int]:
    """Convert and return the (rows, columns) that were written.

    Between lat-long maps of one size nothing is resampled: columns are rolled, exactly. A smaller
    or larger lat-long map keeps its energy exactly; what other projections keep is said at
    :func:`skylight.sphere._projections.from_latlong`.

    Raises
    ------
    InputError
        A file, shape or convention that cannot be used.
    """
    for kind, turned in ((projection, convention), (source_projection, source_convention)):
        if kind != "latlong" and turned != "skylight":
            raise InputError(
                f"the convention {turned} is one of lat-long maps; leave it out for {kind}"
            )
    if source_projection == "latlong":
        light = read_environment_map(source, convention=source_convention, **vars(reading))
    else:
        picture = read_light(source, **vars(reading))
        if source_projection == "cube":
            picture = horizontal_cross(picture)
        rows = 2 * max(1, round(picture.shape[0] / _ROWS[source_projection] / 2))
        light = to_latlong(picture, source_projection, rows)
    if projection == "latlong":
        if height is not None and height != light.layout[0]:
            if height < 2 or height % 2:
                raise InputError(
                    f"a lat-long map has an even number of rows, 2 or more, not {height}"
                )
            light = light.resize(height)
        write_environment_map(out, light, half=half, convention=convention)
        return light.layout
    if light.is_sky:
        light = light.with_ground(torch.zeros(3))
    if height is None:
        height = 6 * max(1, round(light.layout[0] * _ROWS[projection] / 6))
    pixels = from_latlong(light, projection, height)
    write_light(out, pixels, header={"comments": f"{projection}, skylight's frame"}, half=half)
    return pixels.shape[0], pixels.shape[1]
