"""``skylight faces``: faces under known illumination, rendered or captured."""

from pathlib import Path
from typing import Literal

import tyro
from tyro.conf import Positional

from skylight._options import who_works
from skylight.errors import InputError

# A test compares them with the options' own.
Skies = Literal["simulated", "hosek-wilkie"]
Backgrounds = Literal["mixed", "infinite"]

faces = tyro.extras.SubcommandApp()


@faces.command(name="render")
def render_faces(
    out: Path,
    count: int = 150,
    size: int = 288,
    samples: int = 64,
    seed: int = 0,
    per_scene: int = 1,
    hair: bool = False,
    sunny: bool = False,
    skies: Skies = "simulated",
    maps: Path | None = None,
    light_seed: int | None = None,
    backgrounds: Backgrounds = "mixed",
    workers: int = 0,
    cluster: str | None = None,
) -> None:
    """Render people by path tracing, each with the light that was there; a stopped run goes on.

    Every face gets a folder: picture.png (8-bit sRGB), picture.exr (linear), probe.exr (the light
    in the picture's units and the camera's frame), mesh.npz and face.json (camera, albedo, tone,
    seed). Needs the extra 'render'.

    Args:
        out: Folder for the faces.
        count: How many faces.
        size: Side of a picture, pixels.
        samples: Light paths per pixel.
        seed: Others give other people and skies.
        per_scene: So many faces in a row share sky, ground, camera direction and exposure.
        hair: Give heads a cap of hair that casts shadow and hides the scalp.
        sunny: Only skies whose sun is visible.
        skies: 'simulated' ones have clouds; 'hosek-wilkie' are clear ones of Hosek & Wilkie 2013,
            of turbidities 2 to 8, independent of the simulator that light models are trained on.
        maps: Folder of lat-long maps (.exr, .hdr): scene i is lit by map i modulo their count, in
            the order of their names, turned about the vertical at random, instead of by a sky.
        light_seed: The light of this other seed on the people, poses and cameras of --seed: the
            same pictures in another light.
        backgrounds: 'mixed' ones are those of photographs: the place at a finite depth, out of
            focus, walls, backdrops, screens, cut-outs and frames; 'infinite' is the light itself,
            sharp and infinitely far away, as older folders have it.
        workers: Processes that work at the same time; 0 for one per core.
        cluster: A dask scheduler's address, whose workers do it instead.
    """
    for name, value, least in (
        ("count", count, 1),
        ("size", size, 32),
        ("samples", samples, 1),
        ("seed", seed, 0),
        ("per-scene", per_scene, 1),
    ):
        if value < least:
            raise InputError(f"--{name} must be {least} or more, got {value}")
    if sunny and (maps is not None or skies != "simulated"):
        other = "--maps" if maps is not None else f"--skies {skies}"
        raise InputError(f"--sunny chooses among simulated skies: leave it out with {other}")
    if maps is not None and skies != "simulated":
        raise InputError(f"--maps replaces the skies: leave out --skies {skies}")
    if light_seed is not None and light_seed < 0:
        raise InputError(f"--light-seed must be 0 or more, got {light_seed}")
    who = who_works(workers, cluster, out)
    from skylight.people._files import render_folder
    from skylight.people._light import RenderOptions
    from skylight.people._maps import MapFolder
    from skylight.work._progress import stage_bar, with_time_left

    options = RenderOptions(
        size=size,
        samples=samples,
        seed=seed,
        per_scene=per_scene,
        hair=hair,
        sunny=sunny,
        skies=skies,
        maps=None if maps is None else MapFolder.read(maps),
        light_seed=light_seed,
        backgrounds=backgrounds,
    )
    with stage_bar() as progress:
        made = render_folder(
            out,
            count,
            options,
            workers=who,
            progress=with_time_left("face", progress),
        )
    print(f"{out}: {count} faces, {made} of them rendered now")


@faces.command(name="calibrate-azimuth")
def calibrate_azimuth(
    data: Positional[Path],
    choose: tuple[str, ...] = (),
    auto: bool = False,
) -> None:
    """Find how far each light probe is turned against its photograph, by the face in it.

    DATA holds captures.csv with the columns photo, probe, azimuth_deg, visible_sun and person.
    For every photograph without an azimuth, DATA/azimuth gets a picture: how well the face relit
    by the probe fits the photograph for each azimuth, and the local minima, numbered, with the
    relit face of each. Look at it and choose; the choice is written into captures.csv.

    Args:
        data: Folder of captures.
        choose: PHOTO=N, several of them if you like: minimum N is right for PHOTO.
        auto: Take the best minimum of each photograph that has no azimuth.
    """
    from skylight.people._azimuth import (
        choose as write_choice,
        parse_choices,
        picture_path,
        propose,
    )
    from skylight.work._progress import stage_bar, with_time_left

    for photo, azimuth_deg in write_choice(data, parse_choices(choose)).items() if choose else ():
        print(f"{photo}: {azimuth_deg:+g} degrees")
    if choose and not auto:
        return
    with stage_bar() as progress:
        found, problems = propose(data, with_time_left("photograph", progress))
    if auto:
        for photo, azimuth_deg in write_choice(data, dict.fromkeys(found, 1)).items():
            print(f"{photo}: {azimuth_deg:+g} degrees, the best of its minima")
    else:
        for photo, proposal in found.items():
            pairs = zip(proposal.azimuths_deg, proposal.errors, strict=True)
            listed = ", ".join(f"{n}: {a:+.0f} ({e:.3f})" for n, (a, e) in enumerate(pairs, 1))
            print(f"{photo}: {listed}; {picture_path(data, photo)}")
    if problems:
        raise InputError(
            f"{len(problems)} of {len(problems) + len(found)} photographs got no azimuth: "
            + "; ".join(problems.values())
        )
    if not found:
        print(f"{data}: every photograph has an azimuth; empty its azimuth_deg to find it anew")
