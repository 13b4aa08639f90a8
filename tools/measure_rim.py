"""What a lamp behind a head sends to the camera near its outline: path-traced skin and hair.

    python -m tools.measure_rim

Constants of :mod:`skylight.portrait._edge` are read off its two tables. Both are radiances over
that of a white Lambertian surface which faces the lamp, of places whose outline is turned towards
the lamp's side, by how far inside the outline they lie (in heights of the face).

**Skin** is that of rendered people (:mod:`skylight.people`), bald, with the light that scatters
below it: ``body`` is what leaves its inside over what the same does in even light, ``gloss`` what
its surface reflects, in white's units.

**Hair** is strands, which those people do not have: a scalp with thirty thousand fibres combed
from the crown, in bundles, with strays, of Chiang et al. 2016 ("A practical and controllable hair
and fur model", Mitsuba's ``hair``), in three concentrations of eumelanin. ``body`` is what brown
and blond hair send over what they do in even light, ``gloss`` what black hair sends, which hardly
lets light through. The spread of their logarithms has the noise of few samples in it.

Of each the radius and the factors of an edge that fit best are told, and how far off that is (root
mean square, over that of the column), and then the factors for the edge's own radius.
"""

import argparse
import itertools
import math
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float
from numpy import ndarray

from skylight.faces._model import HeadModel
from skylight.faces._observe import skin_seen
from skylight.people._independent_render import mitsuba_variant
from skylight.people._light import DistantLight, RenderOptions
from skylight.people._people import person, seen_parts
from skylight.people._render import compose
from skylight.people._subsurface import REACH_MM, patches_in_reach
from skylight.people._trace import fine_map, trace
from skylight.portrait._edge import SOON_LIT, WIDTH, EdgeLight
from skylight.portrait._gain import LUMINANCE_WEIGHTS
from skylight.portrait._keys import KEYS, USUAL_DEG, direction_seen
from skylight.sphere._envmap import EnvironmentMap

STEPS = np.array([0.0, 0.01, 0.02, 0.03, 0.04, 0.06, 0.08, 0.1, 0.13, 0.16, 0.2])
FACE_M = 0.19  # chin to the hairline, as portraits count a face's height
TURNED = 0.8  # cosine in the picture between the outline's normal and the lamp
# Of the strands
SCALP_M, LAYER_M, LENGTH_M, STRAND_M = 0.085, 0.010, 0.12, 60e-6  # the last a radius
BUNDLES, OF_BUNDLE, STRAYS = 500, 60, 300
BLACK, BROWN, BLOND = 8.0, 1.3, 0.3  # eumelanin, by d'Eon et al. 2011
SIDE_M, SIDE_PX = 0.26, 160
DEPTH = 24  # path vertices
_ROWS = 64


@dataclass(frozen=True, kw_only=True)
class Lit:
    """Pictures in even light of radiance 1 and under a lamp of irradiance pi."""

    even: Float[ndarray, "h w 3"]
    lamp: Float[ndarray, "h w 3"]
    cover: Float[ndarray, "h w"]
    face_px: float


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--people", type=int, default=6)
    parser.add_argument("--samples", type=int, default=64)
    parser.add_argument("--only", choices=["skin", "hair"])
    arguments = parser.parse_args()
    if arguments.only != "hair":
        of_skin(arguments.people, arguments.samples)
    if arguments.only != "skin":
        of_hair(arguments.samples)


def lamp() -> EnvironmentMap:
    """The rim key alone, of irradiance pi on what faces it."""
    grid = EnvironmentMap(radiance=torch.zeros(_ROWS, 2 * _ROWS, 3)).grid
    near = grid.directions.double() @ direction_seen(*KEYS["rim"])
    inside = (near > math.cos(math.radians(USUAL_DEG / 2))).float()
    level = math.pi / float((inside * near * grid.solid_angles).sum())
    return EnvironmentMap(radiance=(level * inside)[:, None].expand(-1, 3).reshape(_ROWS, -1, 3))


def places(cover: Float[ndarray, "h w"], face_px: float) -> tuple[ndarray, Bool[ndarray, "h w"]]:
    """How far inside the outline, in faces, and where that is turned to the lamp's side."""
    wide = 40
    padded = np.pad(cover.astype(np.float32), wide, mode="edge")
    depth = cv2.distanceTransform((padded > 0.5).astype(np.uint8), cv2.DIST_L2, 5)
    down, right = np.gradient(
        cv2.GaussianBlur(depth - 30 * (padded <= 0.5), (0, 0), 0.03 * face_px)
    )
    x, y, _ = direction_seen(*KEYS["rim"]).tolist()
    turned = (-right * x + down * y) / (np.hypot(down, right) * math.hypot(x, y) + 1e-9) > TURNED
    inner = np.s_[wide:-wide, wide:-wide]
    return depth[inner] / face_px, turned[inner] & (cover > 0.99)


