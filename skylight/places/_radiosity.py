"""The light on the surfaces of a scene, and what they send to the viewer.

Surfaces are Lambertian patches of constant radiosity (Goral et al. 1984), ::

    B_i = rho_i (D_i + sum_j F_ij B_j)

with D the irradiance by the sun, lamps, panels and the sky, and the form factors F_ij by rays of
cosine distribution (Malley's method; Sillion & Puech 1994, "Radiosity and Global Illumination",
section 4.4). What the viewer sees is not the patches: each pixel's surfaces get D and a gather of
B of their own. Panels and windows are sampled by points on them and by the rays of the gather,
weighed by the balance heuristic (Veach 1997, 9.2.2).
"""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.nn.functional import grid_sample, normalize

from skylight.places._scene import Lamp, Outside, Scene, Surfaces
from skylight.skies.surroundings._layer import Draws, rough_noise
from skylight.sphere._envmap import luminance
from skylight.sphere._frame import DirectionGrid, pixel_from_direction
from skylight.transport._path_tracer import cosine_directions

PATCHES, MOST_ACROSS = 500, 24  # of a scene, and of a rectangle's side
PATCH_POINTS, PATCH_RAYS, BOUNCES = 4, 64, 24
GATHER, POINTS = 24, 12  # rays, and points on panels and windows, for each surface in a pixel
GLARE = 3.0  # of the outside's mean luminance: what is above lights as so many suns
GLARE_SUNS = 16
MIRRORED = 16  # rays of a gloss
PIXEL_RAD = math.pi / 64  # of maps as they are made: finer texture is not seen
LIFT = 1e-3  # metres, off the surface that a ray leaves; what float32 rounds at 30 m is a tenth
SHADE_M = 0.25  # between the samples of the tile of far things' shadows
TILE = 64


