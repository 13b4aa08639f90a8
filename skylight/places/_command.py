"""``skylight places``: simulate places whose light is known."""

from pathlib import Path

import tyro

from skylight._options import who_works
from skylight.errors import InputError

places = tyro.extras.SubcommandApp()


@places.command(name="simulate")
def simulate(
    count: int, out: Path, seed: int = 0, workers: int = 0, cluster: str | None = None
) -> None:
    """Simulate places as full lat-long maps with an index; an interrupted run goes on.

    Outdoors, homes, offices and shops, cars, studios, streets at night. Suns and lamps that are
    smaller than a pixel stand in lights.csv and not in the maps.

    Args:
        count: How many places; a folder that has fewer is added to.
        out: Folder for the maps, index.csv and lights.csv.
        seed: Seed of the first day, of eight places; the others follow.
        workers: Processes that work at the same time; 0 for one per core.
        cluster: A dask scheduler's address, whose workers do it instead.
    """
    if count < 1:
        raise InputError(f"--count must be above 0, got {count}")
    who = who_works(workers, cluster, out)
    from skylight.places._simulated import counts, read_places, simulate_places
    from skylight.work._progress import stage_bar, with_time_left

    with stage_bar() as progress:
        index = simulate_places(
            out,
            count=count,
            seed=seed,
            workers=who,
            progress=with_time_left("place", progress),
        )
    print(f"{index}: {counts(read_places(index))}")