def of_skin(count: int, samples: int) -> None:
    rows: list[ndarray] = []
    options = RenderOptions(seed=940, size=256, hair=False)
    even = EnvironmentMap(radiance=torch.ones(_ROWS, 2 * _ROWS, 3))
    for number in range(count):
        who = person(number, 3.0, options)
        seen, camera = seen_parts(who), who.truth.camera
        patches = patches_in_reach(who, seen, REACH_MM / 1000)
        black = np.zeros((camera.height, camera.width, 3), np.float32)
        down = skin_seen(HeadModel.load(), who.truth)[:, 1]
        face_px = float(np.ptp(down))
        is_low = np.indices(seen.skin.shape)[0] > down.mean()
        of_even, of_lamp = (
            trace(who, DistantLight(light), patches, samples=samples, seed=number)
            for light in (even, lamp())
        )
        whole, lit = (compose(each, seen, patches, camera, black) for each in (of_even, of_lamp))
        depth, turned = places(of_even.cover, face_px)
        usual = whole - of_even.specular
        body = (lit - of_lamp.specular) @ LUMINANCE_WEIGHTS / (usual @ LUMINANCE_WEIGHTS + 1e-6)
        gloss = of_lamp.specular @ LUMINANCE_WEIGHTS
        chosen = turned & seen.skin
        rows.append(np.stack([x[chosen] for x in (depth, body, gloss, is_low)]))
        print(f"person {number}: face {face_px:.0f} px, {chosen.sum()} places", flush=True)
    depth, body, gloss, is_low = np.concatenate(rows, 1)
    for part, of_part in (("all", is_low >= 0), ("jaw and neck", is_low > 0)):
        print(f"skin, {part}: depth, places, body, gloss")
        table: list[tuple[float, int, float, float]] = []
        for low, high in itertools.pairwise(STEPS):
            here = of_part & (depth > low) & (depth <= high)
            if here.any():
                row = (low + high) / 2, int(here.sum()), body[here].mean(), gloss[here].mean()
                table.append(row)
                print("{:.3f} {:5d} {:.3f} {:.4f}".format(*row))
        at, many, bodies, glosses = np.array(table).T
        print(fitted(at, many, np.stack([bodies, glosses], 1), 0.0))


def fitted(
    depth: Float[ndarray, " n"],
    many: Float[ndarray, " n"],
    columns: Float[ndarray, "n c"],
    soon: float,
) -> str:
    """Of an edge of hair, which is ``soon`` lit, or of a surface (0): its radius, and the factors
    of each column, by least squares over the steps, each weighing as much as it has places."""
    x, y, z = direction_seen(*KEYS["rim"]).tolist()
    light = EdgeLight(direction=(x, y, z), strength=1.0, spread_rad=math.radians(USUAL_DEG) / 4)
    # outlines within TURNED of the lamp's side are turned from it by a mean cosine of this
    towards = (1 + TURNED) / 2 / math.hypot(x, y)

    def edge(width: float) -> tuple[float, float, ndarray]:
        lean = np.maximum(1 - depth / width, 0)[None, :, None] * towards * np.array([x, y])
        received = light.on(lean)[0]
        shape = received / (received + soon) if soon else received
        factors = (many * shape) @ columns / ((many * shape) @ shape + 1e-12)
        missed = (columns - shape[:, None] * factors) ** 2
        return float(np.sqrt(many @ missed / (many @ columns**2)).mean()), width, factors

    best = min((edge(width) for width in np.arange(0.1, 0.7, 0.01)), key=lambda one: one[0])
    return "\n".join(
        f"width {width:.2f}: factors {np.round(factors, 3)}, off by {off:.2f}"
        for off, width, factors in (best, edge(WIDTH))
    )


def strands(rng: np.random.Generator) -> Float[ndarray, "n k 3"]:
    """Control points, in a frame whose +Z is to the camera and +Y up."""
    count, knots = BUNDLES * OF_BUNDLE, 12
    of = np.repeat(np.arange(BUNDLES), OF_BUNDLE)
    # bundles evenly over the scalp above 105 degrees from the crown, strands about them
    polar = np.arccos(rng.uniform(math.cos(math.radians(105)), 1, BUNDLES))[of]
    turn = rng.uniform(0, 2 * math.pi, BUNDLES)[of]
    polar = np.abs(polar + 0.05 * rng.normal(size=count))
    turn = turn + 0.05 * rng.normal(size=count) / np.sin(polar).clip(0.1)
    along = np.linspace(0, 1, knots)
    height = LAYER_M * rng.beta(2, 1.5, BUNDLES)[of] + 0.0012 * rng.normal(size=count)
    stray = rng.choice(count, STRAYS, replace=False)
    height[stray] += rng.exponential(0.008, STRAYS)
    bend = 0.10 * rng.normal(size=BUNDLES)[of] + 0.03 * rng.normal(size=count)
    wave = rng.uniform(0, 2 * math.pi, BUNDLES)[of]
    angle = polar[:, None] + along * LENGTH_M / SCALP_M
    sway = bend[:, None] * along + 0.03 * np.sin(wave[:, None] + 9 * along)
    azimuth = turn[:, None] + sway / np.sin(angle).clip(0.3)
    radius = SCALP_M + np.maximum(height, 0.0005)[:, None] * np.minimum(5 * along, 1)
    # what has come down to the scalp's widest place falls straight
    fall = np.maximum(angle - math.pi / 2, 0)
    angle = np.minimum(angle, math.pi / 2)
    across = radius * np.sin(angle)
    return np.stack(
        [
            across * np.sin(azimuth),
            radius * np.cos(angle) - fall * SCALP_M,
            across * np.cos(azimuth),
        ],
        2,
    )


