"""A dictionary learned from a few maps, deployed as ONNX and run without torch.

python examples/deploy_dictionary.py codes.onnx
"""

import sys

import numpy as np
import onnxruntime
import torch

from skylight import FilterBank, SphericalSparseCoder
from skylight.csc import isotropic
from skylight.maps import export_codes
from skylight.sphere import DirectionGrid

# six rooms of two soft lamps each
generator = torch.Generator().manual_seed(0)
lamps = torch.nn.functional.normalize(torch.randn(6, 2, 3, generator=generator), dim=-1).double()
grid = DirectionGrid.latlong(16)
light = torch.exp(20 * (lamps @ grid.directions.T - 1)).sum(1)
maps = light.reshape(6, 16, 32, 1) * torch.tensor([1.0, 0.8, 0.6]) + 0.1

bank = FilterBank(isotropic(8, 3).coefficients, "lamps")
coder = SphericalSparseCoder(bank, height=16, activations=4)
optimiser = torch.optim.Adam(coder.parameters(), lr=0.02)
for _ in range(20):
    codes = coder(maps)
    loss = coder.relative_error(maps, coder.refit(maps, codes)).square().mean()
    optimiser.zero_grad()
    loss.backward()
    optimiser.step()

export_codes(coder, sys.argv[1])
session = onnxruntime.InferenceSession(sys.argv[1])  # all that a program needs from here on
given = {"filters": codes.filters, "rotations": codes.rotations.float(), "weights": codes.weights}
given = {name: each.detach().float().numpy() for name, each in given.items()}
(decoded,) = session.run(["map"], given | {"filters": codes.filters.numpy()})
print("relative error", np.linalg.norm(decoded - maps.numpy()) / np.linalg.norm(maps.numpy()))
