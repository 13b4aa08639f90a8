"""three.js itself reads our LightProbe and our map."""

import json
import math
from pathlib import Path

import pytest
import torch

from skylight.relight._harmonics import LIGHT_PROBE, REFLECTED, second_degree, write_threejs
from skylight.sphere._envmap import EnvironmentMap
from skylight.sphere._frame import DirectionGrid
from tests.axis_colours import AXES, axis_map
from tests.oracles.harmonics import irradiance
from tests.three_js import browser_page, run_in_node

GOLDEN = Path(__file__).resolve().parents[1] / "golden" / "threejs_light_probe.json"
NORMALS = [list(axis) for axis, _ in AXES.values()] + [[0.6, 0.48, 0.64], [-0.36, 0.8, -0.48]]
IRRADIANCES = """
import {ObjectLoader, Vector3} from 'three';
import {readFileSync} from 'node:fs';
const {probe, normals} = JSON.parse(readFileSync(0, 'utf8'));
const light = new ObjectLoader().parse(probe);
if (!light.isLightProbe || light.intensity !== 1) throw new Error('no LightProbe');
const values = normals.map((n) =>
  light.sh.getIrradianceAt(new Vector3(...n), new Vector3()).toArray());
console.log(JSON.stringify({values, again: light.toJSON().object.sh}));
"""
PAGE = """<!doctype html><script type="importmap">{"imports": {
"three": "/node_modules/three/build/three.module.js",
"three/addons/": "/node_modules/three/examples/jsm/"}}</script>
<script type="module">
import * as T from 'three';
import {HDRLoader} from 'three/addons/loaders/HDRLoader.js';
const renderer = new T.WebGLRenderer();
const target = new T.WebGLRenderTarget(9, 9, {type: T.FloatType});
const camera = new T.PerspectiveCamera(2, 1, 0.1, 100);
function look(scene, from, at) {
  camera.position.set(...from);
  const steep = Math.abs(at[1] - from[1]) > 0.9;
  camera.up.set(0, steep ? 0 : 1, steep ? 1 : 0);
  camera.lookAt(...at);
  renderer.setRenderTarget(target);
  renderer.render(scene, camera);
  const pixels = new Float32Array(9 * 9 * 4);
  renderer.readRenderTargetPixels(target, 0, 0, 9, 9, pixels);
  return Array.from(pixels.slice(4 * 40, 4 * 40 + 3));
}
window.show = async (axes) => {
  const texture = await new HDRLoader().loadAsync('/files/threejs_light.hdr');
  texture.mapping = T.EquirectangularReflectionMapping;
  const sky = new T.Scene();
  sky.background = texture;
  const mirrored = new T.Scene();
  mirrored.environment = texture;
  const mirror = new T.MeshStandardMaterial({metalness: 1, roughness: 0});
  mirrored.add(new T.Mesh(new T.SphereGeometry(1, 128, 64), mirror));
  const diffuse = new T.Scene();
  const probe = await (await fetch('/files/lightprobe.json')).json();
  diffuse.add(new T.ObjectLoader().parse(probe));
  diffuse.add(new T.Mesh(new T.SphereGeometry(1, 128, 64), new T.MeshLambertMaterial()));
  return axes.map((a) => ({
    background: look(sky, [0, 0, 0], a),
    mirror: look(mirrored, a.map((x) => 5 * x), [0, 0, 0]),
    diffuse: look(diffuse, a.map((x) => 5 * x), [0, 0, 0]),
  }));
};
window.ready = true;
</script>"""


def test_its_numbers_are_as_the_library_evaluated_them() -> None:
    """The golden file holds a probe and what three.js found; the next test makes it anew."""
    golden = json.loads(GOLDEN.read_text(encoding="utf-8"))
    coefficients = torch.tensor(golden["probe"]["object"]["sh"]).double().reshape(9, 3)
    found = irradiance(coefficients, torch.tensor(golden["normals"]).double())
    torch.testing.assert_close(found, torch.tensor(golden["values"]).double(), atol=1e-4, rtol=1e-4)


def test_the_library_reads_our_probe(tmp_path: Path) -> None:
    generator = torch.Generator().manual_seed(5)
    light = EnvironmentMap(radiance=torch.rand(16, 32, 3, generator=generator) * 4)
    assert write_threejs(tmp_path, light) == [LIGHT_PROBE, REFLECTED]
    probe = json.loads((tmp_path / LIGHT_PROBE).read_text(encoding="utf-8"))
    found = run_in_node(IRRADIANCES, {"probe": probe, "normals": NORMALS})
    assert found["again"] == probe["object"]["sh"]
    expected = irradiance(second_degree(light), torch.tensor(NORMALS).double())
    values = torch.tensor(found["values"]).double()
    # its constants have six digits
    torch.testing.assert_close(values, expected, atol=1e-4, rtol=1e-4)
    golden = json.loads(GOLDEN.read_text(encoding="utf-8"))
    torch.testing.assert_close(
        torch.tensor(golden["values"]).double(), values, atol=1e-5, rtol=1e-5
    )


def test_nine_harmonics_are_near_the_cosine_integral() -> None:
    """Ramamoorthi & Hanrahan 2001: 9 coefficients leave a few per cent of irradiance."""
    light = axis_map()
    normals = DirectionGrid.hammersley(60).directions
    exact = torch.stack([light.irradiance(normal) for normal in normals]).double()
    found = irradiance(second_degree(light), normals)
    assert float((found - exact).abs().max()) < 0.03 * float(exact.mean())


def test_what_the_library_renders_has_the_axes_colours(tmp_path: Path) -> None:
    light = axis_map()
    write_threejs(tmp_path, light)
    (tmp_path / "page.html").write_text(PAGE, encoding="utf-8")
    with browser_page(tmp_path) as page:
        page.wait_for_function("window.ready === true", timeout=30000)
        shown = page.evaluate("(axes) => window.show(axes)", [axis for axis, _ in AXES.values()])
    for (axis, colour), seen in zip(AXES.values(), shown, strict=True):
        # the pole's row is blended with what lies beyond it
        assert seen["background"] == pytest.approx(colour, abs=0.06)
        assert seen["mirror"] == pytest.approx(colour, abs=0.06)
        received = light.irradiance(torch.tensor(axis)) / math.pi
        assert seen["diffuse"] == pytest.approx(received.tolist(), abs=0.01)
