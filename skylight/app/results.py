"""A folder of results: all files of a run or, where it fails, those of the run before."""

import os
import re
import shutil
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

from skylight.app.doubt import posterior_map
from skylight.app.group_report import write_group_report
from skylight.app.report import write_report
from skylight.app.summary import describe
from skylight.errors import OutputError
from skylight.faces.fit import FaceFit
from skylight.faces.model import HeadModel
from skylight.imaging.atomic import PARTIAL, atomic_path
from skylight.imaging.files import write_environment_map, write_json
from skylight.imaging.photo import Photo
from skylight.inverse.photo import PhotoEstimate

MESHES = re.compile(r"mesh(_[1-9][0-9]*)?\.obj")  # the files of :func:`mesh_names`


@contextmanager
def results_folder(out: Path, replaced: re.Pattern[str] | None = None) -> Iterator[Path]:
    """A temporary folder in ``out``; its files move to ``out`` when the block ends well.

    Made before the work starts, so that a folder that cannot be written to is found at once.
    Whatever ends the block early, files of an earlier run stay as they were; when it ends well,
    those whose whole name matches ``replaced`` go, whether or not there are new ones.
    """
    is_new = not out.exists()
    try:
        out.mkdir(parents=True, exist_ok=True)
        # within, not beside: ``out`` may be writable, or another disk, where its parent is not
        partial = Path(tempfile.mkdtemp(prefix=PARTIAL, dir=out))
    except OSError as error:
        raise OutputError(
            f"cannot write into {out}: {error.strerror}; choose another folder with --out"
        ) from error
    try:
        yield partial
        made = sorted(partial.iterdir())
        for file in made:
            if (out / file.name).is_dir():
                raise OutputError(f"cannot write {out / file.name}: a folder has that name")
        for file in made:
            os.replace(file, out / file.name)
        names = {file.name for file in made}
        if replaced is not None:
            for file in sorted(out.iterdir()):
                if file.is_file() and replaced.fullmatch(file.name) and file.name not in names:
                    file.unlink()
    finally:
        shutil.rmtree(partial, ignore_errors=True)
        if is_new:
            with suppress(OSError):  # not empty: the run went well
                out.rmdir()


def write_results(
    folder: Path, photos: Sequence[Photo], sources: Sequence[str], result: PhotoEstimate
) -> None:
    """probe.exr, probe.hdr, posterior.exr, mesh.obj, estimate.json and report.png of one estimate.

    Several faces have a mesh each, mesh_1.obj and so on, in the order of estimate.json.
    """
    write_environment_map(folder / "probe.exr", result.estimate.environment)
    write_environment_map(folder / "probe.hdr", result.estimate.environment)
    write_environment_map(folder / "posterior.exr", posterior_map(result.estimate.posterior))
    write_json(folder / "estimate.json", describe(result, sources))
    for name, seen in zip(mesh_names(result), result.seen, strict=True):
        write_mesh(folder / name, seen.fit)
    first, *more = sources
    title = Path(first).name + (f" and {len(more)} more" if more else "")
    if len(result.seen) == 1:
        photo = photos[result.seen[0].photo]
        write_report(folder / "report.png", photo, result, title=title)
    else:
        write_group_report(folder / "report.png", photos, result, title=title)


def mesh_names(result: PhotoEstimate) -> list[str]:
    """The file of each face's head."""
    count = len(result.seen)
    return ["mesh.obj"] if count == 1 else [f"mesh_{n}.obj" for n in range(1, count + 1)]


def write_mesh(path: Path, fit: FaceFit) -> None:
    """The fitted head, metres, in the camera's frame."""
    from trimesh import Trimesh
    from trimesh.exchange.obj import export_obj

    mesh = Trimesh(fit.vertices, HeadModel.load().faces, process=False)
    header = "skylight: head in metres; the camera is at the origin, looks along -Z, +Y is up"
    with atomic_path(path) as temporary:
        temporary.write_text(export_obj(mesh, header=header) + "\n", encoding="utf-8")
