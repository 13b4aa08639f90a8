"""What every evaluation of the table keeps to, and what each says of data that it cannot use."""

import json
import pickle
from dataclasses import fields
from importlib.resources import files
from pathlib import Path

import pytest
import torch
import trimesh

from skylight.errors import InputError
from skylight.evaluation._known_faces import EstimateOptions, FaceEvaluation
from skylight.evaluation._main import EVALUATIONS, evaluate
from skylight.evaluation._run import Evaluation
from skylight.evaluation._sky_models import SkyEvaluation
from skylight.io._files import write_environment_map, write_png
from skylight.models._bundle import load_bundle
from skylight.sphere._envmap import EnvironmentMap
from tests.evaluation.test_any_light import LAMP, rendered_folder

EVERY = list(EVALUATIONS.values())
PROBES = ["sparse-coding", "sparse-inverse", "transport-compression"]
PROBES += ["voxel-probe", "partition-probe"]


@pytest.fixture(scope="session")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder as ``skylight evaluate all`` takes it, with as little as there can be in each."""
    folder = tmp_path_factory.mktemp("data")
    light = EnvironmentMap(radiance=torch.tensor([1.0, 0.8, 0.6]).expand(16, 32, 3).clone())
    (folder / "hdr").mkdir()
    write_environment_map(folder / "hdr" / "room.exr", light)
    (folder / "hdr" / "index.csv").write_text("file,category\nroom.exr,indoor\n")
    (folder / "meshes").mkdir()
    trimesh.creation.icosphere(subdivisions=2).export(folder / "meshes" / "ball.ply")
    grey = torch.full((8, 8, 3), 128, dtype=torch.uint8).numpy()
    ahead = [0.0, 0.0, 1.0]
    for name, index in (("faces", {"a.png": {}}), ("lamps", {"a_1.png": ahead, "a_2.png": ahead})):
        (folder / name).mkdir()
        for photo in index:
            write_png(folder / name / photo, grey)
        file = "index.json" if name == "faces" else "lamps.json"
        (folder / name / file).write_text(json.dumps(index))
    faces = rendered_folder(folder / "indoor", [LAMP], light)
    (folder / "relit").mkdir()
    for side in ("from", "to"):
        (folder / "relit" / side).symlink_to(faces)
    for number in range(4):  # of a scene nothing but its number is looked at
        face = folder / "scenes" / f"face{number:04d}"
        face.mkdir(parents=True)
        (face / "face.json").write_text('{"scene": 0}')
        (face / "picture.png").touch()
    return folder


def of(kind: type[Evaluation], data: Path, *, quick: bool = True) -> Evaluation:
    return kind.over(None if kind.data_folder is None else data / kind.data_folder, quick=quick)


@pytest.mark.parametrize("kind", EVERY, ids=EVALUATIONS)
def test_the_data_of_its_folder_are_what_it_needs(kind: type[Evaluation], data: Path) -> None:
    for quick in (True, False):
        evaluation = of(kind, data, quick=quick)
        items = evaluation.items()
        assert items
        assert len(set(items)) == len(items)
        assert evaluation.name
        # settings are kept beside results, and items are measured by other processes
        assert json.loads(json.dumps(evaluation.config()))
        assert pickle.loads(pickle.dumps(evaluation)) == evaluation
        assert of(kind, data, quick=quick) == evaluation


@pytest.mark.parametrize("kind", EVERY, ids=EVALUATIONS)
def test_a_quick_run_is_less_of_the_same(kind: type[Evaluation], data: Path) -> None:
    usual, quick = (of(kind, data, quick=quick) for quick in (False, True))
    settings = {field.name for field in fields(usual)}
    assert kind.quick
    assert set(kind.quick) <= settings
    assert {name: getattr(quick, name) for name in kind.quick} == dict(kind.quick)
    others = settings - set(kind.quick)
    assert all(getattr(usual, name) == getattr(quick, name) for name in others)


@pytest.mark.parametrize("kind", EVERY, ids=EVALUATIONS)
def test_a_trained_model_is_taken_or_refused_in_a_line(kind: type[Evaluation], data: Path) -> None:
    evaluation, own = (
        of(kind, data),
        Path(str(files("skylight.models") / "data" / "sky_autoencoder")),
    )
    if isinstance(evaluation, FaceEvaluation):
        given = evaluation.with_model(own, "cpu")
        assert given.options == EstimateOptions(model=own, device="cpu")
        with pytest.raises(InputError, match="device"):
            evaluation.with_model(None, "abacus")
    elif isinstance(evaluation, SkyEvaluation):
        given = evaluation.with_model(own, "auto")
        with pytest.raises(InputError, match="leave --device out"):
            evaluation.with_model(None, "cpu")
    else:
        with pytest.raises(InputError, match=f"{kind.title} .* leave --model and --device out"):
            evaluation.with_model(own, "auto")
        return
    assert given.config() == evaluation.config() | {"model": load_bundle(own).fingerprint}


@pytest.mark.parametrize("name", EVALUATIONS)
def test_data_that_it_cannot_use_are_refused_in_a_line(name: str, tmp_path: Path) -> None:
    data, out = tmp_path / "data", tmp_path / "out"
    if EVALUATIONS[name].needs:
        with pytest.raises(InputError, match=f"{name} needs --data DIR: "):
            evaluate(name, quick=True, data=None, out=out, workers=1)
    for _ in range(2):  # no folder, then an empty one
        with pytest.raises(InputError) as refused:
            evaluate(name, quick=True, data=data, out=out, workers=1)
        assert str(data) in str(refused.value)
        assert "\n" not in str(refused.value)
        data.mkdir(exist_ok=True)


@pytest.mark.parametrize("name", PROBES)
def test_probes_without_a_mesh_or_without_maps_are_refused_before_anything_is_measured(
    name: str, data: Path, tmp_path: Path
) -> None:
    (tmp_path / "meshes").mkdir()
    (tmp_path / "meshes" / "ball.ply").touch()
    with pytest.raises(InputError, match=r"index\.csv"):
        evaluate(name, quick=True, data=tmp_path, out=tmp_path / "out")
    if name != "sparse-coding":
        (tmp_path / "meshes" / "ball.ply").unlink()
        (tmp_path / "hdr").symlink_to(data / "hdr")
        with pytest.raises(InputError, match="no mesh"):
            evaluate(name, quick=True, data=tmp_path, out=tmp_path / "out")


@pytest.mark.slow
def test_a_folder_of_ones_own_is_measured(data: Path, tmp_path: Path) -> None:
    """One map in a folder of its own, one mesh of no usual name, and no sunny day."""
    (tmp_path / "hdr/rooms").mkdir(parents=True)
    (tmp_path / "hdr/rooms/mine.exr").symlink_to(data / "hdr/room.exr")
    (tmp_path / "hdr/index.csv").write_text("file,category\nrooms/mine.exr,indoor\n")
    (tmp_path / "meshes").symlink_to(data / "meshes")
    out = tmp_path / "out"
    evaluate("partition-probe", quick=True, data=tmp_path, out=out, workers=1)
    assert (out / "pictures" / "rooms_mine.exr.png").is_file()
