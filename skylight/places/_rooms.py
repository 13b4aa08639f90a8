"""Rooms of homes, offices, shops, halls and cars, lit by windows and lamps."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import torch

from skylight.places._materials import (
    HOME_KELVIN,
    OFFICE_KELVIN,
    Draw,
    candelas,
    lumens,
    nits,
)
from skylight.places._outdoors import irradiance
from skylight.places._scene import (
    Hole,
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
    pierced,
)

FROM_WALL_M = 0.4  # of viewers and furniture that they look over
GLASS = (0.78, 0.8, 0.78)  # two panes


@dataclass
class Room:
    """A box from the origin to ``size``, whose y is up, as it is being furnished."""

    size: Triple
    draw: Draw
    parts: list[Rectangle] = field(default_factory=list)
    lamps: list[Lamp] = field(default_factory=list)
    lights: int = 0  # numbers given to panels and windows

    def number(self, count: int = 1) -> int:
        """The first of so many new numbers of lights."""
        self.lights += count
        return self.lights - count

    def wall(self, side: int, material: Material) -> Rectangle:
        """One of the four walls; sides 0 and 1 are across z, 2 and 3 across x."""
        width, height, depth = self.size
        centre, facing, along = (
            ((width / 2, height / 2, 0), (0, 0, 1), width),
            ((width / 2, height / 2, depth), (0, 0, -1), width),
            ((0, height / 2, depth / 2), (1, 0, 0), depth),
            ((width, height / 2, depth / 2), (-1, 0, 0), depth),
        )[side]
        return panel(centre, facing, along, height, material)

    def shell(
        self,
        ceiling: Material,
        walls: Sequence[Material | None],
        floor: Material,
        *,
        skylights: int = 0,
    ) -> None:
        """Ceiling with rows of ``skylights``, floor, and the walls without windows."""
        width, height, depth = self.size
        middle = width / 2, depth / 2
        above = panel((middle[0], height, middle[1]), (0, -1, 0), width, depth, ceiling)
        rows = (np.arange(skylights) + 0.5) / max(skylights, 1)
        half = self.draw.uniform(0.1, 0.35) / max(skylights, 1)
        holes = [Hole(0.1, 0.9, at - half, at + half) for at in rows]
        self.parts += pierced(above, holes, lamp=self.number(skylights))
        self.parts.append(panel((middle[0], 0, middle[1]), (0, 1, 0), width, depth, floor))
        self.parts += [self.wall(k, each) for k, each in enumerate(walls) if each is not None]

    def windows(self, side: int, material: Material, low: Real, high: Real, share: Real) -> None:
        """A wall with one to four windows from ``low`` to ``high``, ``share`` of its length."""
        wall = self.wall(side, material)
        length, height = float(np.linalg.norm(wall.along)), self.size[1]
        count = max(1, min(4, round(share * length / self.draw.uniform(0.8, 2.2))))
        gap = (1 - share) / (count + 1)
        wide = share / count
        holes = [
            Hole(gap + k * (wide + gap), gap + k * (wide + gap) + wide, low / height, high / height)
            for k in range(count)
        ]
        self.parts += pierced(wall, holes, lamp=self.number(count))

    def spot(self, margin: Real = FROM_WALL_M) -> tuple[float, float]:
        """A place on the floor, x and z."""
        width, _, depth = self.size
        margin = min(margin, width / 3, depth / 3)
        return self.draw.uniform(margin, width - margin), self.draw.uniform(margin, depth - margin)

    def furnish(self, count: int, highest: Real) -> None:
        """Boxes on the floor, most of them at the walls."""
        draw = self.draw
        width, height, depth = self.size
        for _ in range(count):
            size = draw.scale(0.4, 2.2), min(draw.scale(0.4, highest), 0.95 * height)
            deep = draw.scale(0.35, 1.0)
            if draw.chance(0.7):
                side = draw.count(0, 3)
                at = draw.uniform(0.1, 0.9)
                x = at * width if side < 2 else (deep / 2 if side == 2 else width - deep / 2)
                z = at * depth if side >= 2 else (deep / 2 if side == 0 else depth - deep / 2)
                half = (size[0] / 2, deep / 2) if side < 2 else (deep / 2, size[0] / 2)
            else:
                (x, z), half = self.spot(), (size[0] / 2, deep / 2)
                size = size[0], min(size[1], 0.9)
            low = max(x - half[0], 0.01), 0.0, max(z - half[1], 0.01)
            high = min(x + half[0], width - 0.01), size[1], min(z + half[1], depth - 0.01)
            self.parts += box(low, high, draw.furniture())

    def pictures(self, count: int) -> None:
        """Flat things a hand's breadth before walls: pictures, doors, boards."""
        draw = self.draw
        for _ in range(count):
            side = draw.count(0, 3)
            wall = self.wall(side, draw.furniture())
            length = float(np.linalg.norm(wall.along))
            wide, high = draw.scale(0.3, 1.4), draw.scale(0.3, 1.2)
            a = draw.uniform(0.1, 0.9) * length
            b = draw.uniform(1.0, 1.9)
            a0, a1 = max(a - wide / 2, 0) / length, min(a + wide / 2, length) / length
            b0, b1 = (max(b - high / 2, 0) / self.size[1], min(b + high / 2, self.size[1] - 0.1))
            piece = pierced(wall, [Hole(a0, a1, b0, b1 / self.size[1])])[-1]
            normal = np.cross(wall.along, wall.across)
            lift = 0.03 * normal / np.linalg.norm(normal)
            self.parts.append(replace(piece, window=False, corner=piece.corner + lift))

    def scene(
        self,
        outside: Outside,
        *,
        eye: Real,
        turn_rad: Real,
        spot: tuple[float, float],
        curtains: Real = 0.0,
    ) -> Scene:
        """Seen from a spot; ``curtains`` is the share of windows with white cloth before them."""
        seen = Scene(
            rectangles=self.parts, lamps=self.lamps, outside=outside, closed=True, glass=GLASS
        ).seen_from((spot[0], eye, spot[1]), turn_rad)
        drawn = [
            _curtain(each, outside, self.draw)
            if each.window and self.draw.chance(curtains)
            else each
            for each in seen.rectangles
        ]
        return replace(seen, rectangles=drawn)