def of_hair(samples: int) -> None:
    points = strands(np.random.default_rng(3))
    table, many = list[ndarray](), list[ndarray]()
    for name, eumelanin in (("black", BLACK), ("brown", BROWN), ("blond", BLOND)):
        lit = hair(points, eumelanin, samples)
        depth, turned = places(lit.cover, lit.face_px)
        tall = np.indices(depth.shape)[0] < 0.55 * len(depth)
        even, lamp_ = lit.even @ LUMINANCE_WEIGHTS, lit.lamp @ LUMINANCE_WEIGHTS
        print(f"{name}: depth, places, even, lamp (r, g, b), contrast even, lamp")
        rows: list[ndarray] = []
        for low, high in itertools.pairwise(STEPS):
            here = turned & tall & (depth > low) & (depth <= high)
            shown = lit.even[here].mean(0), lit.lamp[here].mean(0)
            rows.append(np.concatenate([[here.sum()], *shown]))
            spread = [float(np.log(x[here] + 1e-4).std()) for x in (even, lamp_)]
            print(f"{(low + high) / 2:.3f}", np.round(rows[-1], 4), np.round(spread, 2), flush=True)
        table.append(np.array(rows))
        many.append(np.array([x[0] for x in rows]))
    whole = np.array(table)[..., 1:]  # hair, step, even and lamp
    before, after = whole[..., :3] @ LUMINANCE_WEIGHTS, whole[..., 3:] @ LUMINANCE_WEIGHTS
    print("hair: depth, body of brown and of blond hair, gloss")
    columns = np.stack([after[1] / before[1], after[2] / before[2], after[0]], 1)
    middles = (STEPS[:-1] + STEPS[1:]) / 2
    for step, row in zip(middles, columns, strict=True):
        print("{:.3f} {:.3f} {:.3f} {:.4f}".format(step, *row))
    print(fitted(middles, np.mean(many, 0), columns, SOON_LIT))


def hair(points: Float[ndarray, "n k 3"], eumelanin: float, samples: int) -> Lit:
    """The strands on a scalp, in both lights."""
    mi = mitsuba_variant()
    with TemporaryDirectory() as folder:
        file = Path(folder) / "strands.txt"  # x y z radius, an empty line between strands
        file.write_text(
            "\n\n".join(
                "\n".join(f"{x:.6f} {y:.6f} {z:.6f} {STRAND_M:.6f}" for x, y, z in strand)
                for strand in points
            )
        )
        own = {"type": "hair", "eumelanin": eumelanin, "pheomelanin": 0.0}
        curves = mi.load_dict({"type": "bsplinecurve", "filename": str(file), "hair": own})
    middle = [0.0, 0.2 * SCALP_M, 0.0]
    camera = {
        "type": "orthographic",
        "to_world": mi.ScalarTransform4f()
        .look_at(origin=[*middle[:2], 1.0], target=middle, up=[0, 1, 0])
        .scale([SIDE_M / 2, SIDE_M / 2, 1]),
        "film": {
            "type": "hdrfilm",
            "width": SIDE_PX,
            "height": SIDE_PX,
            "pixel_format": "rgba",
            "rfilter": {"type": "box"},
        },
        "sampler": {"type": "independent", "sample_count": samples},
    }
    sensor = mi.load_dict(camera)
    path = mi.load_dict({"type": "path", "max_depth": DEPTH, "hide_emitters": True})
    scalp = {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.2}}
    even: dict[str, object] = {"type": "constant", "radiance": {"type": "rgb", "value": 1.0}}
    behind: dict[str, object] = {"type": "envmap", "bitmap": mi.Bitmap(fine_map(lamp()))}
    pictures: list[Float[ndarray, "h w 4"]] = []
    for light in (even, behind):
        scene = mi.load_dict(
            {
                "type": "scene",
                "light": light,
                "strands": curves,
                "scalp": {"type": "sphere", "radius": SCALP_M, "bsdf": scalp},
            }
        )
        picture = mi.render(scene, sensor=sensor, integrator=path, seed=mi.UInt32(1))
        pictures.append(np.array(picture, dtype=np.float32))
    return Lit(
        even=pictures[0][..., :3],
        lamp=pictures[1][..., :3],
        cover=pictures[0][..., 3],
        face_px=FACE_M / SIDE_M * SIDE_PX,
    )


if __name__ == "__main__":
    main()
