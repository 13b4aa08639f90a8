"""Logs of a run: curves, TensorBoard, reconstructions."""

from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float, UInt8
from torch import Tensor

from skylight.imaging.colour import tone_map
from skylight.io.files import write_png
from skylight.io.json_files import write_json
from skylight.models.networks.base import SkyNetwork
from skylight.work.progress import Tell

SHOWN = 8  # validation skies
WHITE = 1.5  # shown as full white; skies have mean luminance 1, clear ones most of it in the sun


class Logs:
    """Writes ``curves.json``, ``reconstructions/*.png`` and, where installed, TensorBoard's logs.

    ``step`` is where the run goes on: TensorBoard hides what an earlier one logged beyond it.
    """

    def __init__(
        self,
        out: Path,
        validation: Float[np.ndarray, "m h w 3"],
        *,
        facts: dict[str, Any],
        step: int,
        report: Tell,
    ) -> None:
        self.out, self.facts, self.report = out, facts, report
        self.truth = spread(validation)
        (out / "reconstructions").mkdir(exist_ok=True)
        self.board = _tensorboard(out / "tensorboard", step, report)

    def epoch(self, network: SkyNetwork, curves: list[dict[str, int | float]], best: float) -> None:
        """Log the last of ``curves``, an entry per epoch."""
        last = curves[-1]
        step = int(last["step"])
        write_json(self.out / "curves.json", {**self.facts, "curves": curves})
        picture = reconstructions(network, self.truth)
        write_png(self.out / "reconstructions" / f"epoch_{len(curves):04d}.png", picture)
        if self.board:
            for name in ("train", "validation", "denoising"):
                self.board.add_scalar(f"loss/{name}", last[name], step)
            for name in ("learning_rate", "images_per_s"):
                self.board.add_scalar(name, last[name], step)
            self.board.add_image("reconstructions", picture, step, dataformats="HWC")
            self.board.flush()
        self.report(
            f"epoch {len(curves)}  train {last['train']:.4f}  validation "
            f"{last['validation']:.4f}  corrupted {last['denoising']:.4f}  best {best:.4f}  "
            f"{last['images_per_s']:.0f} images/s"
        )

    def close(self) -> None:
        if self.board:
            self.board.close()


def spread(
    skies: Float[np.ndarray, "m h w 3"] | Float[Tensor, "m h w 3"],
) -> Float[Tensor, "n h w 3"]:
    """At most :data:`SHOWN` skies, evenly spread over all."""
    fixed = np.linspace(0, len(skies) - 1, min(SHOWN, len(skies))).round().astype(int)
    return torch.as_tensor(skies[fixed])


@torch.no_grad()
def reconstructions(
    network: SkyNetwork, truth: Float[Tensor, "n h w 3"]
) -> UInt8[np.ndarray, "_ _ 3"]:
    """Truth over reconstruction, 2h x nw pixels, under one exposure."""
    network.eval()
    device = next(network.parameters()).device
    again = network.decode(network.encode(truth.to(device))).cpu()
    rows = [torch.cat(list(skies), 1) for skies in (truth, again)]
    return tone_map(torch.cat(rows), white=WHITE)


def _tensorboard(folder: Path, step: int, report: Tell) -> Any:
    try:
        from torch.utils.tensorboard import SummaryWriter
    except ImportError:
        report("no TensorBoard logs: install tensorboard for them (pip install 'skylight[train]')")
        return None
    return SummaryWriter(str(folder), purge_step=step + 1)
