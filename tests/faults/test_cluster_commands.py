"""Skies, rendered faces and evaluations on a cluster, one of whose workers is killed."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

pytest.importorskip("distributed", reason="dask is not installed")

from skylight.evaluation._run import CACHE, Check, Item, measure_all
from skylight.people._files import read_rendered_face, render_folder, rendered_faces
from skylight.people._light import RenderOptions
from skylight.skies._simulated import simulate_folder
from skylight.work._cluster import Cluster
from tests.dask_cluster import DaskCluster, dask_cluster

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def dask(tmp_path_factory: pytest.TempPathFactory) -> Iterator[DaskCluster]:
    with dask_cluster(tmp_path_factory.mktemp("dask"), workers=2) as cluster:
        yield cluster


@pytest.fixture
def kill_a_worker(dask: DaskCluster) -> Callable[[int, int], None]:
    """Progress that kills one of two workers when something is done."""
    dask.keep(2)

    def progress(done: int, total: int) -> None:
        if 0 < done < total and dask.workers[0].poll() is None:
            dask.workers[0].kill()

    return progress


def test_skies(dask: DaskCluster, kill_a_worker: Callable, tmp_path: Path) -> None:
    def simulate(name: str, **how: object) -> dict[str, bytes]:
        folder = tmp_path / name
        simulate_folder(folder, days=3, interval_min=600.0, height=8, **how)  # type: ignore[arg-type]
        return {p.name: p.read_bytes() for p in folder.rglob("*") if p.is_file()}

    where = Cluster(address=dask.address, folder=tmp_path / "there")
    there = simulate("there", workers=where, progress=kill_a_worker)
    assert dask.workers[0].wait() < 0
    assert there == simulate("here", workers=1)


@dataclass(frozen=True, kw_only=True)
class Squares:
    """An evaluation of numbers."""

    name: str = "squares"
    seed: int = 0

    def config(self) -> dict[str, object]:
        return {}

    def items(self) -> list[str]:
        return [str(i) for i in range(12)]

    def measure(self, item: str, picture: Path) -> Item:
        picture.write_text(item)
        return Item(name=item, metrics={"square": {"mae": float(item) ** 2}})

    def checks(self, rows: object, items: list[Item]) -> dict[str, Check]:
        return {}


def test_evaluations(dask: DaskCluster, kill_a_worker: Callable, tmp_path: Path) -> None:
    evaluation = Squares()
    out = tmp_path / "out"
    where = Cluster(address=dask.address, folder=out)
    items = measure_all(evaluation, out, workers=where, progress=kill_a_worker)
    assert dask.workers[0].wait() < 0
    assert [item.metrics["square"]["mae"] for item in items] == [n**2 for n in range(12)]
    assert len((out / CACHE).read_text().splitlines()) == 1 + 12
    assert {p.name for p in (out / "pictures").iterdir()} == {f"{n}.png" for n in range(12)}


def test_rendered_faces(dask: DaskCluster, kill_a_worker: Callable, tmp_path: Path) -> None:
    pytest.importorskip("mitsuba", reason="mitsuba is not installed")
    options = RenderOptions(size=40, samples=4, seed=1, per_scene=2)
    where = Cluster(address=dask.address, folder=tmp_path)
    assert render_folder(tmp_path, 3, options, workers=where, progress=kill_a_worker) == 3
    assert dask.workers[0].wait() < 0
    assert [read_rendered_face(face).number for face in rendered_faces(tmp_path)] == [0, 1, 2]
