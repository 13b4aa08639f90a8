"""Cube maps as six files: written, found by their names, and loaded by three.js itself."""

from pathlib import Path

import pytest
import torch

from skylight.cli import main
from skylight.errors import InputError
from skylight.io._files import read_light, write_environment_map, write_light
from skylight.maps._cube_files import NAMINGS, read_faces, write_faces
from skylight.sphere._envmap import EnvironmentMap
from skylight.sphere._frame import DirectionGrid
from skylight.sphere._projections import FACES
from tests.three_js import browser_page

PAGE = """<!doctype html><script type="importmap">{"imports": {
"three": "/node_modules/three/build/three.module.js",
"three/addons/": "/node_modules/three/examples/jsm/"}}</script>
<script type="module">
import * as T from 'three';
import {HDRCubeTextureLoader} from 'three/addons/loaders/HDRCubeTextureLoader.js';
const renderer = new T.WebGLRenderer();
const target = new T.WebGLRenderTarget(9, 9, {type: T.FloatType});
const camera = new T.PerspectiveCamera(2, 1, 0.1, 100);
window.show = async (directions) => {
  const scene = new T.Scene();
  scene.background = await new HDRCubeTextureLoader().setPath('/files/')
    .loadAsync(['px', 'nx', 'py', 'ny', 'pz', 'nz'].map((name) => `${name}.hdr`));
  return directions.map((d) => {
    camera.lookAt(...d);
    renderer.setRenderTarget(target);
    renderer.render(scene, camera);
    const pixels = new Float32Array(9 * 9 * 4);
    renderer.readRenderTargetPixels(target, 0, 0, 9, 9, pixels);
    return Array.from(pixels.slice(4 * 40, 4 * 40 + 3));
  });
};
window.ready = true;
</script>"""


def six(size: int = 4) -> torch.Tensor:
    return torch.rand(6, size, size, 3, generator=torch.Generator().manual_seed(2)) + 0.5


@pytest.mark.parametrize("naming", NAMINGS)
@pytest.mark.parametrize("before", ["", "Sky_", "room 2-"])
def test_all_usual_names_are_read(tmp_path: Path, naming: tuple[str, ...], before: str) -> None:
    faces = six()
    for face, name in zip(faces, naming, strict=True):
        write_light(tmp_path / f"{before}{name.upper()}.exr", face, header={})
    write_light(tmp_path / "thumbnail.exr", faces[0], header={})
    assert torch.equal(read_faces(tmp_path), faces)
    assert torch.equal(read_faces(tmp_path / f"{before}{{}}.exr"), faces)


def test_a_pattern_chooses_among_several(tmp_path: Path) -> None:
    faces = six()
    write_faces(tmp_path, faces, header={})
    write_faces(tmp_path / "dusk_{}.exr", 2 * faces, header={})
    with pytest.raises(InputError, match="several sets of six faces"):
        read_faces(tmp_path)
    assert torch.equal(read_faces(tmp_path / "dusk_{}.exr"), 2 * faces)


@pytest.mark.parametrize("kind", ["missing", "folder", "sizes"])
def test_what_is_no_cube_is_told(tmp_path: Path, kind: str) -> None:
    write_faces(tmp_path, six(), header={})
    if kind == "missing":
        (tmp_path / "ny.hdr").unlink()
        with pytest.raises(InputError, match="no six files named as the faces of a cube"):
            read_faces(tmp_path)
    elif kind == "folder":
        with pytest.raises(InputError, match="read from a folder that holds them"):
            read_faces(tmp_path / "px.hdr")
    else:
        write_light(tmp_path / "ny.hdr", torch.ones(3, 4, 3), header={})
        with pytest.raises(InputError, match="ny has 4x3 pixels beside 4 rows of px"):
            read_faces(tmp_path)


def test_a_file_is_no_place_for_six(
    probe: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    command = ["convert", str(probe), str(tmp_path / "sky.exr"), "--to", "cube-faces"]
    assert main(command) == 2
    assert "sky_{}.exr" in capsys.readouterr().err
    command[2] = str(tmp_path / "sky_{}.png")
    assert main(command) == 2
    assert "no HDR format" in capsys.readouterr().err
    assert not list(tmp_path.glob("sky*"))


def test_a_folder_of_files_is_written_and_read(probe: Path, tmp_path: Path) -> None:
    folder, cross, back = tmp_path / "faces", tmp_path / "cross.exr", tmp_path / "back.exr"
    for name, kind in ((folder / "{}.exr", "cube-faces"), (cross, "cube")):
        assert main(["convert", str(probe), str(name), "--to", kind]) == 0
    assert sorted(path.stem for path in folder.iterdir()) == sorted(FACES)
    found = []
    for name, kind in ((folder, "cube-faces"), (cross, "cube")):
        assert main(["convert", str(name), str(back), "--from", kind]) == 0
        found.append(read_light(back))
    assert torch.equal(*found)


def test_threejs_shows_every_direction_where_it_is(tmp_path: Path) -> None:
    directions = DirectionGrid.latlong(128).directions
    coded = EnvironmentMap(radiance=(directions + 2).reshape(128, 256, 3).float() / 4)
    write_environment_map(tmp_path / "coded.exr", coded)
    assert main(["convert", str(tmp_path / "coded.exr"), str(tmp_path), "--to", "cube-faces"]) == 0
    (tmp_path / "page.html").write_text(PAGE, encoding="utf-8")
    looked = DirectionGrid.hammersley(40).directions
    with browser_page(tmp_path) as page:
        page.wait_for_function("window.ready === true", timeout=30000)
        shown = torch.tensor(page.evaluate("(d) => window.show(d)", looked.tolist()))
    # RGBE has 1/256 of the largest channel, a pixel of the faces a degree
    torch.testing.assert_close(shown.double(), (looked + 2) / 4, atol=8e-3, rtol=0)
