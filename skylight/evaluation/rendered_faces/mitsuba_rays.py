"""Many rays through Mitsuba at once: a wavefront where it compiles kernels, else one by one."""

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from skylight.evaluation.rendered_faces.independent_render import mitsuba_variant


def radiance_along(
    scene,
    integrator,
    origins: Float[ndarray, "n 3"],
    directions: Float[ndarray, "n 3"],
    seed: int,
) -> Float[ndarray, "n 3"]:
    """What ``integrator`` finds that comes along each ray, one light path each."""
    mi = mitsuba_variant()
    import drjit as dr

    sampler = mi.load_dict({"type": "independent"})
    starts, ways = origins.astype(np.float32), directions.astype(np.float32)
    if not dr.is_jit_v(mi.Float):
        sampler.seed(seed)
        rays = (
            mi.RayDifferential3f(o, d) for o, d in zip(starts.tolist(), ways.tolist(), strict=True)
        )
        found = [integrator.sample(scene, sampler, ray)[0] for ray in rays]
        return np.array(found, dtype=np.float64).reshape(-1, 3)
    sampler.seed(seed, len(starts))
    rays = mi.RayDifferential3f(mi.Point3f(starts.T.copy()), mi.Vector3f(ways.T.copy()))
    found, _, _ = integrator.sample(scene, sampler, rays)
    return np.array(found, dtype=np.float64).T


def emitted(emitter, directions: Float[ndarray, "n 3"]) -> Float[ndarray, "n 3"]:
    """The radiance that an emitter of the whole sphere has in each direction."""
    mi = mitsuba_variant()
    import drjit as dr

    from_there = -directions.astype(np.float32)
    point = dr.zeros(mi.SurfaceInteraction3f)
    if not dr.is_jit_v(mi.Float):
        found = []
        for way in from_there.tolist():
            point.wi = way
            found.append(emitter.eval(point))
        return np.array(found, dtype=np.float64).reshape(-1, 3)
    point.wi = mi.Vector3f(from_there.T.copy())
    return np.array(emitter.eval(point), dtype=np.float64).T
