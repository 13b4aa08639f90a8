"""A loss compiled into one graph, and a light model exported for other programs.

python examples/compile_and_export.py
"""

import torch

import skylight
from skylight.transport import DiffuseTransport

SKY, NORMALS = skylight.SunSky(16), skylight.DirectionGrid.latlong(16).directions.float()
ALL = torch.ones(len(NORMALS), len(SKY.grid), dtype=torch.bool)
BALL = DiffuseTransport(ALL, NORMALS, SKY.grid).freeze()
TRUE = torch.tensor([[0.3, 0.4, 0.6, 3.0, 2.7, 2.4, 0.7, 0.9, 3.0, 60.0]])


def fit(backend: str = "inductor") -> torch.Tensor:
    shown, free = BALL(SKY(TRUE)) + 0.01, torch.nn.Parameter(SKY.to_free(SKY.starts()[1:2]))

    @torch.compile(fullgraph=True, backend=backend)
    def loss(free: torch.Tensor) -> torch.Tensor:
        return ((BALL(SKY(SKY.from_free(free))) + 0.01) / shown).log().abs().mean()

    optimiser = torch.optim.Adam([free], lr=0.03)
    for _ in range(200):
        optimiser.zero_grad()
        loss(free).backward()
        optimiser.step()
    return SKY.from_free(free.detach())


def write(file: str) -> None:
    two, sizes = (TRUE.expand(2, -1),), ({0: torch.export.Dim("batch")},)
    torch.export.save(torch.export.export(SKY, two, dynamic_shapes=sizes), file)


if __name__ == "__main__":
    print("true", TRUE, "found", fit(), sep="\n")
    write("sky.pt2")
