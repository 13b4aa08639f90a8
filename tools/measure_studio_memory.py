"""Whether what the studio's server holds grows with the number of its visitors (Linux, glibc).

    python -m tools.measure_studio_memory

Eight visitors at a time, each with connections of its own: they get all files of the page, nine
refused requests each, every third uploads a small picture, every eighth asks for a voxel probe,
listens and gets all its files, or cancels (a tenth of them). After each 250 visits: resident
memory, what of C's heap is in use and what is free but kept, blocks that Python has allocated, and
objects that its collector knows. Writes ``benchmarks/results/studio-memory.json``.
"""

import argparse
import asyncio
import json
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from io import BytesIO
from pathlib import Path

import httpx
from PIL import Image
from skimage.data import coffee

from skylight.studio._server import STATIC
from tools.load.memory import resident_mb
from tools.measured import write_measured

AT_ONCE = 8
EVERY = 250  # visits


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--visits", type=int, default=1500, help="500 or more")
    parser.add_argument("--out", type=Path, default=Path("benchmarks/results/studio-memory.json"))
    options = parser.parse_args()
    begun = time.time()
    with tempfile.TemporaryDirectory(prefix="skylight-memory-") as folder:
        told = Path(folder) / "told.json"
        server = subprocess.Popen(
            [sys.executable, "-m", "tools.load.telling_server", str(told)],
            stdout=subprocess.PIPE,
            text=True,
            env={**os.environ, "OMP_NUM_THREADS": "1"},
        )
        assert server.stdout is not None
        address, rows = server.stdout.readline().strip(), []
        counts: Counter[str] = Counter()
        try:
            for visits in range(EVERY, options.visits + 1, EVERY):
                asyncio.run(_visited(address, visits, counts))
                rows.append({"visits": visits, **_asked(server.pid, told)})
        finally:
            server.terminate()
            server.wait(timeout=60)
    write_measured(
        options.out,
        name=options.out.stem,
        what="The studio's server under visitors, eight at a time; memory in 10^6 bytes",
        command=f"python -m tools.measure_studio_memory --visits {options.visits}",
        begun=begun,
        facts={"counts": dict(counts), "early": rows[1], "late": rows[-1], "samples": rows},
    )


def _asked(server: int, told: Path) -> dict[str, float]:
    time.sleep(2)  # connections end
    resident = resident_mb(server)
    told.unlink(missing_ok=True)
    os.kill(server, signal.SIGUSR1)
    while not told.exists():
        time.sleep(0.1)
    return {"resident_mb": resident, **json.loads(told.read_text())}


async def _visited(address: str, until: int, counts: Counter[str]) -> None:
    """Visits, until there were so many in all."""
    files = [file.relative_to(STATIC).as_posix() for file in STATIC.rglob("*") if file.is_file()]
    paths = [
        "/",
        *(f"/{name.removesuffix('.gz')}" for name in files),
        "/api/about",
        "/api/sky.json",
    ]
    buffer = BytesIO()
    Image.fromarray(coffee()).resize((120, 80)).save(buffer, format="JPEG")

    async def visitor() -> None:
        while counts["visits"] < until:
            counts["visits"] += 1
            chance = random.Random(counts["visits"])
            async with httpx.AsyncClient(base_url=address, timeout=600) as client:
                try:
                    await asyncio.gather(*map(client.get, paths))
                    await _visit(client, chance, buffer.getvalue(), counts)
                except httpx.ReadError:  # a connection that was just being closed as idle
                    counts["connections_lost"] += 1

    await asyncio.gather(*(visitor() for _ in range(AT_ONCE)))


async def _visit(
    client: httpx.AsyncClient, chance: random.Random, picture: bytes, counts: Counter[str]
) -> None:
    for _ in range(3):
        await client.get(f"/api/jobs/{chance.random()}")
        await client.get("/", headers={"Host": f"{chance.random()}.example"})
        await client.post("/api/jobs", json={"kind": "voxel", "probe": chance.randint(20, 10**6)})
        counts["refused"] += 3
    if chance.random() < 1 / 3:
        taken = await client.post(f"/api/photos?name={chance.random()}.jpg", content=picture)
        counts[f"uploads_{taken.status_code}"] += 1
    if chance.random() < 1 / 8:
        begun = await client.post("/api/jobs", json={"kind": "voxel", "probe": 1})
        counts[f"jobs_{begun.status_code}"] += 1
        if begun.status_code == 202:
            await _watched(client, f"/api/jobs/{begun.json()['job']}", chance.random() < 0.1)


async def _watched(client: httpx.AsyncClient, job: str, is_cancelled: bool) -> None:
    async with client.stream("GET", f"{job}/events") as stream:
        async for _ in stream.aiter_lines():
            if is_cancelled:
                break
    if is_cancelled:
        await client.delete(job)
        return
    names = [file["name"] for file in (await client.get(job)).json().get("files", [])]
    for path in (*(f"{job}/files/{name}" for name in names), f"{job}/files.zip"):
        await client.get(path)


if __name__ == "__main__":
    main()
