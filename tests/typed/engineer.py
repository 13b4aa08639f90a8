# pyright: strict
"""What a PyTorch engineer writes, from a photograph to a trained network and a relit scene.

``make lint`` checks it: every call of skylight has a type, none of them ``Any``. What torch has no
types for is passed over.
"""

from pathlib import Path
from typing import assert_type

import torch
from torch import Tensor, nn

import skylight
from skylight import DirectionGrid, EnvironmentMap, Estimate, Photo
from skylight.csc import CodeTensors
from skylight.models import GaussianMixture, LampsPrior, LightModel, load_bundle, without_azimuth
from skylight.probes.partitions import Cells, named_design
from skylight.relight import export_decoder, load_scene, relight
from skylight.training import AutoencoderConfig, train


def light_of(photo: Path) -> tuple[EnvironmentMap, Tensor]:
    taken = assert_type(skylight.read_photo(photo), Photo)
    found = assert_type(skylight.estimate(taken, light="autoencoder"), Estimate)
    skylight.write_environment_map("light.exr", found.environment.rotate_azimuth(0.5))
    sun = assert_type(found.sun_direction, Tensor)
    print(found.status, sun.shape, [lamp.direction for lamp in found.lamps], found.advice)
    return assert_type(found.environment, EnvironmentMap), assert_type(found.albedo, Tensor)


def likely_light(environment: EnvironmentMap) -> Tensor:
    bundle = load_bundle()
    light, prior = bundle.light(), assert_type(bundle.prior(), GaussianMixture)
    params, scale = light.encode(environment)
    free = assert_type(light.to_free(params), Tensor)
    nats = assert_type(prior.log_prob(without_azimuth(light, free)), Tensor)
    drawn = light.from_free(torch.cat([prior.sample((4, 2)), torch.zeros(4, 2, 1)], -1))
    print(nats.item(), assert_type(light(drawn), Tensor).shape, LampsPrior(2).sample(3).shape)
    export_decoder(light, "decoder.onnx")
    return scale * assert_type(light(params), Tensor)


def fitted(light: LightModel, mesh: tuple[Tensor, Tensor], seen: Tensor) -> Tensor:
    transport = skylight.DiffuseTransport(*mesh, DirectionGrid.latlong(16))
    free = nn.Parameter(light.to_free(light.starts()[:1]))
    optimiser = torch.optim.Adam([free], lr=0.05)
    for _ in range(50):
        optimiser.zero_grad()
        shading = assert_type(transport(light(light.from_free(free)), albedo=0.5), Tensor)
        (shading - seen).square().mean().backward()  # pyright: ignore[reportUnknownMemberType]
        optimiser.step()  # pyright: ignore[reportUnknownMemberType]
    return light.from_free(free.detach())


def coded(maps: Tensor) -> Tensor:
    coder = skylight.SphericalSparseCoder("ani", height=maps.shape[-3], activations=30)
    codes = assert_type(coder(maps), CodeTensors)
    print(assert_type(coder.relative_error(maps, codes), Tensor).mean())
    return assert_type(coder.decode(coder.refit(maps, codes)), Tensor)


def through_probe(environment: EnvironmentMap) -> Tensor:
    probe = skylight.PartitionProbe(Cells.of(named_design("14d")), albedo=0.8)
    shading = assert_type(probe(environment.flat, grid=environment.grid), Tensor)
    return assert_type(probe.decode(shading, environment.grid), Tensor)


def trained(skies: Path, scene: Path) -> Path:
    best = assert_type(train(AutoencoderConfig(data=skies, out=Path("run"))), Path)
    probe = skylight.read_environment_map("light.exr")
    picture = relight(load_scene(scene), probe.radiance.numpy())
    print(best, picture.shape, skylight.SunSky(32)(skylight.SunSky(32).starts()).shape)
    return best
