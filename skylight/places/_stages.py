"""Studios, and streets at night."""

import math

import numpy as np

from skylight.places._materials import HOME_KELVIN, Draw, candelas, lumens, nits
from skylight.places._rooms import Room
from skylight.places._scene import (
    Lamp,
    Material,
    Outside,
    Real,
    Rectangle,
    Scene,
    Triple,
    black_body,
    box,
    panel,
)

STREET_KELVIN = ((2000.0, 0.35), (3000.0, 0.35), (4000.0, 0.3))
FLASH_KELVIN = ((5600.0, 1.0),)


def _towards(azimuth: Real, elevation: Real, distance: Real) -> np.ndarray:
    """A place seen so from the origin; azimuth 0 is behind the camera, where it stands (+Z)."""
    flat = distance * math.cos(elevation)
    return np.array(
        [flat * math.sin(azimuth), distance * math.sin(elevation), flat * math.cos(azimuth)]
    )


def studio(draw: Draw) -> Scene:
    """Key, fill and rim lights in a room of any size; a backdrop behind, all round, or none."""
    eye, height = draw.uniform(1.1, 1.6), draw.uniform(2.6, 5)
    back, front = draw.scale(0.9, 7), draw.scale(1.8, 9)
    left, right = draw.scale(1.4, 7), draw.scale(1.4, 7)
    room = Room((left + right, height, back + front), draw)
    cloth = (
        draw.paint(0.4, 0.15, vivid=0.05),
        Material(albedo=(0.8, 0.8, 0.79)),
        Material(albedo=np.full(3, draw.scale(0.02, 0.06))),
        draw.paint(0.35, 0.15, vivid=1.0),
    )[draw.one_of([0.4, 0.28, 0.22, 0.1])]
    level = draw.scale(0.04, 0.2) if draw.chance(0.4) else draw.uniform(0.35, 0.85)
    wall = Material(albedo=np.full(3, level) * [1.0, 0.98, 0.95])
    above = Material(albedo=np.full(3, min(0.8, level * draw.uniform(0.8, 2))))
    kind = draw.one_of([0.35, 0.3, 0.2, 0.15])
    if kind == 1:  # seamless walls and floor
        room.shell(cloth if draw.chance(0.3) else above, [cloth] * 4, cloth)
    else:
        behind = draw.facade() if kind == 3 else wall
        room.shell(above, [behind, wall, wall, wall], draw.floor())
        room.furnish(draw.count(0, 4) if kind == 3 else draw.count(0, 2), 2.0)
    parts = list(
        Scene(rectangles=room.parts, outside=Outside.uniform((0, 0, 0)), closed=True)
        .seen_from((left, eye, back))
        .rectangles
    )
    away = back - 0.05 if kind in (1, 3) else draw.uniform(0.8, max(0.9, back - 0.1))
    if kind in (0, 2):  # a roll of paper, or a cloth from wall to wall
        wide = left + right if kind == 2 else min(draw.uniform(1.4, 3.6), left + right)
        tall = height - 0.01 if kind == 2 else min(draw.uniform(2.0, 3.0), height - 0.05)
        x = (right - left) / 2 if kind == 2 else 0.0
        parts.append(panel((x, tall / 2 - eye, -away), (0, 0, 1), wide, tall, cloth))
        if draw.chance(0.6):  # drawn out over the floor
            long = draw.uniform(0.5, 2.5)
            middle = (x, 0.01 - eye, -away + long / 2)
            parts.append(panel(middle, (0, 1, 0), wide, long, cloth))
    inside = np.array([[-left, -eye, -back], [right, height - eye, front]])

    def within(at: np.ndarray) -> np.ndarray:
        """As far on the way there as the room reaches, a little before its walls."""
        room_for = np.where(at < 0, inside[0], inside[1]) / np.where(at == 0, 1e-9, at)
        return at * min(1.0, 0.93 * float(room_for.min()))

    colour = draw.white(FLASH_KELVIN if draw.chance(0.75) else HOME_KELVIN)
    number, lamps = 0, []
    side = draw.rng.choice([-1, 1]).item()
    key = draw.scale(2000, 20000)  # lumens; only their ratios count
    lights = [(side * draw.uniform(0.0, 1.4), draw.uniform(0.0, 1.0), key)]
    if draw.chance(0.6):
        fill = key * draw.scale(0.1, 0.7)
        lights.append((-side * draw.uniform(0.3, 1.4), draw.uniform(-0.1, 0.7), fill))
    if draw.chance(0.12):  # from above
        lights.append((draw.uniform(-3, 3), draw.uniform(1.1, 1.5), key * draw.scale(0.2, 1)))
    for _ in range(draw.one_of([0.45, 0.35, 0.2])):
        rim = key * draw.scale(0.1, 1)
        lights.append(
            (draw.uniform(1.9, 2.7) * draw.rng.choice([-1, 1]).item(), draw.uniform(0.1, 0.8), rim)
        )
    for azimuth, elevation, flux in lights:
        at = within(_towards(azimuth, elevation, draw.scale(0.8, 4)))
        tint = _vivid(draw) if flux < key and draw.chance(0.08) else colour
        shape = draw.one_of([0.55, 0.2, 0.25])
        if shape == 2:  # a reflector's bare head
            power = candelas(tint, flux * 4 / (2 * math.pi))
            lamps.append(Lamp(position=at, intensity=power, axis=-at, focus=3.0, radius_m=0.1))
            continue
        parts += _softbox(draw, at, tint, flux, number, round_=shape == 1)
        number += 1
    if draw.chance(0.4):  # a light on the backdrop
        near = -away + draw.uniform(0.4, 0.8)
        at = np.array([draw.uniform(-1, 1), draw.uniform(-0.8, 0.8), near])
        tint = colour if draw.chance(0.8) else _vivid(draw)
        lamps.append(
            Lamp(
                position=at,
                intensity=candelas(tint, 0.3 * key / math.pi),
                axis=(-0.3 * at[0], 0.0, -1.0),
                focus=2.0,
                radius_m=0.05,
            )
        )
    if draw.chance(0.3):  # a white reflector at the side
        at = within(_towards(-side * draw.uniform(0.8, 1.8), draw.uniform(-0.5, 0.1), 0.8))
        parts.append(panel(at, -at, 0.8, 1.1, Material(albedo=(0.8, 0.8, 0.8))))
    return Scene(rectangles=parts, lamps=lamps, outside=Outside.uniform((0, 0, 0)), closed=True)