class Lit:
    """A scene as tensors, with the radiosity of its patches."""

    def __init__(self, scene: Scene, generator: torch.Generator) -> None:
        self.scene, self.generator = scene, generator
        solid = [each for each in scene.rectangles if not each.window]
        self.materials = [each.material for each in solid]
        self.surfaces = Surfaces.of(solid)
        self.albedo = _rows([each.material.albedo for each in solid])
        self.glass = torch.tensor(np.asarray(scene.glass), dtype=torch.float32)
        outside = scene.outside
        self.sun, self.beam = outside.sun, outside.sun_irradiance * self.glass
        if scene.closed:
            self.beam = self.beam * outside.sunny
        self._glare()
        self.tile = rough_noise(Draws(count=1, generator=generator), TILE, TILE, 1.0)[0]
        self.shifts = torch.rand(max(1, len(solid)), 2, generator=generator)
        self._panels()
        self._patches()
        self._solve()

    def _panels(self) -> None:
        """What is sampled by points: rectangles that shine, then windows."""
        shine = self.surfaces.radiance.amax(1) > 0 if len(self.surfaces) else torch.zeros(0) > 0
        self.shining = shine.nonzero()[:, 0]
        solid = [each for each in self.scene.rectangles if not each.window]
        shining = [solid[k] for k in self.shining.tolist()]
        windows = [each for each in self.scene.rectangles if each.window]
        self.panels = Surfaces.of([*shining, *windows])
        self.numbers = [each.lamp for each in (*shining, *windows)]
        self.is_window = torch.arange(len(self.panels)) >= len(shining)
        self.panel_of = torch.full((len(solid),), -1)
        self.panel_of[self.shining] = torch.arange(len(shining))
        power = luminance(self.panels.radiance) * self.panels.area
        if windows:
            # by the light of the hemisphere before each
            grid = DirectionGrid.latlong(32)
            light = luminance(self.outside(grid.directions.float())) * grid.solid_angles.float()
            facing = (-self.panels.normal @ grid.directions.float().T).clamp(min=0)
            power = torch.where(self.is_window, facing @ light / math.pi * self.panels.area, power)
        self.chance = power / power.sum().clamp(min=1e-30)

    def _glare(self) -> None:
        """Part the outside of an open scene into even light and what glares about its sun.

        The latter is drawn as a few directions, each with its irradiance: among the rays of a
        gather it would be there or not.
        """
        outside = self.scene.outside
        self.even, self.suns, self.glare = outside, torch.zeros(0, 3), torch.zeros(0, 3)
        if self.scene.closed:
            return
        grid = DirectionGrid.latlong(*outside.map.shape[:2])
        light, solid = outside.map.reshape(-1, 3), grid.solid_angles.float()
        level = luminance(light)
        most = GLARE * (level @ solid) / (4 * math.pi)
        share = (1 - most / level.clamp(min=1e-30)).clamp(min=0)
        power = level * share * solid
        if not float(power.sum()) > 0:
            return
        edges = power.cumsum(0) / power.sum()
        strata = (torch.arange(GLARE_SUNS) + 0.5) / GLARE_SUNS
        drawn = torch.bucketize(strata, edges).clamp(max=len(edges) - 1)
        self.even = replace(outside, map=(light * (1 - share)[:, None]).reshape(outside.map.shape))
        self.suns = grid.directions.float()[drawn]
        self.glare = light[drawn] / level[drawn, None] * power.sum() / GLARE_SUNS * self.glass

    def from_glare(
        self, places: Float[Tensor, "r 3"], normals: Float[Tensor, "r 3"]
    ) -> Float[Tensor, "r 3"]:
        total = torch.zeros(len(places), 3)
        for sun, glare in zip(self.suns, self.glare, strict=True):
            cosine = (normals @ sun).clamp(min=0)
            lit = (cosine > 0).nonzero()[:, 0]
            cosine[lit] *= self.surfaces.free(places[lit], sun[None])
            total += cosine[:, None] * glare
        return total

    def outside(self, directions: Float[Tensor, "r 3"]) -> Float[Tensor, "r 3"]:
        """Radiance from far away, without the sun."""
        return looked_up(self.scene.outside, directions) * self.glass

    def evenly(self, directions: Float[Tensor, "r 3"]) -> Float[Tensor, "r 3"]:
        """:meth:`outside` without what glares."""
        return looked_up(self.even, directions) * self.glass

    def from_panels(
        self, places: Float[Tensor, "r 3"], normals: Float[Tensor, "r 3"], points: int, rays: int
    ) -> Float[Tensor, "r 3"]:
        """Irradiance by panels and windows, beside so many ``rays`` of a gather."""
        total = torch.zeros(len(places), 3)
        if not len(self.panels) or not float(self.chance.sum()):
            return total
        edges = self.chance.cumsum(0)
        # a stratified draw of the panel for each point, and a lattice (Roberts' R2) over its area
        index = torch.arange(points)
        strata = (index + self._uniform(len(places), 1)) / points
        which = torch.bucketize(strata.flatten() * float(edges[-1]), edges)
        which = which.clamp(max=len(edges) - 1)
        a = ((index * 0.7548776662 + self._uniform(len(places), 1)) % 1).flatten()
        b = ((index * 0.5698402910 + self._uniform(len(places), 1)) % 1).flatten()
        owner = torch.arange(len(places)).repeat_interleave(points)
        target = self.panels.at(which, a, b)
        away = target - places[owner]
        way = normalize(away, dim=1)
        cosine = (way * normals[owner]).sum(1).clamp(min=0)
        lit = ((cosine > 0) & ((way * self.panels.normal[which]).sum(1) < 0)).nonzero()[:, 0]
        which, way, owner, cosine = which[lit], way[lit], owner[lit], cosine[lit]
        density = points * self._density(which, away[lit]) + rays * cosine / math.pi
        weight = cosine / density * self.surfaces.reaches(places[owner], target[lit])
        sent = self.panels.radiance[which]
        window = self.is_window[which]
        if window.any():
            sent[window] = self.outside(way[window])
        return total.index_add_(0, owner, weight[:, None] * sent)

    def _density(self, panel: Int[Tensor, " r"], away: Float[Tensor, "r 3"]) -> Tensor:
        """Of points drawn on a panel, by solid angle: chance / area d^2 / cos'."""
        square = away.square().sum(1).clamp(min=1e-12)  # 0 where two rectangles touch
        cosine = (away * self.panels.normal[panel]).sum(1).abs() / square.sqrt()
        each = self.chance[panel] / self.panels.area[panel]
        return each * square / cosine.clamp(min=1e-6)

    def _sent(
        self,
        starts: Float[Tensor, "r 3"],
        directions: Float[Tensor, "r 3"],
        which: Int[Tensor, " r"],
        where: Float[Tensor, "r 3"],
        weigh: tuple[Float[Tensor, " r"], int, int] | None,
    ) -> Float[Tensor, "r 3"]:
        """Radiance of panels and windows where rays end, and in an open scene minus the sky's.

        The open sky's irradiance without anything before it is known (:meth:`from_sky`), so rays
        bring what they meet less the sky behind it.

        ``weigh``, (cosines, rays, points on panels), is what the balance heuristic needs.
        """
        light = torch.zeros(len(starts), 3)
        gone = (which < 0).nonzero()[:, 0]
        if self.scene.closed:
            light[gone] = self.outside(directions[gone])
        panel = torch.full_like(which, -1)
        if len(self.panel_of):
            panel = torch.where(which < 0, -1, self.panel_of[which])
        where = where.clone()
        if self.scene.closed and len(gone):
            panel[gone], where[gone] = self.panels.hit(starts[gone], directions[gone])
        on = (panel >= 0).nonzero()[:, 0]
        facing = (directions[on] * self.panels.normal[panel[on]]).sum(1) < 0
        shining = on[~self.is_window[panel[on]]]
        light[shining] = self.panels.radiance[panel[shining]]
        light[on[~facing]] = 0
        if weigh is not None:
            cosine, rays, points = weigh
            by_points = points * self._density(panel[on], where[on] - starts[on])
            by_rays = rays * cosine[on] / math.pi
            light[on] *= (by_rays / (by_rays + by_points).clamp(min=1e-30))[:, None]
        if not self.scene.closed:
            blocked = (which >= 0).nonzero()[:, 0]
            light[blocked] -= self.evenly(directions[blocked])
        return light

    def from_sky(self, normals: Float[Tensor, "r 3"]) -> Float[Tensor, "r 3"]:
        """Irradiance of an open scene by even light, as if nothing stood before it."""
        if self.scene.closed:
            return torch.zeros_like(normals)
        distinct, back = torch.unique(normals, dim=0, return_inverse=True)
        light = self.even.map.reshape(-1, 3) * self.glass
        grid = DirectionGrid.latlong(*self.scene.outside.map.shape[:2])
        solid = grid.solid_angles.float()
        return ((distinct @ grid.directions.float().T).clamp(min=0) * solid @ light)[back]

    def from_lamps(
        self, places: Float[Tensor, "r 3"], normals: Float[Tensor, "r 3"]
    ) -> Float[Tensor, "r 3"]:
        """Irradiance by lamps, with the soft shadow of one point drawn on each."""
        total = torch.zeros(len(places), 3)
        for lamp in self.scene.lamps:
            middle = torch.tensor(np.asarray(lamp.position), dtype=torch.float32)
            target = self.on_lamp(lamp, len(places))
            away = middle - places
            distance = away.norm(dim=1).clamp(min=lamp.radius_m)
            way = away / distance[:, None]
            weight = (way * normals).sum(1).clamp(min=0) / distance.square()
            weight = weight * focused(lamp, -way)
            lit = (weight > 0).nonzero()[:, 0]
            weight[lit] *= self.surfaces.reaches(places[lit], target[lit])
            total += weight[:, None] * torch.tensor(np.asarray(lamp.intensity)).float()
        return total

    def on_lamp(self, lamp: Lamp, count: int) -> Float[Tensor, "r 3"]:
        """Places drawn on a lamp's ball, the half that shines where it has a direction."""
        middle, axis = (
            torch.tensor(np.asarray(each), dtype=torch.float32)
            for each in (lamp.position, lamp.axis)
        )
        way = normalize(torch.randn(count, 3, generator=self.generator), dim=1)
        if lamp.focus:
            way = torch.where((way @ axis)[:, None] < 0, -way, way)
        return middle + lamp.radius_m * way

    def in_sun(self, places: Float[Tensor, "r 3"]) -> Float[Tensor, " r"]:
        """1 in the sun and 0 in shadows, those of far things soft."""
        free = self.surfaces.free(places, self.sun[None])
        share = self.scene.outside.shade
        if self.scene.closed or not 0 < share < 1:
            return free
        # the ground along the beam down to the level of the viewer's feet
        slope = self.sun[1].clamp(min=0.05)
        level = places[:, [0, 2]] - places[:, 1:2] / slope * self.sun[[0, 2]]
        near = self.tile.flatten()
        # the viewer stands amid the light, or amid the shade
        sunny = self.scene.outside.sunny > 0.5
        here = torch.quantile(near, (1 - share) / 2 if sunny else 1 - share / 2)
        start = (near - here).abs().argmin()
        shift = torch.stack([start % TILE, torch.div(start, TILE, rounding_mode="floor")])
        dark = _noise(self.tile, level / SHADE_M + shift)
        edge = torch.quantile(near, 1 - share)
        return free * torch.sigmoid((edge - dark) * 6)

    def gathered(
        self, places: Float[Tensor, "r 3"], normals: Float[Tensor, "r 3"]
    ) -> Float[Tensor, "r 3"]:
        """Irradiance by what surfaces reflect and the sky, beside :meth:`from_panels`."""
        owner, directions, cosine = self._about(normals, GATHER)
        starts = places[owner]
        which, where = self.surfaces.hit(starts, directions)
        light = self._sent(starts, directions, which, where, (cosine, GATHER, POINTS))
        light += self._reflected(directions, which, where)
        light = torch.zeros(len(places), 3).index_add_(0, owner, light)
        return self.from_sky(normals) + math.pi / GATHER * light

    def _reflected(
        self,
        directions: Float[Tensor, "r 3"],
        which: Int[Tensor, " r"],
        where: Float[Tensor, "r 3"],
    ) -> Float[Tensor, "r 3"]:
        """Radiance that patches reflect where rays end."""
        light = torch.zeros(len(which), 3)
        on = (which >= 0).nonzero()[:, 0]
        on = on[(directions[on] * self.surfaces.normal[which[on]]).sum(1) < 0]
        light[on] = self.radiosity[self._patch(which[on], where[on])] / math.pi
        return light

    def _patches(self) -> None:
        """Divide each rectangle; none has fewer than one patch."""
        surfaces = self.surfaces
        size = (surfaces.area.sum() / PATCHES).sqrt().clamp(min=1e-6)
        across = [
            (side.norm(dim=1) / size).ceil().long().clamp(1, MOST_ACROSS)
            for side in (surfaces.along, surfaces.across)
        ]
        self.across = torch.stack(across, 1) if len(surfaces) else torch.zeros(0, 2).long()
        count = self.across.prod(1)
        self.first = count.cumsum(0) - count
        self.of = torch.arange(len(surfaces)).repeat_interleave(count)

    def _patch(self, which: Int[Tensor, " r"], where: Float[Tensor, "r 3"]) -> Int[Tensor, " r"]:
        a, b = self.surfaces.within(which, where)
        along, across = self.across[which].unbind(1)
        return self.first[which] + (b * across).long() * along + (a * along).long()

    def _on_patches(self, points: int) -> tuple[Tensor, Tensor, Tensor]:
        """(the patch, a place drawn on it, the normal) of some points on each."""
        patch = torch.arange(len(self.of)).repeat_interleave(points)
        which = self.of[patch]
        along, across = self.across[which].unbind(1)
        inside = patch - self.first[which]
        a = (inside % along + self._uniform(len(patch))) / along
        b = (torch.div(inside, along, rounding_mode="floor") + self._uniform(len(patch))) / across
        normal = self.surfaces.normal[which]
        return patch, self.surfaces.at(which, a, b) + LIFT * normal, normal

    def _solve(self) -> None:
        count = len(self.of)
        self.radiosity = torch.zeros(count, 3)
        if not count:
            return
        patch, places, normals = self._on_patches(PATCH_POINTS)
        points = PATCH_POINTS * POINTS
        direct = self.from_lamps(places, normals) + self.from_glare(places, normals)
        if float(self.beam.sum()) > 0:
            direct += self._sunlit(places, normals)
        direct += self.from_panels(places, normals, POINTS, PATCH_RAYS // PATCH_POINTS)
        light = torch.zeros(count, 3).index_add_(0, patch, direct) / PATCH_POINTS
        light += self.from_sky(self.surfaces.normal)[self.of]
        patch, places, normals = self._on_patches(PATCH_RAYS)
        directions, cosine = cosine_directions(normals, self._uniform(len(patch), 2))
        which, where = self.surfaces.hit(places, directions)
        sent = self._sent(places, directions, which, where, (cosine, PATCH_RAYS, points))
        light.index_add_(0, patch, math.pi / PATCH_RAYS * sent)
        on = (which >= 0).nonzero()[:, 0]
        on = on[(directions[on] * self.surfaces.normal[which[on]]).sum(1) < 0]
        to, by = patch[on], self._patch(which[on], where[on])
        albedo = self.albedo[self.of]
        for _ in range(BOUNCES):
            bounced = torch.zeros(count, 3).index_add_(0, to, self.radiosity[by]) / PATCH_RAYS
            # of a place that nothing lights, rays less the sky behind them leave a little below 0
            self.radiosity = albedo * (light + bounced).clamp(min=0)

    def _sunlit(
        self, places: Float[Tensor, "r 3"], normals: Float[Tensor, "r 3"]
    ) -> Float[Tensor, "r 3"]:
        cosine = (normals @ self.sun).clamp(min=0)
        lit = (cosine > 0).nonzero()[:, 0]
        cosine[lit] *= self.in_sun(places[lit])
        return cosine[:, None] * self.beam

    def reflected(
        self,
        which: Int[Tensor, " r"],
        places: Float[Tensor, "r 3"],
        sunny: Float[Tensor, " r"],
        smooth: Callable[[Tensor], Tensor],
    ) -> Float[Tensor, "r 3"]:
        """Radiance towards the viewer of places on rectangles, ``sunny`` of each in the sun.

        ``smooth`` takes the noise out of what is gathered.
        """
        normals = self.surfaces.normal[which]
        away = normalize(places, dim=1)
        front = -(away * normals).sum(1)
        normals = torch.where(front[:, None] < 0, -normals, normals)
        starts = places + LIFT * normals
        received = self.from_panels(starts, normals, POINTS, GATHER)
        received = smooth(received + self.gathered(starts, normals)).clamp(min=0)
        received += self.from_lamps(starts, normals) + self.from_glare(starts, normals)
        cosine = (normals @ self.sun).clamp(min=0) * sunny
        received += cosine[:, None] * self.beam
        seen_m = PIXEL_RAD * places.norm(dim=1) / front.abs().clamp(min=0.05)
        light = self._textured(which, places, seen_m) / math.pi * received
        gloss = torch.tensor([each.gloss for each in self.materials])[which]
        some = (gloss > 0).nonzero()[:, 0]
        if len(some):
            # Schlick 1994
            mirror = gloss[some] + (1 - gloss[some]) * (1 - front[some].abs()).pow(5)
            rough = torch.tensor([each.roughness for each in self.materials])[which[some]]
            shown = torch.zeros_like(light)
            shown[some] = self._mirrored(
                starts[some], away[some], normals[some], rough, sunny[some]
            )
            shown = smooth(shown)[some]
            light[some] = (1 - mirror[:, None]) * light[some] + mirror[:, None] * shown
        return light

    def _mirrored(
        self,
        starts: Float[Tensor, "r 3"],
        away: Float[Tensor, "r 3"],
        normals: Float[Tensor, "r 3"],
        rough: Float[Tensor, " r"],
        sunny: Float[Tensor, " r"],
    ) -> Float[Tensor, "r 3"]:
        """Mean radiance about the mirrored direction; sun and lamps are lobes of the roughness."""
        mirrored = away - 2 * (away * normals).sum(1, keepdim=True) * normals
        owner = torch.arange(len(starts)).repeat_interleave(MIRRORED)
        jitter = torch.randn(len(owner), 3, generator=self.generator)
        directions = normalize(mirrored[owner] + rough[owner, None] * jitter, dim=1)
        below = (directions * normals[owner]).sum(1, keepdim=True).clamp(max=0)
        directions = normalize(directions - 2 * below * normals[owner], dim=1)
        which, where = self.surfaces.hit(starts[owner], directions)
        light = self._sent(starts[owner], directions, which, where, None)
        if not self.scene.closed:  # here the sky is not known apart
            light += torch.where(
                (which < 0)[:, None], self.outside(directions), self.evenly(directions)
            )
        light += self._reflected(directions, which, where)
        total = torch.zeros(len(starts), 3).index_add_(0, owner, light) / MIRRORED
        kappa = 1 / rough.square()

        def lobe(towards: Float[Tensor, "#r 3"]) -> Float[Tensor, " r"]:
            chord = (mirrored - towards).square().sum(1)
            return kappa / (2 * math.pi) * torch.exp(-kappa * chord / 2)

        if float(self.beam.sum()) > 0:
            total += (lobe(self.sun[None]) * sunny)[:, None] * self.beam
        for lamp in self.scene.lamps:
            target = self.on_lamp(lamp, len(starts))
            distance = (target - starts).norm(dim=1).clamp(min=lamp.radius_m)
            way = (target - starts) / distance[:, None]
            weight = lobe(way) * focused(lamp, -way) / distance.square()
            lit = (weight > 1e-6).nonzero()[:, 0]
            weight[lit] *= self.surfaces.reaches(starts[lit], target[lit])
            total += weight[:, None] * torch.tensor(np.asarray(lamp.intensity)).float()
        return total

    def _textured(
        self, which: Int[Tensor, " r"], places: Float[Tensor, "r 3"], seen_m: Float[Tensor, " r"]
    ) -> Tensor:
        """The albedo there, which varies over each material's grain, less where that is fine."""
        texture = torch.tensor([each.texture for each in self.materials])[which]
        grain = torch.tensor([each.grain_m for each in self.materials])[which]
        texture = texture * grain / (grain + seen_m)
        # metres along a rectangle's sides, from a place of its own on the tile
        away = places - self.surfaces.corner[which]
        along, across = self.surfaces.along[which], self.surfaces.across[which]
        level = torch.stack(
            [(away * side).sum(1) / side.norm(dim=1) for side in (along, across)], 1
        )
        noise = _noise(self.tile, 4 * level / grain[:, None] + TILE * self.shifts[which])
        return (self.albedo[which] * torch.exp(texture * noise)[:, None]).clamp(max=1)

    def _about(self, normals: Float[Tensor, "r 3"], rays: int) -> tuple[Tensor, Tensor, Tensor]:
        """(owner, direction, cosine) of rays about normals, of cosine density, stratified."""
        owner = torch.arange(len(normals)).repeat_interleave(rays)
        index = torch.arange(rays)
        lattice = torch.stack([(index + 0.5) / rays, (index * 0.6180339887) % 1], 1)
        uniform = (lattice + self._uniform(len(normals), 1, 2)) % 1
        return owner, *cosine_directions(normals[owner], uniform.reshape(-1, 2))

    def _uniform(self, *shape: int) -> Tensor:
        return torch.rand(*shape, generator=self.generator)


def looked_up(outside: Outside, directions: Float[Tensor, "r 3"]) -> Float[Tensor, "r 3"]:
    """The pixels of the outside's map in some directions."""
    height, width = outside.map.shape[:2]
    row, column = pixel_from_direction(directions, height, width)
    pixel = row.round().long().clamp(0, height - 1) * width + column.round().long() % width
    return outside.map.reshape(-1, 3)[pixel]


def focused(lamp: Lamp, way: Float[Tensor, "r 3"]) -> Float[Tensor, " r"]:
    """How a lamp's intensity in some directions compares with that along its axis."""
    if not lamp.focus:
        return torch.ones(len(way))
    axis = torch.tensor(np.asarray(lamp.axis), dtype=torch.float32)
    return (way @ axis / axis.norm()).clamp(min=0).pow(lamp.focus)


def _noise(tile: Float[Tensor, "t t"], place: Float[Tensor, "r 2"]) -> Float[Tensor, " r"]:
    """A tile that repeats, between its samples."""
    size = len(tile)
    wrapped = torch.cat([tile, tile[:1]])
    wrapped = torch.cat([wrapped, wrapped[:, :1]], 1)
    grid = 2 * torch.remainder(place / size, 1) - 1
    return grid_sample(wrapped[None, None], grid[None, None], align_corners=True)[0, 0, 0]


def _rows(values: list) -> Float[Tensor, "q 3"]:
    return torch.tensor(np.array(values).reshape(-1, 3), dtype=torch.float32)