def _curtain(window: Rectangle, outside: Outside, draw: Draw) -> Rectangle:
    """Thin cloth or paper that lets 0.15 to 0.5 of the light through, evenly."""
    normal = np.cross(window.along, window.across)
    out = torch.tensor(-normal / np.linalg.norm(normal), dtype=torch.float32)
    light = irradiance(outside.map, out)
    light = light + outside.sunny * outside.sun_irradiance * float((outside.sun @ out).clamp(min=0))
    through = draw.uniform(0.15, 0.5) * np.array([1.0, 0.97, 0.9])
    return replace(
        window,
        window=False,
        material=Material(albedo=(0.55, 0.54, 0.5)),
        radiance=light.numpy() * through * np.asarray(GLASS) / math.pi,
    )


def home(outside: Outside, draw: Draw, *, dark: bool) -> Scene:
    """A living room, kitchen or corridor."""
    size = draw.scale(2.4, 8), draw.uniform(2.35, 3.1), draw.scale(2.4, 8)
    room = Room(size, draw)
    paint = draw.paint(0.66, 0.13)
    walls = [draw.facade() if draw.chance(0.06) else paint for _ in range(4)]
    if draw.chance(0.1):  # wood, brick or a colour all round
        walls = [draw.facade()] * 4
    pierce = draw.rng.permutation(4)[: draw.one_of([0.06, 0.6, 0.34])].tolist()
    for side in pierce:
        low = draw.uniform(0.0, 0.3) if draw.chance(0.25) else draw.uniform(0.6, 1.1)
        high = min(size[1] - 0.1, draw.uniform(1.9, 2.5))
        room.windows(side, walls[side], low, high, draw.uniform(0.2, 0.75))
    room.shell(
        draw.paint(0.78, 0.07, vivid=0.02),
        [None if k in pierce else each for k, each in enumerate(walls)],
        draw.floor(),
    )
    room.furnish(draw.count(2, 7), 2.0)
    room.pictures(draw.count(0, 5))
    if dark or not pierce or draw.chance(0.5):
        home_lamps(room)
    eye = draw.uniform(1.05, 1.7)
    return room.scene(
        outside,
        eye=eye,
        turn_rad=draw.uniform(-math.pi, math.pi),
        spot=room.spot(),
        curtains=draw.uniform(0.5, 1) if draw.chance(0.3) else 0.0,
    )


