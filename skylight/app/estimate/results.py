"""The files of an estimate: maps, meshes, numbers and the report."""

import re
from pathlib import Path

from skylight.app.estimate.group_report import write_group_report
from skylight.app.estimate.report import write_report
from skylight.app.estimate.summary import describe
from skylight.app.estimate.types import PhotoEstimate
from skylight.app.estimate.uncertainty import posterior_map
from skylight.faces.fit import FaceFit
from skylight.faces.model import HeadModel
from skylight.io.atomic import atomic_path
from skylight.io.files import write_environment_map, write_probe
from skylight.io.json_files import write_json

MESHES = re.compile(r"mesh(_[1-9][0-9]*)?\.obj")  # the files of :func:`mesh_names`


def write_results(folder: Path, result: PhotoEstimate, *, keep_place: bool = False) -> None:
    """probe.exr, probe.hdr, posterior.exr, mesh.obj, estimate.json and report.png of one estimate.

    Several faces have a mesh each, mesh_1.obj and so on, in the order of estimate.json. Time,
    place and heading are private, and stand in estimate.json only with ``keep_place``.
    """
    write_probe(folder, result.estimate.environment)
    write_environment_map(folder / "posterior.exr", posterior_map(result.estimate.posterior))
    write_json(folder / "estimate.json", describe(result, keep_place=keep_place))
    for name, seen in zip(mesh_names(result), result.seen, strict=True):
        write_mesh(folder / name, seen.fit)
    first, *more = result.names
    title = Path(first).name + (f" and {len(more)} more" if more else "")
    if len(result.seen) == 1:
        write_report(folder / "report.png", result, title=title)
    else:
        write_group_report(folder / "report.png", result, title=title)


def mesh_names(result: PhotoEstimate) -> list[str]:
    """The file of each face's head."""
    count = len(result.seen)
    return ["mesh.obj"] if count == 1 else [f"mesh_{n}.obj" for n in range(1, count + 1)]


def write_mesh(path: Path, fit: FaceFit) -> None:
    """The fitted head, metres, in the camera's frame."""
    header = "# skylight: head in metres; the camera is at the origin, looks along -Z, +Y is up\n"
    vertices, faces = fit.vertices, HeadModel.load().faces + 1
    text = (
        header
        + "v %.8f %.8f %.8f\n" * len(vertices) % tuple(vertices.ravel().tolist())
        + "f %d %d %d\n" * len(faces) % tuple(faces.ravel().tolist())
    )
    with atomic_path(path) as temporary:
        temporary.write_text(text, encoding="utf-8")
