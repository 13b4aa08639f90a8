"""The illumination that people are rendered under, and the options of rendering.

A scene's light is one of three:

* a sky of skylight's simulator over one of nine grounds;
* a clear sky of another model than the simulator, which light models are fitted to: Hosek & Wilkie
  2012, "An Analytic Model for Full Spectral Sky-Dome Radiance", and 2013, "Adding a Solar-Radiance
  Function to the Hosek-Wilkie Skylight Model", fitted to path-traced atmospheres of spherical
  shells, as Mitsuba's emitter ``sunsky`` has them;
* a map of a folder of environment maps, rotated about the vertical.

All light comes from far away: a map of all but the sun, and the sun as a disc of its true size.
"""

import math
from dataclasses import asdict, dataclass, replace
from functools import cached_property, lru_cache
from typing import Literal

import numpy as np
import torch
from jaxtyping import Float
from numpy import ndarray
from torch import Tensor

from skylight.models._ground import GROUND_ALBEDOS, LambertianGround
from skylight.people._independent_render import emitted, mitsuba_variant
from skylight.people._maps import ROWS, MapFolder, TurnedMap
from skylight.skies._simulated import evaluation_skies
from skylight.skies._sun import SUN_RADIUS_RAD
from skylight.sphere._envmap import EnvironmentMap, luminance
from skylight.sphere._frame import DirectionGrid, angle_between, direction_from_angles

_SUN_M = 1000.0  # how far off the sun stands: to a head, its parallax is below 0.01 degrees


@dataclass(frozen=True, kw_only=True)
class SunDisc:
    """The sun in the unit ``direction``, of one radiance over its disc of 0.2667 degrees radius.

    ``irradiance`` is what a plane that faces it receives. The true disc is darker towards its limb
    (1 - 0.6 (1 - cos psi), Cox 2000): its penumbra is as wide, and differs by less than 3 % of the
    sun's irradiance anywhere.
    """

    direction: Float[Tensor, "3"]
    irradiance: Float[Tensor, "3"]

    @property
    def radiance(self) -> Float[Tensor, "3"]:
        """E / (pi sin^2 a) over the disc of radius a."""
        return self.irradiance / (math.pi * math.sin(SUN_RADIUS_RAD) ** 2)

    def emitter(
        self, mi, towards: Float[ndarray, "3"], direction: Float[ndarray, "3"]
    ) -> dict[str, object]:
        """Mitsuba's description: a far disc in ``direction`` that faces the point ``towards``."""
        place = towards + _SUN_M * direction
        up = np.eye(3)[np.abs(direction).argmin()]
        turned = mi.ScalarTransform4f().look_at(
            origin=place.tolist(), target=towards.tolist(), up=up.tolist()
        )
        radiance = {"type": "rgb", "value": self.radiance.tolist()}
        return {
            "type": "disk",
            "to_world": turned.scale(_SUN_M * math.tan(SUN_RADIUS_RAD)),
            "emitter": {"type": "area", "radiance": radiance},
        }

    def in_pixels(self, rays: Float[Tensor, "*s 3"], pixel_rad: float) -> Float[Tensor, "*s 3"]:
        """Its radiance in pixels of that angular size, those on its limb covered in part."""
        inside = SUN_RADIUS_RAD - angle_between(rays, self.direction.to(rays).expand_as(rays))
        share = (inside / pixel_rad + 0.5).clamp(0, 1)
        return share[..., None] * self.radiance.to(rays)


@dataclass(frozen=True)
class DistantLight:
    """``diffuse`` is a full map of what comes from everywhere; ``sun`` None where none is visible.

    Under a map of which the sun is not known apart it is in ``diffuse``, as wide as its pixels.
    """

    diffuse: EnvironmentMap
    sun: SunDisc | None = None

    @cached_property
    def environment(self) -> EnvironmentMap:
        """The map of all light, of :meth:`~skylight.sphere._envmap.EnvironmentMap.with_light`."""
        if self.sun is None:
            return self.diffuse
        return self.diffuse.with_light(self.sun.direction, self.sun.irradiance)


def camera_frame(
    direction: Float[Tensor, "3"], world_from_camera: Float[ndarray, "3 3"] | None
) -> Float[ndarray, "3"]:
    """A direction in the world as a turned camera has it."""
    own = direction.double().numpy()
    return own if world_from_camera is None else world_from_camera.T @ own


TURBIDITIES = 2.0, 8.0  # clear mountain air to haze
SUN_ELEVATIONS_DEG = 5.0, 75.0
_FINER = 4  # directions across a pixel, over which the sky is averaged
_APERTURE_DEG = 0.5358  # the sun's diameter by the model