def _softbox(
    draw: Draw, at: np.ndarray, colour: Triple, flux: Real, number: int, *, round_: bool
) -> list[Rectangle]:
    """A square or a strip of light that faces the viewer; an umbrella is brighter in its middle."""
    wide = draw.scale(0.35, 1.3)
    tall = wide if draw.chance(0.6) or round_ else wide * draw.uniform(1.2, 2.5)
    front = panel(at, -at, wide, tall, radiance=lumens(colour, flux, wide * tall), lamp=number)
    back = panel(at * 1.02, at, wide, tall)
    if not round_:
        return [front, back]
    inner = lumens(colour, 0.5 * flux, 0.25 * wide * tall)
    middle = panel(0.99 * at, -at, wide / 2, tall / 2, radiance=inner, lamp=number)
    outer = panel(at, -at, wide, tall, radiance=0.5 * np.asarray(front.radiance), lamp=number)
    return [outer, middle, back]


def _vivid(draw: Draw) -> np.ndarray:
    """A saturated light of luminance 1."""
    hue = draw.uniform(0, 2 * math.pi)
    colour = np.exp(1.3 * np.cos(hue + np.array([0, 2, 4]) * math.pi / 3))
    return colour / (colour @ [0.2126, 0.7152, 0.0722])


def street(outside: Outside, draw: Draw) -> Scene:
    """A pavement at night or in the last of dusk: lamps, shop windows, signs, cars."""
    eye = draw.uniform(1.4, 1.75)
    _, ground = draw.ground(("asphalt", "paving", "wet asphalt")[draw.one_of([0.45, 0.3, 0.25])])
    parts = [panel((0, -eye, 0), (0, 1, 0), 120, 120, ground)]
    near, far = draw.uniform(1.0, 4), draw.uniform(7, 22)  # the street runs along z
    number = 0
    for side, away in ((-1, near), (1, far)):
        z = -50.0
        while z < 50 and draw.chance(0.93):
            length, tall = draw.uniform(6, 18), draw.scale(4, 25)
            x = side * (away + draw.uniform(0, 0.6))
            wall = draw.facade()
            parts += box(
                (min(x, x + side * 8), -eye, z),
                (max(x, x + side * 8), tall - eye, z + length),
                wall,
            )
            if abs(z + length / 2) < 28:
                new = _facade(draw, x - side * 0.02, -side, z, length, tall, eye, number)
                number += len(new)
                parts += new
            z += length + (draw.uniform(1, 8) if draw.chance(0.25) else 0)
    lamps = _street_lamps(draw, near, far, eye)
    for _ in range(draw.one_of([0.5, 0.25, 0.15, 0.1])):
        z = draw.scale(8, 60) * draw.rng.choice([-1, 1]).item()
        x = draw.uniform(2, far - 2)
        for offset in (-0.6, 0.6):
            power = candelas(black_body(4500.0), draw.scale(60, 1500))
            lamps.append(Lamp(position=(x + offset, 0.7 - eye, z), intensity=power, radius_m=0.08))
    turn = draw.uniform(-math.pi, math.pi)
    return Scene(rectangles=parts, lamps=lamps, outside=outside).seen_from((0, 0, 0), turn)


