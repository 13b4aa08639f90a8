"""Work distributed over a dask cluster with a shared file system."""

import logging
import os
from asyncio import CancelledError
from collections.abc import Callable, Collection, Iterator, Sequence
from concurrent.futures import CancelledError as FutureCancelledError
from contextlib import ExitStack, closing, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar
from uuid import uuid4

import torch

from skylight import __version__
from skylight.errors import InputError, OutputError, SkylightError, not_installed
from skylight.io._atomic import PARTIAL
from skylight.work._processes import run_piece

Result = TypeVar("Result")
CONNECT_S = 30


@dataclass(frozen=True, kw_only=True)
class Cluster:
    """The workers of a dask scheduler, and the folder that their work goes to.

    ``address`` is the scheduler's (``tcp://host:8786``; ``tls://``, with the keys that dask's own
    configuration names) or the path of its scheduler file (``.json``). ``folder`` is there, and
    the workers see it under the same path.
    """

    address: str
    folder: Path


def share_on_cluster(
    work: Callable[..., Result],
    pieces: Sequence[tuple],
    cluster: Cluster,
    *,
    prepare: Callable[[], None] | None,
    lost: Callable[..., Result] | None,
) -> Iterator[Result]:
    """Results of ``work(*one)`` for each piece, as they come.

    A piece whose worker is lost goes to another one, so ``work`` may run twice and must leave the
    same files. Workers may come and go at any time; without any, this waits. ``lost`` is as in
    :func:`skylight.work._resumable.share_work`, dask's ``allowed-failures`` the number of times.
    """
    with ExitStack() as stack:
        client = stack.enter_context(closing(_connect(cluster.address)))
        from distributed import KilledWorker, as_completed

        if not client.scheduler_info(n_workers=-1)["workers"]:
            logging.getLogger(__name__).warning(
                "skylight: no worker has joined %s yet; waiting for one", cluster.address
            )
        mark = cluster.folder.absolute() / f"{PARTIAL}{uuid4().hex[:12]}"
        stack.callback(mark.unlink, missing_ok=True)
        try:
            mark.touch(exist_ok=False)
        except OSError as error:
            raise OutputError(f"cannot write into {cluster.folder}: {error.strerror}") from error
        place = _Place(here=Path.cwd(), mark=mark, version=__version__)
        futures = {
            client.submit(_run, place, prepare, work, one, pure=False): one for one in pieces
        }
        stack.callback(_forget, client, futures)  # those that are left then
        for future in as_completed(futures, loop=client.loop):
            one = futures.pop(future)
            try:
                result = future.result()
            except KilledWorker as error:
                if lost is None:
                    raise SkylightError(
                        f"workers were killed again and again while at one piece ({error}); what "
                        "is done is kept: give them more memory, and run the same command again"
                    ) from error
                result = lost(*one)
            except (CancelledError, FutureCancelledError) as error:
                raise SkylightError(
                    f"the scheduler at {cluster.address} went away; what is done is kept: "
                    "start it again, and run the same command again"
                ) from error
            # a result that somebody still holds is computed again when its worker goes
            future.release()
            yield result


@dataclass(frozen=True, kw_only=True)
class _Place:
    """Where the pieces come from; a worker must see the same files and be the same skylight."""

    here: Path
    mark: Path
    version: str


def _run(
    place: _Place, prepare: Callable[[], None] | None, work: Callable[..., Result], one: tuple
) -> Result:
    """One piece, on a worker."""
    _check_worker(place)
    torch.set_num_threads(1)  # the workers already share the cores
    return run_piece(prepare, work, one)


def _check_worker(place: _Place) -> None:
    from distributed import get_worker

    worker = get_worker()
    if worker.state.nthreads != 1:
        raise InputError(
            f"worker {worker.address} has {worker.state.nthreads} threads, and only processes "
            "compute side by side: start it with --nthreads 1 (and --nworkers for more)"
        )
    if place.version != __version__:
        raise InputError(
            f"worker {worker.address} has skylight {__version__}, not {place.version}: install "
            "the same version on both"
        )
    try:
        os.chdir(place.here)  # relative paths mean the same there
        seen = place.mark.exists()
    except OSError:
        seen = False
    if not seen:
        raise InputError(
            f"worker {worker.address} does not see {place.here} and {place.mark.parent} as they "
            "are here: put them on a file system that all machines share, at the same paths"
        )


def _connect(address: str) -> Any:
    try:
        from distributed import Client
    except ImportError as error:
        raise not_installed("distributed", "a cluster") from error
    try:
        if address.endswith(".json"):
            return Client(scheduler_file=address, timeout=CONNECT_S, set_as_default=False)
        return Client(address, timeout=CONNECT_S, set_as_default=False)
    except (OSError, ValueError, TypeError) as error:  # TypeError: TLS without keys
        raise InputError(
            f"no dask scheduler at {address} ({' '.join(str(error).split())}); start one with "
            "'dask scheduler' and give the address that it prints"
        ) from error


def _forget(client: Any, futures: Collection[Any]) -> None:
    with suppress(Exception):  # the scheduler may be gone, and that is told already
        client.cancel(list(futures), force=True)