def hosek_wilkie_sky(
    turbidity: float, ground_albedo: Float[Tensor, "3"], sun: Float[Tensor, "3"], height: int
) -> tuple[EnvironmentMap, SunDisc]:
    """The sky without its sun, (``height``, 4 ``height``), and the sun, both in Mitsuba's units.

    Each pixel is the mean of the radiance over its solid angle, by the midpoint rule. The sun
    gives what the model's disc gives, at the diameter that it has here.
    """
    grid = DirectionGrid.sky(_FINER * height)
    up_is_z = np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]])  # Mitsuba's zenith is +Z
    towards = up_is_z @ sun.double().numpy()
    fine = emitted(
        _emitter(turbidity, ground_albedo, towards, sky=True),
        grid.directions.numpy() @ up_is_z.T,
    )
    radiance = torch.from_numpy(fine).float().reshape(_FINER * height, -1, 3)
    disc = emitted(_emitter(turbidity, ground_albedo, towards, sky=False), towards[None])[0]
    irradiance = math.pi * math.sin(math.radians(_APERTURE_DEG / 2)) ** 2 * disc
    return (
        EnvironmentMap(radiance=radiance).resize(height),
        SunDisc(direction=sun, irradiance=torch.from_numpy(irradiance)),
    )


def _emitter(turbidity: float, ground_albedo: Float[Tensor, "3"], sun, *, sky: bool):
    """The sky alone or the sun alone, which in RGB is even across its disc."""
    return mitsuba_variant().load_dict(
        {
            "type": "sunsky",
            "turbidity": turbidity,
            "albedo": {"type": "rgb", "value": ground_albedo.tolist()},
            "sun_direction": sun.tolist(),
            "sun_aperture": _APERTURE_DEG,
            "sky_scale": float(sky),
            "sun_scale": float(not sky),
        }
    )


# Whose skies: those of the simulator that light models are fitted to, or another model's.
Skies = Literal["simulated", "hosek-wilkie"]
# Behind people: what photographs have there, or the light itself, sharp and infinitely far away.
Backgrounds = Literal["mixed", "infinite"]


@dataclass(frozen=True, kw_only=True)
class RenderOptions:
    """``size`` px square, ``samples`` light paths per pixel and layer.

    Face i belongs to scene i // ``per_scene``: one sky, ground, camera and exposure. ``hair`` puts
    a cap on every head. Simulated days are of all kinds, as the thesis scores them (5.5.1);
    ``sunny`` keeps those whose sun is visible. With ``maps``, scene i is lit by map i modulo their
    count, turned about the vertical by a random angle, in place of a sky. With ``light_seed`` the
    light is that of this other seed, while people, poses and cameras stay those of ``seed``.
    ``backgrounds`` says what is behind people (:mod:`skylight.people._background`).
    """

    size: int = 288
    samples: int = 64
    seed: int = 0
    per_scene: int = 1
    hair: bool = False
    sunny: bool = False
    skies: Skies = "simulated"
    maps: MapFolder | None = None
    light_seed: int | None = None
    backgrounds: Backgrounds = "mixed"

    def settings(self) -> dict[str, object]:
        """What faces depend on, for files: maps by their content, wherever they lie."""
        settings = asdict(replace(self, maps=None))
        del settings["maps"]
        if self.light_seed is None:  # as faces had it that were rendered before it existed
            del settings["light_seed"]
        if self.backgrounds == "infinite":  # as all had it before there were others
            del settings["backgrounds"]
        if self.maps is not None:
            settings["maps"] = {"count": len(self.maps.files), "sha256": self.maps.sha256}
        return settings


LOWEST_TRANSMITTANCE = 0.5  # the sun is visible
# Of the sky's light: a fainter sun is in the map alone, since half of all light samples would go to
# it where it is an emitter.
FAINT_SUN = 1e-3
FOCAL_LENGTHS = 1.4, 2.8  # over the picture's side
# Test skies of these faces start here (beyond those that nothing may be trained on), so that
# they are none of the other evaluations' days either.
FIRST_SKY = 100_000_000
_SEEDS_APART = 100_000_000  # from one --seed to the next
_SCENES_APART = 1000  # so that each scene finds a day of its own


@dataclass(frozen=True, kw_only=True)
class SceneLight:
    """What the faces of one scene share. ``light`` (64 x 128) is in units of its own.

    The camera looks level along -Z, so its frame is the world's. ``sun`` points to the sun, whose
    light gets through clouds by ``transmittance``, also where none does. What tells of a sky and
    its ground is None where a given map is the light, and ``turned_map`` where a sky is;
    ``sky_seed`` is that of a simulated sky, ``turbidity`` that of one of Hosek & Wilkie.
    """

    light: DistantLight
    focal: float  # over the picture's side
    ground_albedo: Float[Tensor, "3"] | None = None
    sun: Float[Tensor, "3"] | None = None
    transmittance: float | None = None
    sky_seed: int | None = None
    turbidity: float | None = None
    turned_map: TurnedMap | None = None


