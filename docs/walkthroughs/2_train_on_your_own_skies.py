"""
Train on your own skies
=======================

The light model that ships learnt from simulated skies. It can learn from others: from captured
panoramas of yours, or from a simulation of other weather. This page goes the whole way in
miniature.

**It is a toy**: sixteen days and a handful of epochs, so that the page builds in a minute or two.
The shipped network saw 1,750 days (:doc:`../model_card` tells how); the commands are the same.
"""

# %%
# Skies
# -----
# ``skylight skies simulate`` writes maps and an ``index.csv`` that says what each shows and to
# which split its day belongs: no day is in two, because two skies of one day are almost the same
# and would make the test too easy. Captured maps get the same index by ``skylight skies index
# FOLDER``.

import json
import subprocess
import sys
import tempfile
from pathlib import Path

import torch
from matplotlib import pyplot as plt

import skylight
from skylight._figures import show
from skylight.imaging._colour import tone_map
from skylight.models._bundle import load_bundle, load_network
from skylight.skies._index import load_skies, read_index

folder = tempfile.TemporaryDirectory()
runs = Path(folder.name)
clone = Path(skylight.__file__).parents[1]


def run(*command):
    """As typed in a shell."""
    subprocess.run([sys.executable, *map(str, command)], cwd=clone, check=True, capture_output=True)


run("-m", "skylight", "skies", "simulate", "--days", 16, "--out", runs / "skies")
records = read_index(runs / "skies")
splits = {
    split: [r for r in records if r.split == split] for split in ("train", "validation", "test")
}
print({split: len(rows) for split, rows in splits.items()})

# %%
# Each map is an upper hemisphere. For the network the sun is turned to the centre column: where
# the photographer stood is no property of a sky, so the azimuth is a parameter outside of it.

skies = load_skies(runs / "skies", splits["train"])
print(tuple(skies.shape), "skies, rows, columns, colours")
figure, axes = plt.subplots(4, 2, figsize=(10, 5.4))
some = torch.linspace(0, len(skies) - 1, 8).long()
for axis, i in zip(axes.flat, some.tolist(), strict=True):
    show(axis, tone_map(skies[i], quantile=0.95), splits["train"][i].regime)
figure.tight_layout()

# %%
# Training
# --------
# Every key of a configuration file can be given on the command line. What is not in it does not
# matter: order, noise and variation of step n follow from the seed and n, so a run that was killed
# goes on to the same weights. The loss is the thesis' solid-angle-weighted L1 on coded radiance,
# with a term that keeps the sun's energy (:doc:`../concepts/skies`).

run(
    *("train.py", "configs/sky_autoencoder.yaml", "--data", runs / "skies", "--out", runs / "toy"),
    *("--epochs", 4, "--batch", 8, "--warmup-steps", 10, "--threads", 1),
)
epochs = json.loads((runs / "toy" / "curves.json").read_text())["curves"]
figure, axis = plt.subplots(figsize=(6, 3.2))
axis.plot([e["step"] for e in epochs], [e["train"] for e in epochs], "o-", label="training")
axis.plot([e["step"] for e in epochs], [e["validation"] for e in epochs], "o-", label="validation")
axis.set(xlabel="step", ylabel="loss")
axis.legend()
figure.tight_layout()

# %%
# Skies of both kinds have scenes before them and are tinted; the network has noise on its latents
# while it trains, and none when it is validated.
#
# What it learnt
# --------------
# Skies of days that it never saw, through 64 numbers and back: by the toy and by the shipped
# network. A few hundred steps find the sun, whose five coordinates are measured rather than
# learnt, and a smooth sky around it; clouds take the other 2,450 days.

test = load_skies(runs / "skies", splits["test"])[:4]
networks = {
    "toy": load_network(runs / "toy" / "model.safetensors").eval(),
    "shipped": load_bundle().network,
}
with torch.no_grad():
    rows = {"test skies": test} | {
        name: network.decode(network.encode(test)) for name, network in networks.items()
    }
figure, axes = plt.subplots(3, len(test), figsize=(12, 3.4))
for line, (name, maps) in zip(axes, rows.items(), strict=True):
    for axis, sky, true in zip(line, maps, test, strict=True):
        white = float(true.quantile(0.97))
        show(axis, tone_map(sky, white=white), name if axis is line[0] else "")
figure.tight_layout()

# %%
# On the way to estimates
# -----------------------
# The Gaussian mixtures say which latents are likely; with them the network becomes a folder that
# ``skylight estimate --model`` and ``skylight export decoder --model`` take. ``skylight train
# FOLDER --out DIR`` does all of this page at once.

run("train.py", "configs/sky_prior.yaml", "--data", runs / "skies",
    "--checkpoint", runs / "toy" / "model.safetensors", "--out", runs / "model")  # fmt: skip
print((runs / "model" / "card.md").read_text())

# %%
# A latent space can also be walked: half way between two skies is a sky.

shipped = load_bundle().network
with torch.no_grad():
    first, last = shipped.encode(test[[0, -1]])
    between = torch.stack([torch.lerp(first, last, t) for t in (0.0, 0.25, 0.5, 0.75, 1.0)])
    walk = shipped.decode(between)
figure, axes = plt.subplots(1, 5, figsize=(12, 1.2))
for axis, sky in zip(axes, walk, strict=True):
    show(axis, tone_map(sky, quantile=0.97), "")
figure.tight_layout()
folder.cleanup()