def _facade(
    draw: Draw, x: Real, facing: int, z: Real, length: Real, tall: Real, eye: Real, number: int
) -> list[Rectangle]:
    """Shop windows and signs below, some lit windows above."""
    lights = []

    def add(y: Real, at: Real, wide: Real, high: Real, radiance: np.ndarray) -> None:
        lights.append(
            panel(
                (x, y - eye, z + at),
                (facing, 0, 0),
                wide,
                high,
                radiance=radiance,
                lamp=number + len(lights),
            )
        )

    if draw.chance(0.5):
        wide = draw.uniform(0.4, 0.85) * length
        colour = draw.white(HOME_KELVIN)
        add(1.5, length / 2, wide, draw.uniform(1.6, 2.4), nits(colour, draw.scale(15, 300)))
        if draw.chance(0.5) and tall > 4:
            colour = _vivid(draw) if draw.chance(0.7) else draw.white(HOME_KELVIN)
            add(3.2, length / 2, 0.5 * wide, 0.5, nits(colour, draw.scale(50, 500)))
    for level in range(1, int(tall / 3.2)):
        for k in range(int(length / 3)):
            if draw.chance(0.12):
                light = nits(draw.white(HOME_KELVIN), draw.scale(3, 40))
                add(3.2 * level + 1.7, 3 * k + 1.7, 1.2, 1.4, light)
    return lights


def _street_lamps(draw: Draw, near: Real, far: Real, eye: Real) -> list[Lamp]:
    colour = draw.white(STREET_KELVIN)
    gap, high = draw.uniform(18, 35), draw.uniform(4, 9)
    start = draw.uniform(-gap / 2, gap / 2)
    flux = draw.scale(2500, 12000)
    lamps = []
    for x in (-0.6 * near, far - 1.5) if draw.chance(0.6) else (far - 1.5,):
        for k in (-2, -1, 0, 1, 2):
            at = x, high - eye, start + k * gap
            power = candelas(colour, flux * 1.5 / (2 * math.pi))
            lamps.append(Lamp(position=at, intensity=power, focus=0.5, radius_m=0.15))
    return lamps


def flash(draw: Draw, lux: Real, reach: Real) -> Lamp:
    """A flash on the camera, or a ring about its lens, that lights the viewer by ``lux``.

    ``reach`` is how far the viewer sees towards the camera.
    """
    distance = min(draw.scale(0.5, 3), 0.8 * reach)
    place = np.array([draw.normal(0, 0.03), draw.uniform(0.0, 0.1), distance])
    colour = draw.white(FLASH_KELVIN)
    power = candelas(colour, lux * distance**2)
    return Lamp(
        position=place, intensity=power, axis=-place, focus=2.0, radius_m=draw.scale(0.01, 0.09)
    )