@lru_cache(maxsize=4)  # finding a day may take seconds
def scene_light(scene: int, options: RenderOptions) -> SceneLight:
    """Light, its azimuth and the focal length follow from the options and ``scene``."""
    light = _light_of_seed(scene, options)
    if options.light_seed is None:
        return light
    other = _light_of_seed(scene, replace(options, seed=options.light_seed))
    return replace(other, focal=light.focal)


def _light_of_seed(scene: int, options: RenderOptions) -> SceneLight:
    if options.maps is not None:
        return _map_light(scene, options)
    if options.skies == "hosek-wilkie":
        return _hosek_wilkie_light(scene, options)
    return _simulated_light(scene, options)


def _map_light(scene: int, options: RenderOptions) -> SceneLight:
    assert options.maps is not None
    rng = np.random.default_rng((options.seed, scene, 0))
    environment, which, beside = options.maps.turned(scene, rng.uniform(-math.pi, math.pi))
    light = DistantLight(environment)
    if beside is not None:
        light = replace(light, sun=SunDisc(direction=beside.direction, irradiance=beside.energy))
        light = _without_faint_sun(light)
    return SceneLight(light=light, focal=float(rng.uniform(*FOCAL_LENGTHS)), turned_map=which)


def _without_faint_sun(light: DistantLight) -> DistantLight:
    """The same with the sun in the map where it is too faint to be an emitter."""
    assert light.sun is not None
    if luminance(light.sun.irradiance) < FAINT_SUN * luminance(light.diffuse.integrate()):
        return DistantLight(light.environment)
    return light


def _simulated_light(scene: int, options: RenderOptions) -> SceneLight:
    ((record, simulated),) = evaluation_skies(
        1,
        first_seed=FIRST_SKY + _SEEDS_APART * options.seed + _SCENES_APART * scene,
        lowest_transmittance=LOWEST_TRANSMITTANCE if options.sunny else 0.0,
    )
    assert record.seed is not None  # simulated skies have one
    rng = np.random.default_rng((options.seed, scene, 0))
    turn, albedo, focal = _drawn(rng)
    direction = _direction(math.radians(record.map_azimuth_deg) + turn, record.sun_zenith_deg)
    sun = SunDisc(direction=direction, irradiance=simulated.sun_irradiance)
    light = over_ground(simulated.sunless.rotate_azimuth(turn), sun, albedo)
    if luminance(sun.irradiance) < FAINT_SUN * luminance(simulated.sunless.integrate()):
        light = DistantLight(light.environment)
    return SceneLight(
        light=light,
        ground_albedo=albedo,
        sun=direction,
        transmittance=record.sun_transmittance,
        sky_seed=record.seed,
        focal=focal,
    )


def _hosek_wilkie_light(scene: int, options: RenderOptions) -> SceneLight:
    rng = np.random.default_rng((options.seed, scene, 0))
    turn, albedo, focal = _drawn(rng)
    turbidity = float(rng.uniform(*TURBIDITIES))
    direction = _direction(turn, 90.0 - rng.uniform(*SUN_ELEVATIONS_DEG))
    sky, sun = hosek_wilkie_sky(turbidity, albedo, direction, ROWS // 2)
    return SceneLight(
        light=over_ground(sky, sun, albedo),
        ground_albedo=albedo,
        sun=direction,
        transmittance=1.0,  # a sky without clouds
        turbidity=turbidity,
        focal=focal,
    )


def over_ground(
    sky: EnvironmentMap, sun: SunDisc | None, albedo: Float[Tensor, "3"]
) -> DistantLight:
    """A sky and its sun over an infinite Lambertian plane, which both of them light."""
    full = DistantLight(sky.with_ground(torch.zeros(3)), sun).environment.upper()
    bounce = LambertianGround(full.layout[0])(full.flat[None], albedo[None].to(full.flat))[0]
    return DistantLight(sky.with_ground(bounce), sun)


def _drawn(rng: np.random.Generator) -> tuple[float, Float[Tensor, "3"], float]:
    """A turn about the vertical, the ground's albedo, the focal length."""
    turn = rng.uniform(-math.pi, math.pi)
    albedo = torch.tensor(GROUND_ALBEDOS[rng.integers(len(GROUND_ALBEDOS))])
    return turn, albedo, float(rng.uniform(*FOCAL_LENGTHS))


def _direction(azimuth_rad: float, zenith_deg: float) -> Float[Tensor, "3"]:
    angles = azimuth_rad, math.radians(zenith_deg)
    return direction_from_angles(*(torch.tensor(a, dtype=torch.float64) for a in angles))
