"""Train a sky autoencoder with a logger of your own beside TensorBoard's.

    skylight skies simulate --days 30 --out SKIES
    python examples/training_logger.py SKIES OUT

Writes OUT/log.csv: the loss of every step, and the validation loss of every epoch.
"""

import csv
import sys
from pathlib import Path

from skylight.training import AutoencoderConfig, Callback, Epoch, Run, TensorBoard, train


class CSVLogger(Callback):
    def on_start(self, run: Run) -> None:
        self.file = (run.config.out / "log.csv").open("a", newline="")
        self.rows = csv.writer(self.file)

    def on_step(self, step: int, loss: float) -> None:
        self.rows.writerow([step, "step", loss])

    def on_epoch(self, epoch: Epoch) -> None:
        self.rows.writerow([epoch.step, "validation", epoch.metrics["validation"]])

    def close(self) -> None:
        self.file.close()


if __name__ == "__main__":
    skies, out = map(Path, sys.argv[1:])
    config = AutoencoderConfig(data=skies, out=out, epochs=1, batch=4)
    train(config, callbacks=[CSVLogger(), TensorBoard()])
