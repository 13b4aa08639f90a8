"""``skylight convert``: environment maps in the conventions of other programs."""

from pathlib import Path
from typing import Annotated, Literal

import tyro
from tyro.conf import Positional

# Parsing must not import torch, so the choices stand here again; a test compares the two.
Projection = Literal["latlong", "cube", "octahedral", "angular", "mirrorball"]
Convention = Literal["skylight", "openexr", "mitsuba", "threejs", "blender", "unity"]


def convert(
    source: Annotated[Positional[Path], tyro.conf.arg(name="in")],
    out: Positional[Path],
    to: Projection = "latlong",
    convention: Convention = "skylight",
    from_: Annotated[Projection, tyro.conf.arg(name="from")] = "latlong",
    from_convention: Convention = "skylight",
    height: int | None = None,
    half: bool = False,
) -> None:
    """Write a map of light in another projection, or the way another program turns it.

    Projections: latlong; cube (a horizontal cross of six faces); octahedral (the zenith in the
    centre); angular (Debevec's, forwards in the centre); mirrorball (what such a ball shows a
    camera far away). Conventions say where the columns of a lat-long map look.

    Args:
        source: The map to read: .exr or .hdr, linear Rec.709.
        out: The file to write: .exr or .hdr.
        to: Projection of the file to write.
        convention: Which program's way of turning lat-long maps to write.
        from_: Projection of the map to read.
        from_convention: Which program's way of turning lat-long maps it has.
        height: Rows to write; by default about as many as keep the detail.
        half: Write an .exr in half precision.
    """
    from skylight.app.maps.convert import convert_file

    rows, columns = convert_file(
        source,
        out,
        projection=to,
        convention=convention,
        source_projection=from_,
        source_convention=from_convention,
        height=height,
        half=half,
    )
    print(f"{out}: {to}, {columns} x {rows} pixels")
