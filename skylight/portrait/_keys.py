"""One key light over a dim fill, as photographers light a portrait.

Angles are those of whoever looks at the picture: an azimuth of 0 is at the camera, positive ones
are to the viewer's right, 180 is behind the sitter. The fill is even, and the key a lamp, both of
the mean colour of all light found::

    L(w) = f (R(w) + s B(R) c g(w; d, a)).

g is a lobe of irradiance 1 on what faces it, c a colour of luminance 1, R the mean of the light
found, and s how many times as bright as the fill the key makes what faces it. B is the mean
irradiance of what the camera sees of a ball in the sitter's place (:func:`ball_weights`). f leaves
that ball as bright as the light found has it, as an exposure meter would, but that a key behind the
sitter counts for more (:data:`~skylight.portrait._edge.METERED`), so that its edge is bright and
the face in shade. Such a key is no part of the map, but an edge (:mod:`skylight.portrait._edge`),
:data:`RIM` times as bright, and its fill is the light found, which models a face that the key does
not.
"""

import math
from types import MappingProxyType

import torch
from jaxtyping import Float
from torch import Tensor

from skylight._names import KeyName
from skylight.errors import InputError
from skylight.estimation._kept import FoundLight
from skylight.inverse._lamp_relighting import lamps_radiance
from skylight.inverse._result import Lamp
from skylight.portrait._edge import METERED, EdgeLight, edge_share, lamp_colour
from skylight.portrait._lights import NewLight
from skylight.portrait._relit import light_in_photo
from skylight.sphere._envmap import EnvironmentMap, luminance
from skylight.sphere._frame import direction_from_angles

# (azimuth, elevation) in degrees, 0 at the camera and positive to the viewer's right. Left and
# right light the far cheek's triangle (Rembrandt), top the nose's shadow below it (butterfly).
KEYS = MappingProxyType[KeyName, tuple[float, float]](
    {
        "left": (-50.0, 30.0),
        "right": (50.0, 30.0),
        "top": (0.0, 42.0),
        "rim": (140.0, 25.0),
        "front": (0.0, 15.0),
    }
)
# Angular diameters in degrees: a softbox or window nearby, a beauty dish, a bare bulb
SOFT_DEG, USUAL_DEG, HARD_DEG = 40.0, 25.0, 5.0
NARROWEST_DEG, WIDEST_DEG = 2.0, 120.0  # a lobe narrower than a map's pixels is none; a wall
KEY_OVER_FILL = 4.0  # s: two stops, as for a portrait with clear light and shade
RIM = 2.0  # times as bright as that a lamp behind is, as a narrow band is seen less than a face


def ball_weights(directions: Float[Tensor, "*n 3"]) -> Float[Tensor, " *n"]:
    """Mean irradiance of what the camera sees of a ball, of unit light from each direction.

    ``2 / (3 pi) (sin a + (pi - a) cos a)``, a being the angle to the camera (at +Z): Lambert's law
    of phases (Photometria, 1760), 2/3 of a ball lit from the camera.
    """
    cosine = directions[..., 2].double().clamp(-1, 1)
    angle = cosine.acos()
    return 2 / (3 * math.pi) * (angle.sin() + (math.pi - angle) * cosine)


def direction_seen(azimuth_deg: float, elevation_deg: float) -> Float[Tensor, "3"]:
    """Unit vector in the camera's frame: +X is the picture's right, +Z towards the camera."""
    angles = 180.0 - azimuth_deg, 90.0 - elevation_deg  # azimuths count from -Z towards +X
    return direction_from_angles(
        *(torch.tensor(math.radians(angle), dtype=torch.float64) for angle in angles)
    )


def brightness_of_ball(light: EnvironmentMap) -> float:
    """B of the module's text, in luminance."""
    weights = ball_weights(light.grid.directions) * light.grid.solid_angles
    return float(weights @ luminance(light.flat).double())


def fill_of(found: EnvironmentMap) -> EnvironmentMap:
    """R of the module's text, of the light found in the photograph's colours and units."""
    even = (found.integrate() / (4 * math.pi)).to(found.radiance)
    return EnvironmentMap(radiance=even.expand(found.radiance.shape).clone())


def key_light(
    found: FoundLight,
    key: KeyName | tuple[float, float],
    *,
    size_deg: float = USUAL_DEG,
    strength: float = KEY_OVER_FILL,
) -> NewLight:
    """A key light over a dim, even fill: the module's text.

    Parameters
    ----------
    key
        One of :data:`KEYS`, or (azimuth, elevation) in degrees: 0 at the camera, positive to the
        viewer's right, and above the camera.
    size_deg
        Angular diameter: :data:`SOFT_DEG`, :data:`HARD_DEG`, or between.
    strength
        How many times as bright as the fill it makes what faces it.

    Raises
    ------
    InputError
        A place, a size or a strength that cannot be.
    """
    azimuth_deg, elevation_deg = KEYS[key] if isinstance(key, str) else key
    check_key(azimuth_deg, elevation_deg, size_deg, strength)
    whole = light_in_photo(found)
    fill = fill_of(whole)
    level, towards = brightness_of_ball(fill), direction_seen(azimuth_deg, elevation_deg)
    behind = edge_share(float(towards[2]))
    metered = float(ball_weights(towards)) + METERED * behind
    dimmed = brightness_of_ball(whole) / (level * (1 + strength * metered))
    colour = whole.integrate().double()
    lamp = Lamp(
        direction=towards,
        irradiance=(1 - behind) * dimmed * strength * level * colour / luminance(colour),
        # a disc's diameter is four spreads of a lobe: skylight.relight._lamps.disc_diameter_rad
        spread_rad=math.radians(size_deg) / 4,
    )
    lobe = lamps_radiance([lamp], fill.layout[0]).reshape(fill.radiance.shape)
    x, y, z = towards.tolist()
    red, green, blue = colour.tolist()
    edge = EdgeLight(
        direction=(x, y, z),
        strength=RIM * behind * strength / (1 + strength * metered),
        spread_rad=lamp.spread_rad,
        colour=lamp_colour((red, green, blue)),
    )
    own = level / brightness_of_ball(whole)
    rest = (1 - behind) * fill.radiance + behind * own * whole.radiance
    return NewLight(
        environment=EnvironmentMap(radiance=dimmed * rest + lobe.to(rest)),
        edge=edge if edge.strength > 0 else None,
    )


def check_key(azimuth_deg: float, elevation_deg: float, size_deg: float, strength: float) -> None:
    """:class:`InputError` for a key light that cannot be."""
    if not -360 <= azimuth_deg <= 360:
        raise InputError(
            f"a key light's azimuth lies between -180 and 180 degrees, got {azimuth_deg:g}: 0 is "
            "at the camera, 90 to the viewer's right"
        )
    if not -90 <= elevation_deg <= 90:
        raise InputError(
            f"a key light's elevation lies between -90 and 90 degrees, got {elevation_deg:g}"
        )
    if not NARROWEST_DEG <= size_deg <= WIDEST_DEG:
        raise InputError(
            f"a key light is {NARROWEST_DEG:g} to {WIDEST_DEG:g} degrees wide, got {size_deg:g}"
        )
    if not 0 <= strength <= 1000:
        raise InputError(
            f"a key light's strength lies between 0 and 1000 times the fill, got {strength:g}"
        )
