"""Many rays through Mitsuba at once: a wavefront where it compiles kernels, else one by one."""

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from skylight.evaluation.rendered_faces.independent_render import mitsuba_variant


def radiance_along(
    scene,
    integrator,
    origins: Float[ndarray, "n s 3"],
    directions: Float[ndarray, "n s 3"],
    seed: int,
) -> Float[ndarray, "n s 3"]:
    """What ``integrator`` finds that comes along each ray, one light path each.

    The s paths of one of the n places are spread evenly (a multi-jittered s, a square number).
    """
    mi = mitsuba_variant()
    import drjit as dr

    many = origins.shape[1]
    sampler = mi.load_dict({"type": "multijitter", "sample_count": many})
    starts, ways = (x.astype(np.float32).reshape(-1, 3) for x in (origins, directions))
    if not dr.is_jit_v(mi.Float):
        found = []
        for n, (start, way) in enumerate(zip(starts.tolist(), ways.tolist(), strict=True)):
            if n % many == 0:
                sampler.seed(seed + n)
            ray = mi.RayDifferential3f(mi.Point3f(start), mi.Vector3f(way))
            found.append(integrator.sample(scene, sampler, ray)[0])
            sampler.advance()
        return np.array(found, dtype=np.float64).reshape(origins.shape)
    sampler.set_samples_per_wavefront(many)
    sampler.seed(seed, len(starts))
    rays = mi.RayDifferential3f(mi.Point3f(starts.T.copy()), mi.Vector3f(ways.T.copy()))
    found, _, _ = integrator.sample(scene, sampler, rays)
    return np.array(found, dtype=np.float64).T.reshape(origins.shape)


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
