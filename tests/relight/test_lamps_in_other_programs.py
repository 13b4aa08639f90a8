"""An estimate's lamps as lights of other programs: each read as that program reads it."""

import ast
import json
import math
import re
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable
from pathlib import Path

import pytest
import torch
from jaxtyping import Float
from torch import Tensor

from skylight.imaging._colour import srgb_to_linear
from skylight.io._files import read_environment_map
from skylight.relight._blender import SCRIPT, TEXTURE as BLENDER_TEXTURE, write_blender
from skylight.relight._gltf import LIGHT, write_gltf
from skylight.relight._harmonics import LIGHT_PROBE, REFLECTED, write_threejs
from skylight.relight._lamps import disc_diameter_rad, without_lamps
from skylight.relight._scenes import (
    LAYER,
    MITSUBA_TEXTURE,
    SCENE,
    USD_TEXTURE,
    write_mitsuba,
    write_usd,
)
from skylight.sphere._envmap import EnvironmentMap
from tests.lamp_lit import lamp_lit, lamp_params
from tests.oracles.harmonics import from_convention, irradiance
from tests.relight.programs import mitsuba, seen_by_blender
from tests.relight.test_light_files import read_glb
from tests.relight.test_threejs_light import PAGE
from tests.three_js import browser_page, run_in_node

# direction towards the lamp, irradiance of a surface that faces it, angular diameter or None
Parsed = tuple[Float[Tensor, "3"], Float[Tensor, "3"], float | None]
LIT, LAMPS = lamp_lit(lamp_params())
REST = without_lamps(LIT, LAMPS)


def turned(quaternion: list[float]) -> Float[Tensor, "3"]:
    """Where (x, y, z, w) takes +Z: the third column of its matrix."""
    x, y, z, w = quaternion
    column = [2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)]
    return torch.tensor(column, dtype=torch.float64)


def shaded(coefficients: Float[Tensor, "9 3"]) -> Callable[[Tensor], Tensor]:
    return lambda normal: irradiance(coefficients, normal[None])[0]


def threejs(folder: Path) -> tuple[list[Parsed], Callable[[Tensor], Tensor]]:
    write_threejs(folder, REST, LAMPS)
    root = json.loads((folder / LIGHT_PROBE).read_text(encoding="utf-8"))["object"]
    assert root["type"] == "Group"
    probe, *lights = root["children"]
    assert probe["type"] == "LightProbe"
    found = []
    for light in lights:
        assert light["type"] == "DirectionalLight"
        place = torch.tensor(light["matrix"][12:15]).double()
        codes = torch.tensor([light["color"] >> shift & 255 for shift in (16, 8, 0)])
        irradiance_rgb = light["intensity"] * srgb_to_linear(codes / 255)
        found.append((place / place.norm(), irradiance_rgb.double(), None))
    names = [each["uuid"] for each in (root, probe, *lights)]
    assert len(set(names)) == len(names)
    rest = read_environment_map(folder / REFLECTED, convention="threejs")
    torch.testing.assert_close(rest.radiance, REST.radiance, rtol=0.03, atol=0)  # in RGBE
    return found, shaded(torch.tensor(probe["sh"]).reshape(9, 3))


def gltf(folder: Path) -> tuple[list[Parsed], Callable[[Tensor], Tensor]]:
    assert write_gltf(folder, REST, 32, LAMPS) == ([LIGHT], 0)
    tree, _ = read_glb(folder / LIGHT)
    assert set(tree["extensionsUsed"]) == {"EXT_lights_image_based", "KHR_lights_punctual"}
    lights = tree["extensions"]["KHR_lights_punctual"]["lights"]
    found = []
    for place in tree["scenes"][tree["scene"]]["nodes"]:
        node = tree["nodes"][place]
        light = lights[node["extensions"]["KHR_lights_punctual"]["light"]]
        assert light["type"] == "directional"
        assert 0 <= min(light["color"]) <= max(light["color"]) == 1
        strength = torch.tensor(light["color"]).double() * light["intensity"]
        found.append((turned(node["rotation"]), strength, None))
    (probe,) = tree["extensions"]["EXT_lights_image_based"]["lights"]
    return found, shaded(from_convention(torch.tensor(probe["irradianceCoefficients"]), "gltf"))


def usd(folder: Path) -> tuple[list[Parsed], Callable[[Tensor], Tensor]]:
    write_usd(folder, REST, LAMPS)
    text = (folder / LAYER).read_text(encoding="utf-8")
    assert text.count("{") == text.count("}")
    assert 'defaultPrim = "Light"' in text
    assert re.search(r'^def Xform "Light"\n{\n    def DomeLight "Rest"\n', text, re.MULTILINE)
    found = []
    for prim in re.findall(r'    def DistantLight "Lamp\d"\n    {\n(.*?)\n    }', text, re.DOTALL):
        values = dict(re.findall(r"^ +\S+ (\S+) = (.+)$", prim, re.MULTILINE))
        assert values["inputs:normalize"] == "1"
        assert '["xformOp:orient"]' in prim
        w, x, y, z = ast.literal_eval(values["xformOp:orient"])
        colour = torch.tensor(ast.literal_eval(values["inputs:color"])).double()
        strength = colour * float(values["inputs:intensity"])
        angle = math.radians(float(values["inputs:angle"]))
        found.append((turned([x, y, z, w]), strength, angle))
    rest = read_environment_map(folder / USD_TEXTURE, convention="openexr")
    return found, rest.irradiance


