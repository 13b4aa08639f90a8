"""Learn a small dictionary of spherical filters with an ordinary optimiser.

    python examples/learn_dictionary.py

The maps are sums of rotated copies of elongated lobes; the dictionary starts with round ones.
"""

import torch

import skylight
from skylight.csc import CodeTensors, anisotropic, isotropic

DEGREE, HEIGHT, ACTIVATIONS, MAPS = 8, 16, 3, 16
generator = torch.Generator().manual_seed(0)

# maps to learn from, and as many to judge by
unknown = skylight.FilterBank(anisotropic(DEGREE, 9).coefficients[[1, 4]], "unknown")
scene = CodeTensors(
    filters=torch.randint(2, (2 * MAPS, ACTIVATIONS), generator=generator),
    rotations=torch.rand(2 * MAPS, ACTIVATIONS, 3, generator=generator).double() * 3,
    weights=torch.rand(2 * MAPS, ACTIVATIONS, 3, generator=generator).double() + 0.5,
    count=torch.full((2 * MAPS,), ACTIVATIONS),
)
maps = skylight.SphericalSparseCoder(unknown, height=HEIGHT).decode(scene).detach()
known, held_out = maps.split(MAPS)

bank = skylight.FilterBank(isotropic(DEGREE, 4).coefficients[1:], "learned")
coder = skylight.SphericalSparseCoder(bank, height=HEIGHT, activations=ACTIVATIONS)
optimiser = torch.optim.Adam(coder.parameters(), lr=0.02)
errors = [coder.relative_error(held_out, coder(held_out)).mean().item()]
for epoch in range(10):
    codes = coder(known)  # which filters, and their rotations: searched for without gradient
    for _ in range(10):
        loss = coder.relative_error(known, coder.refit(known, codes)).square().mean()
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
    errors.append(coder.relative_error(held_out, coder(held_out)).mean().item())
    print(f"epoch {epoch + 1}: error {errors[-1]:.3f} on maps not seen, {errors[0]:.3f} before")