def home_lamps(room: Room) -> None:
    """One to four lamps of a home."""
    draw = room.draw
    width, height, depth = room.size
    colour = draw.white(HOME_KELVIN)
    for _ in range(draw.one_of([0, 0.45, 0.3, 0.15, 0.1])):
        kind = draw.one_of([0.22, 0.14, 0.2, 0.16, 0.12, 0.1, 0.06])
        if draw.chance(0.25):
            colour = draw.white(HOME_KELVIN)
        x, z = room.spot(0.4)
        if kind == 0:  # a globe or drum under the ceiling
            across, flux = draw.uniform(0.2, 0.5), draw.scale(600, 3000)
            drop = draw.uniform(0.02, 0.7)
            high = height - drop
            low = high - draw.uniform(0.1, 0.35)
            _shine(room, (x, low, z), (across, high - low, across), colour, flux)
        elif kind == 1:  # a bare bulb
            place = x, height - draw.uniform(0.1, 0.7), z
            power = candelas(colour, draw.scale(300, 1500) / (4 * math.pi))
            room.lamps.append(Lamp(position=place, intensity=power))
        elif kind == 2:  # on the floor or a table, with a shade: bright above and below
            across, tall = draw.uniform(0.2, 0.45), draw.uniform(0.2, 0.35)
            high = draw.uniform(0.9, 1.8)
            flux = draw.scale(300, 1200)
            _shine(room, (x, high - tall, z), (across, tall, across), colour, 0.5 * flux)
            for axis, y in (((0, 1, 0), high + 0.06), ((0, -1, 0), high - tall - 0.06)):
                power = candelas(colour, 0.25 * flux / math.pi)
                room.lamps.append(
                    Lamp(position=(x, y, z), intensity=power, axis=axis, focus=1.0, radius_m=0.05)
                )
        elif kind == 3:  # spots in the ceiling
            row = draw.count(2, 6)
            for k in range(row):
                place = (k + 0.5) / row * width, height - 0.03, z
                focus = draw.uniform(2, 12)
                power = candelas(colour, draw.scale(200, 500) * (focus + 1) / (2 * math.pi))
                room.lamps.append(Lamp(position=place, intensity=power, focus=focus))
        elif kind == 4:  # a tube or a bar of light
            _shine(
                room,
                (x, height - 0.12, z),
                (0.06, 0.05, min(draw.uniform(0.6, 1.5), depth / 2)),
                draw.white(OFFICE_KELVIN, tube=True),
                draw.scale(1000, 3500),
            )
        elif kind == 5:  # a flat panel
            side = draw.uniform(0.3, 0.6)
            room.parts.append(
                panel(
                    (x, height - 0.03, z),
                    (0, -1, 0),
                    side,
                    side,
                    radiance=lumens(colour, draw.scale(1200, 4000), side**2),
                    lamp=room.number(),
                )
            )
        else:  # a screen
            wall = room.wall(draw.count(0, 3), Material(albedo=(0.02, 0.02, 0.02)))
            normal = np.cross(wall.along, wall.across)
            normal = normal / np.linalg.norm(normal)
            middle = wall.corner + wall.along * draw.uniform(0.25, 0.75) + 0.05 * normal
            middle = middle + np.array([0, draw.uniform(0.8, 1.4), 0])
            wide = draw.uniform(0.5, 1.4)
            light = nits(black_body(7000.0), draw.scale(30, 250))
            room.parts.append(
                panel(middle, normal, wide, 0.56 * wide, radiance=light, lamp=room.number())
            )


def _shine(
    room: Room,
    at: Triple,
    size: Triple,
    colour: Triple,
    flux: Real,
) -> None:
    """A box that shines on all sides; ``at`` is the middle of its lower side."""
    area = 2 * (size[0] * size[1] + size[1] * size[2] + size[0] * size[2])
    low = np.array([at[0] - size[0] / 2, at[1], at[2] - size[2] / 2])
    room.parts += box(
        low,
        low + np.asarray(size),
        Material(albedo=(0.4, 0.4, 0.4)),
        radiance=lumens(colour, flux, area),
        lamp=room.number(),
    )


def workplace(outside: Outside, draw: Draw, *, dark: bool) -> Scene:
    """An office, a shop or a hall: larger, under rows of lamps."""
    kind = draw.one_of([0.45, 0.35, 0.2])
    if kind == 2:
        size = draw.scale(9, 40), draw.uniform(4.5, 12), draw.scale(9, 40)
    else:
        size = draw.scale(4, 16), draw.uniform(2.6, 4), draw.scale(4, 16)
    room = Room(size, draw)
    paint = draw.paint(0.62, 0.15)
    pierce = draw.rng.permutation(4)[: draw.one_of([0.35, 0.4, 0.25])].tolist()
    for side in pierce:
        if kind == 1:  # a shop's front
            low, high, share = 0.1, size[1] - 0.4, draw.uniform(0.7, 0.95)
        elif kind == 2:  # under the roof
            low, high, share = 0.45 * size[1], 0.9 * size[1], draw.uniform(0.3, 0.8)
        else:
            low, high, share = draw.uniform(0.5, 1), size[1] - 0.3, draw.uniform(0.5, 0.9)
        room.windows(side, paint, low, high, share)
    room.shell(
        draw.paint(0.3 if draw.chance(0.2) else 0.75, 0.08, vivid=0.03),
        [None if k in pierce else draw.facade() if draw.chance(0.12) else paint for k in range(4)],
        draw.floor(),
        skylights=draw.count(1, 4) if kind == 2 and draw.chance(0.35) else 0,
    )
    room.furnish(draw.count(4, 12), 2.2 if kind == 1 else 1.5)
    if kind == 1 and draw.chance(0.6):
        _shelves(room)
    room.pictures(draw.count(0, 6))
    if dark or not pierce or draw.chance(0.85):
        _rows_of_lamps(room)
    return room.scene(
        outside,
        eye=draw.uniform(1.1, 1.75),
        turn_rad=draw.uniform(-math.pi, math.pi),
        spot=room.spot(),
        curtains=draw.uniform(0.3, 1) if kind == 0 and draw.chance(0.3) else 0.0,
    )