def in_mitsuba(folder: Path) -> tuple[list[Parsed], Callable[[Tensor], Tensor]]:
    write_mitsuba(folder, REST, LAMPS)
    found = []
    for emitter in ElementTree.parse(folder / SCENE).getroot().findall("emitter")[1:]:
        assert emitter.get("type") == "directional"
        vector, rgb = emitter.find("vector"), emitter.find("rgb")
        assert vector is not None
        assert rgb is not None
        assert (vector.get("name"), rgb.get("name")) == ("direction", "irradiance")
        along = torch.tensor([float(vector.attrib[axis]) for axis in "xyz"]).double()
        strength = torch.tensor([float(c) for c in rgb.attrib["value"].split(",")]).double()
        found.append((-along, strength, None))
    rest = read_environment_map(folder / MITSUBA_TEXTURE, convention="mitsuba")
    return found, rest.irradiance


def blender(folder: Path) -> tuple[list[Parsed], Callable[[Tensor], Tensor]]:
    write_blender(folder, REST, LAMPS)
    found = []
    for node in ast.parse((folder / SCRIPT).read_text(encoding="utf-8")).body:
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "LAMPS":
            for _, (x, y, z), colour, energy, angle in ast.literal_eval(node.value):
                towards = torch.tensor([x, z, -y]).double()  # Blender's +Z is up
                found.append((towards, energy * torch.tensor(colour).double(), angle))
    rest = read_environment_map(folder / BLENDER_TEXTURE, convention="blender")
    return found, rest.irradiance


@pytest.mark.parametrize("written", [threejs, gltf, usd, in_mitsuba, blender])
def test_a_surface_facing_a_lamp_receives_what_the_full_map_gives_it(
    tmp_path: Path, written: Callable[[Path], tuple[list[Parsed], Callable[[Tensor], Tensor]]]
) -> None:
    found, rest = written(tmp_path)
    assert len(found) == len(LAMPS) == 2
    for (direction, strength, angle), lamp in zip(found, LAMPS, strict=True):
        torch.testing.assert_close(direction, lamp.direction, atol=1e-6, rtol=0)
        torch.testing.assert_close(strength, lamp.irradiance.double(), rtol=0.01, atol=0)
        if angle is not None:
            assert angle == pytest.approx(disc_diameter_rad(lamp.spread_rad), rel=1e-6)
    for normal in (lamp.direction for lamp in LAMPS):
        received = rest(normal).double()
        for direction, strength, _ in found:
            received = received + strength * float((normal @ direction).clamp(min=0))
        exact = LIT.irradiance(normal).double()
        torch.testing.assert_close(received, exact, rtol=0.015, atol=0)


def test_without_lamps_the_files_have_none(tmp_path: Path) -> None:
    dim = EnvironmentMap(radiance=torch.ones(16, 32, 3))
    write_threejs(tmp_path, dim)
    root = json.loads((tmp_path / LIGHT_PROBE).read_text(encoding="utf-8"))["object"]
    assert root["type"] == "LightProbe"
    write_gltf(tmp_path, dim, 32)
    assert "nodes" not in read_glb(tmp_path / LIGHT)[0]
    write_usd(tmp_path, dim)
    text = (tmp_path / LAYER).read_text(encoding="utf-8")
    assert '\ndef DomeLight "Light"\n{' in text
    assert "DistantLight" not in text
    write_mitsuba(tmp_path, dim)
    assert len(ElementTree.parse(tmp_path / SCENE).getroot().findall("emitter")) == 1
    write_blender(tmp_path, dim)
    assert "LAMPS" not in (tmp_path / SCRIPT).read_text(encoding="utf-8")


IN_THREE = """
import {ObjectLoader, Vector3} from 'three';
import {readFileSync} from 'node:fs';
const root = new ObjectLoader().parse(JSON.parse(readFileSync(0, 'utf8')));
root.updateMatrixWorld(true);
const lights = [];
root.traverse((o) => {
  if (!o.isDirectionalLight) return;
  const towards = new Vector3().setFromMatrixPosition(o.matrixWorld);
  towards.sub(new Vector3().setFromMatrixPosition(o.target.matrixWorld)).normalize();
  const c = o.color.clone().multiplyScalar(o.intensity);
  lights.push([towards.toArray(), [c.r, c.g, c.b]]);
});
console.log(JSON.stringify({lights, probes: root.children.filter((o) => o.isLightProbe).length}));
"""


