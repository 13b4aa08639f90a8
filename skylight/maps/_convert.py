"""Environment maps converted between projections, layouts and conventions; turned and scaled."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import get_args

import torch
from jaxtyping import Float
from torch import Tensor

from skylight._names import (
    PLAIN_READING,
    Convention,
    CubeLayout,
    MapLayout,
    MapReading,
    Projection,
)
from skylight.errors import InputError
from skylight.imaging._preview import preview
from skylight.io._atomic import require_place
from skylight.io._exr import white_luminance
from skylight.io._files import (
    read_environment_map,
    read_light,
    write_environment_map,
    write_light,
    write_png,
)
from skylight.maps._cube_files import face_files, read_faces, write_faces, written_faces
from skylight.sphere._cube_layouts import (
    cross_of_faces,
    faces_of_cross,
    horizontal_cross,
    laid_out,
)
from skylight.sphere._envmap import EnvironmentMap
from skylight.sphere._frame import convert_latlong, rotation_about
from skylight.sphere._projections import from_latlong, to_latlong

# rows of each picture over those of a lat-long map with as much detail at the horizon
_ROWS: dict[Projection, float] = {
    "latlong": 1.0,
    "cube": 1.5,
    "octahedral": 1.0,
    "angular": 2.0,
    "mirrorball": 2.0,
}
# rows of a layout of a cube's faces, in faces; a cross has three
_FACES_HIGH: dict[CubeLayout, int] = {
    "cube-vertical": 4,
    "cube-row": 1,
    "cube-column": 6,
    "cube-faces": 1,
}


@dataclass(frozen=True, kw_only=True)
class Adjustment:
    """How light is turned, and by which ``factor`` its radiance is multiplied.

    A camera that looked at the middle of the map sees the light move: by ``rotate_deg`` to its
    right (the azimuth grows), by ``pitch_deg`` upwards, and by ``roll_deg`` clockwise. Rolled
    first, rotated about the vertical last::

        L'(w) = factor L(R^T w),  R = R_y(-rotate) R_x(pitch) R_z(-roll)
    """

    rotate_deg: float = 0.0
    pitch_deg: float = 0.0
    roll_deg: float = 0.0
    factor: float = 1.0

    def __post_init__(self) -> None:
        angles = self.rotate_deg, self.pitch_deg, self.roll_deg
        if not all(math.isfinite(angle) and abs(angle) <= 360 for angle in angles):
            raise InputError("light is turned by -360 to 360 degrees")
        if not 0 < self.factor < math.inf:
            raise InputError(f"radiance is multiplied by a number above 0, not {self.factor:g}")

    def rotation(self) -> Float[Tensor, "3 3"]:
        """R, float64."""
        x, y, z = torch.eye(3, dtype=torch.float64)
        about_y = rotation_about(y, math.radians(-self.rotate_deg))
        about_x = rotation_about(x, math.radians(self.pitch_deg))
        return about_y @ about_x @ rotation_about(z, math.radians(-self.roll_deg))

    def __call__(self, light: EnvironmentMap) -> EnvironmentMap:
        """The map turned and scaled.

        About the vertical energy is exact, and so is a turn by whole columns; other turns
        resample (:meth:`~skylight.sphere._envmap.EnvironmentMap.rotate`). A sky that is pitched or
        rolled gets a black lower half.
        """
        if self.pitch_deg or self.roll_deg:
            whole = light.with_ground(torch.zeros(3)) if light.is_sky else light
            light = whole.rotate(self.rotation())
        elif self.rotate_deg:
            columns = self.rotate_deg * light.layout[1] / 360
            if columns == round(columns):
                light = EnvironmentMap(radiance=light.radiance.roll(round(columns), dims=1))
            else:
                light = light.rotate_azimuth(math.radians(self.rotate_deg))
        if self.factor != 1:
            light = EnvironmentMap(radiance=light.radiance * self.factor)
        return light


UNCHANGED = Adjustment()


def convert_file(
    source: Path,
    out: Path,
    *,
    projection: MapLayout,
    convention: Convention = "skylight",
    source_projection: MapLayout = "latlong",
    source_convention: Convention = "skylight",
    adjustment: Adjustment = UNCHANGED,
    height: int | None = None,
    half: bool = False,
    preview_file: Path | None = None,
    reading: MapReading = PLAIN_READING,
) -> tuple[int, int]:
    """Convert and return the (rows, columns) that were written, of a face where six files are.

    Between lat-long maps of one size nothing is resampled: columns are rolled, exactly. A smaller
    or larger lat-long map keeps its energy exactly; what other projections keep is said at
    :func:`skylight.sphere._projections.from_latlong`. What an .exr says of its unit in cd/m^2
    (``whiteLuminance``) stays true. Of the projection "cube-faces", ``source``
    and ``out`` are a folder or a pattern: see :mod:`skylight.maps._cube_files`. ``preview_file``
    is a .png of what was written, exposed by the light's mean.

    Raises
    ------
    InputError
        A file, shape or convention that cannot be used.
    """
    for kind, given in ((projection, convention), (source_projection, source_convention)):
        if kind != "latlong" and given != "skylight":
            raise InputError(
                f"the convention {given} is one of lat-long maps; leave it out for {kind}"
            )
    if projection == "cube-faces":
        written_faces(out)
    if preview_file is not None:
        if preview_file.suffix.lower() != ".png":
            raise InputError(f"{preview_file}: choose a name that ends in .png")
        require_place(preview_file)
    unit = white_luminance(face_files(source)[0] if source_projection == "cube-faces" else source)
    header: dict[str, object] = {} if unit is None else {"whiteLuminance": unit / adjustment.factor}
    light = adjustment(_read(source, source_projection, source_convention, reading))
    if projection == "latlong":
        if height is not None and height != light.layout[0]:
            if height < 2 or height % 2:
                raise InputError(
                    f"a lat-long map has an even number of rows, 2 or more, not {height}"
                )
            light = light.resize(height)
        write_environment_map(out, light, half=half, convention=convention, header=header)
        shown = convert_latlong(light.radiance, "skylight", convention)
        written = light.layout
    else:
        if light.is_sky:
            light = light.with_ground(torch.zeros(3))
        header["comments"] = f"{projection}, skylight's frame"
        shown, written = _write_picture(out, light, projection, header, height=height, half=half)
    if preview_file is not None:
        write_png(preview_file, preview(light.radiance, picture=shown))
    return written


def _read(
    source: Path, projection: MapLayout, convention: Convention, reading: MapReading
) -> EnvironmentMap:
    if projection == "latlong":
        return read_environment_map(source, convention=convention, **vars(reading))
    if projection == "cube-faces":
        picture = cross_of_faces(read_faces(source, reading))
    else:
        picture = read_light(source, **vars(reading))
    if projection == "cube":
        picture = horizontal_cross(picture)
    elif projection in ("cube-vertical", "cube-row", "cube-column"):
        picture = horizontal_cross(picture, projection)
    sampled = _sampled_as(projection)
    rows = 2 * max(1, round(picture.shape[0] / _ROWS[sampled] / 2))
    return to_latlong(picture, sampled, rows)


def _sampled_as(projection: MapLayout) -> Projection:
    """All layouts of a cube's faces are cut from the cross."""
    return projection if projection in get_args(Projection) else "cube"  # type: ignore[return-value]


def _write_picture(
    out: Path,
    light: EnvironmentMap,
    projection: MapLayout,
    header: dict[str, object],
    *,
    height: int | None,
    half: bool,
) -> tuple[Float[Tensor, "h w 3"], tuple[int, int]]:
    """Write, and return what is seen and the rows and columns of a file."""
    sampled = _sampled_as(projection)
    if height is None:
        rows = 6 * max(1, round(light.layout[0] * _ROWS[sampled] / 6))
    elif projection in _FACES_HIGH:
        high = _FACES_HIGH[projection]
        if height < 1 or height % high:
            raise InputError(f"a picture of kind {projection} cannot have {height} rows")
        rows = 3 * height // high
    else:
        rows = height
    picture = from_latlong(light, sampled, rows)
    if projection == "cube-faces":
        faces = faces_of_cross(picture)
        write_faces(out, faces, header=header, half=half)
        return laid_out(picture, projection), (faces.shape[1], faces.shape[2])
    if projection in ("cube-vertical", "cube-row", "cube-column"):
        picture = laid_out(picture, projection)
    write_light(out, picture, header=header, half=half)
    return picture, (picture.shape[0], picture.shape[1])