def _shelves(room: Room) -> None:
    """Rows of goods with aisles between them."""
    draw = room.draw
    width, height, depth = room.size
    high = min(draw.uniform(1.2, 2.2), height - 0.3)
    aisle = draw.uniform(1.2, 2.4)
    for x in np.arange(aisle, width - 0.6, aisle + 0.6):
        for z in np.arange(1.0, depth - 1.0, 1.5):
            room.parts += box((x, 0, z), (x + 0.5, high, z + 1.4), draw.furniture())


def _rows_of_lamps(room: Room) -> None:
    """Panels, tubes or spots over the whole ceiling, so many that it is lit by 150 to 800 lux."""
    draw = room.draw
    width, height, depth = room.size
    step = draw.uniform(1.6, 3.2) * max(1, height / 4)
    rows, columns = max(1, round(width / step)), max(1, round(depth / step))
    each = draw.scale(150, 800) * width * depth / (0.6 * rows * columns)  # lumens
    kind = draw.one_of([0.45, 0.3, 0.25])
    colour = draw.white(OFFICE_KELVIN, tube=kind == 1)
    lit = draw.uniform(0.6, 1.1)
    for x in (np.arange(rows) + 0.5) * width / rows:
        for z in (np.arange(columns) + 0.5) * depth / columns:
            if draw.rng.random() > lit:
                continue
            if kind == 2:
                power = candelas(colour, each * 4 / (2 * math.pi))
                room.lamps.append(
                    Lamp(position=(x, height - 0.05, z), intensity=power, focus=3.0, radius_m=0.06)
                )
                continue
            wide, long = (0.6, 0.6) if kind == 0 else (0.12, 1.2)
            room.parts.append(
                panel(
                    (x, height - 0.03, z),
                    (0, -1, 0),
                    wide,
                    long,
                    radiance=lumens(colour, each, wide * long),
                    lamp=room.number(),
                )
            )


def car(outside: Outside, draw: Draw) -> Scene:
    """The cabin of a car: glass all round above the belt, dark seats."""
    size = draw.uniform(1.35, 1.6), draw.uniform(1.1, 1.35), draw.uniform(1.9, 2.6)
    room = Room(size, draw)
    cloth = Material(albedo=np.full(3, draw.scale(0.03, 0.3)) * [1, 0.97, 0.93])
    roof = Material(albedo=np.full(3, draw.uniform(0.3, 0.6)) if draw.chance(0.6) else [0.05] * 3)
    belt, top = 0.52 * size[1], 0.93 * size[1]
    for side, share in ((0, 0.9), (1, draw.uniform(0.6, 0.85)), (2, 0.86), (3, 0.86)):
        room.windows(side, cloth, belt + draw.uniform(-0.05, 0.08), top, share)
    room.shell(roof, [None] * 4, Material(albedo=(0.04, 0.04, 0.04)))
    width, _, depth = size
    for x in (0.27, 0.73):
        for z in (0.45, 0.9):
            seat = np.array([x * width, 0.0, z * depth])
            room.parts += box(seat - (0.22, 0, 0.08), seat + np.array([0.22, 0.72, 0.08]), cloth)
            room.parts += box(seat - (0.22, 0, 0.5), seat + np.array([0.22, 0.3, -0.08]), cloth)
    room.parts += box((0.02, 0, 0.02), (width - 0.02, 0.5 * size[1], 0.3), cloth)
    x = width * (0.27 if draw.chance(0.5) else 0.73)
    z = depth * (0.45 if draw.chance(0.75) else 0.9) - 0.28
    spot = x, z
    return room.scene(
        outside,
        eye=draw.uniform(0.78, 0.95) * size[1] - 0.1,
        turn_rad=draw.uniform(-math.pi, math.pi),
        spot=spot,
    )