def test_three_js_itself_reads_the_lamps(tmp_path: Path) -> None:
    write_threejs(tmp_path, REST, LAMPS)
    content = json.loads((tmp_path / LIGHT_PROBE).read_text(encoding="utf-8"))
    found = run_in_node(IN_THREE, content)
    assert found["probes"] == 1
    for (towards, strength), lamp in zip(found["lights"], LAMPS, strict=True):
        assert towards == pytest.approx(lamp.direction.tolist(), abs=1e-6)
        assert strength == pytest.approx(lamp.irradiance.tolist(), rel=0.01)


def test_three_js_itself_lights_a_ball_with_lamps_and_probe(tmp_path: Path) -> None:
    write_threejs(tmp_path, REST, LAMPS)
    (tmp_path / "page.html").write_text(PAGE, encoding="utf-8")
    normals = [lamp.direction for lamp in LAMPS]
    with browser_page(tmp_path) as page:
        page.wait_for_function("window.ready === true", timeout=30000)
        shown = page.evaluate("(axes) => window.show(axes)", [n.tolist() for n in normals])
    for normal, seen in zip(normals, shown, strict=True):
        assert seen["diffuse"] == pytest.approx(
            (LIT.irradiance(normal) / math.pi).tolist(), rel=0.02
        )


def test_usd_itself_reads_the_lamps(tmp_path: Path) -> None:
    pytest.importorskip("pxr", reason="usd-core is not installed")
    from pxr import Gf, Usd, UsdGeom, UsdLux  # pyright: ignore

    write_usd(tmp_path, REST, LAMPS)
    stage = Usd.Stage.Open(str(tmp_path / LAYER))
    root = stage.GetDefaultPrim()
    dome, *lights = root.GetChildren()
    assert UsdLux.DomeLight(dome).GetTextureFileAttr().Get().resolvedPath
    assert len(lights) == len(LAMPS)
    for prim, lamp in zip(lights, LAMPS, strict=True):
        light = UsdLux.DistantLight(prim)
        assert light
        placed = UsdGeom.Xformable(prim).ComputeLocalToWorldTransform(Usd.TimeCode.Default())
        along = placed.TransformDir(Gf.Vec3d(0, 0, -1))
        assert list(along) == pytest.approx((-lamp.direction).tolist(), abs=1e-6)
        angle = math.radians(light.GetAngleAttr().Get())
        assert angle == pytest.approx(disc_diameter_rad(lamp.spread_rad), rel=1e-5)
        assert light.GetNormalizeAttr().Get() is True
        received = [light.GetIntensityAttr().Get() * c for c in light.GetColorAttr().Get()]
        assert received == pytest.approx(lamp.irradiance.tolist(), rel=1e-5)


def test_mitsuba_itself_shines_from_the_lamps(tmp_path: Path) -> None:
    mi = mitsuba()
    write_mitsuba(tmp_path, REST, LAMPS)
    scene = mi.load_file(str(tmp_path / SCENE))
    found = {emitter.id(): emitter for emitter in scene.emitters()}
    for number, lamp in enumerate(LAMPS, start=1):
        sample, strength = found[f"lamp_{number}"].sample_direction(
            mi.SurfaceInteraction3f(), mi.Point2f(0.5, 0.5)
        )
        towards = [float(part) for part in sample.d]
        assert towards == pytest.approx(lamp.direction.tolist(), abs=1e-5)
        assert [float(c) for c in strength] == pytest.approx(lamp.irradiance.tolist(), rel=1e-5)


WHITE_PLANE = """
scene.cycles.samples = 1024
bpy.ops.mesh.primitive_plane_add(size=1)
plane = bpy.context.object
white = bpy.data.materials.new("white")
if white.node_tree is None:
    white.use_nodes = True
nodes = white.node_tree.nodes
nodes.clear()
diffuse, output = nodes.new("ShaderNodeBsdfDiffuse"), nodes.new("ShaderNodeOutputMaterial")
diffuse.inputs["Color"].default_value = 1, 1, 1, 1
white.node_tree.links.new(diffuse.outputs["BSDF"], output.inputs["Surface"])
plane.data.materials.append(white)
seen = []
for x, y, z in asked:
    towards = mathutils.Vector((x, -z, y))
    plane.rotation_euler = camera.rotation_euler = towards.to_track_quat("Z", "Y").to_euler()
    camera.location = 3 * towards
    seen.append((math.pi * picture("seen")[..., :3].mean((0, 1))).tolist())
"""


def test_blender_itself_lights_a_plane_with_suns_and_world(tmp_path: Path) -> None:
    write_blender(tmp_path, REST, LAMPS)
    normals = [lamp.direction for lamp in LAMPS]
    shown = seen_by_blender(tmp_path, WHITE_PLANE, [normal.tolist() for normal in normals])
    for normal, seen in zip(normals, shown, strict=True):
        assert seen == pytest.approx(LIT.irradiance(normal).tolist(), rel=0.015)
