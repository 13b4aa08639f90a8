import json
import os
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest
import torch
import torch.distributed as dist
from safetensors.torch import load_file
from torch import nn

from skylight.errors import InputError
from skylight.models._bundle import load_network
from skylight.models._convolutional import ConvolutionalAutoencoder
from skylight.training._autoencoder import train
from skylight.training._config import AutoencoderConfig, config_yaml
from skylight.training._processes import (
    Processes,
    SharedBatchNorm,
    processes,
    share_batch_statistics,
)

ROOT = Path(__file__).parents[2]
CPU = torch.device("cpu")


@pytest.fixture
def group() -> Iterator[None]:
    """A group of one, so that the collectives can be called."""
    dist.init_process_group("gloo", store=dist.HashStore(), rank=0, world_size=1)
    yield
    dist.destroy_process_group()


def torchrun(count: int, *command: str | Path) -> subprocess.CompletedProcess[str]:
    launcher = ["-m", "torch.distributed.run", "--standalone", "--nproc-per-node", str(count)]
    return subprocess.run(
        [sys.executable, *launcher, *command],
        cwd=ROOT,
        env={**os.environ, "OMP_NUM_THREADS": "1"},
        capture_output=True,
        text=True,
        timeout=120,
    )


@pytest.mark.slow
def test_two_processes_train_as_one(sky_folder: Path, tmp_path: Path) -> None:
    """The same curves to 1e-4 and the same network to 1e-3, with augmentation and batch norm.

    Float32 sums in another order differ by 1e-7, which a few small steps leave small; statistics
    of each process alone would change the loss by 3 %. Without a sun head, whose search for the
    best of many lobes turns rounding into another lobe.
    """
    config = AutoencoderConfig(
        data=sky_folder,
        out=tmp_path / "one",
        epochs=2,
        batch=6,
        network="convolutions",
        optimiser="sgd",
        learning_rate=0.002,
        warmup_steps=1,
        tint=0.1,
        sun=False,
        bfloat16=False,
        device="cpu",  # which two processes can share
    )
    train(config, report=lambda _: None)
    two = replace(config, out=tmp_path / "two")
    two.out.mkdir()
    recipe = two.out / "run.yaml"
    recipe.write_text(config_yaml(two))
    done = torchrun(2, ROOT / "train.py", recipe)
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("best network") == done.stdout.count("epoch 2 ") == 1
    assert len(list((two.out / "tensorboard").iterdir())) == 1  # of the first alone
    one_curves, two_curves = (
        json.loads((c.out / "curves.json").read_text()) for c in (config, two)
    )
    assert (one_curves["processes"], two_curves["processes"]) == (1, 2)
    for ours, theirs in zip(two_curves["curves"], one_curves["curves"], strict=True):
        for name in ("step", "train", "validation", "learning_rate"):
            assert ours[name] == pytest.approx(theirs[name], rel=1e-4), name
    whole = load_file(config.out / "model.safetensors")
    for name, weight in load_file(two.out / "model.safetensors").items():
        torch.testing.assert_close(weight, whole[name], rtol=1e-3, atol=1e-3)


GROUP_OF_TWO = """
import os
import torch
from skylight.training._processes import processes

def workers():
    tasks = os.listdir("/proc/self/task")
    return sum("runloop" in open(f"/proc/self/task/{t}/comm").read() for t in tasks)

with processes("cpu") as here:
    network = torch.nn.Conv2d(3, 2, 2).to(memory_format=torch.channels_last)
    weight = torch.arange(24.0).reshape(2, 3, 2, 2)
    network.weight.grad = (weight + here.rank).to(memory_format=torch.channels_last)
    network.bias.grad = torch.tensor([1.0, -3.0]) * (1 + here.rank)
    here.mean_gradients(network)
    here.meet()
    assert torch.equal(network.weight.grad, weight + 0.5)
    assert network.bias.grad.tolist() == [1.5, -4.5]
    assert workers() > 0
assert workers() == 0
"""


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="counts threads in /proc")
def test_a_group_ends_with_its_threads(tmp_path: Path) -> None:
    """One that outlives its group aborts a process that ends while it frees a tensor."""
    script = tmp_path / "group.py"
    script.write_text(GROUP_OF_TWO)
    done = torchrun(2, script)
    assert done.returncode == 0, done.stderr


def test_a_batch_that_does_not_divide(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"`batch` of 4 .* 3 processes"):
        Processes(rank=0, size=3, device=CPU).share(4)
    shares = [Processes(rank=rank, size=2, device=CPU).share(6) for rank in range(2)]
    assert [list(range(6))[s] for s in shares] == [[0, 1, 2], [3, 4, 5]]


def test_a_device_that_is_not_there() -> None:
    with pytest.raises(InputError), processes("cuda:99"):
        pass


@pytest.mark.parametrize(
    ("ours", "shape"), [(nn.BatchNorm2d, (6, 5, 4, 3)), (nn.BatchNorm1d, (7, 5))]
)
@pytest.mark.parametrize(("spread", "level"), [(3.0, 40.0), (0.01, 0.0)])  # eps matters to these
@pytest.mark.usefixtures("group")
def test_shared_batch_norm_is_torchs(
    ours: type[nn.Module], shape: tuple[int, ...], spread: float, level: float
) -> None:
    """Output, gradients and running statistics, in training and then in evaluation."""
    generator = torch.Generator().manual_seed(0)
    plain = nn.Sequential(ours(5))
    nn.init.uniform_(plain[0].weight, 0.5, 2, generator=generator)
    nn.init.uniform_(plain[0].bias, -1, 1, generator=generator)
    shared = nn.Sequential(ours(5))
    shared.load_state_dict(plain.state_dict())
    share_batch_statistics(shared)
    assert isinstance(shared[0], SharedBatchNorm)
    slope = torch.randn(shape, generator=generator)
    for mode in (True, True, False):
        x = torch.randn(shape, generator=generator) * spread + level
        inputs = [x.clone().requires_grad_() for _ in range(2)]
        for module, value in zip((plain, shared), inputs, strict=True):
            module.zero_grad()
            module.train(mode)
            (module(value) * slope).sum().backward()
        torch.testing.assert_close(inputs[1].grad, inputs[0].grad, rtol=1e-4, atol=4e-4 / spread)
        for a, b in zip(shared.parameters(), plain.parameters(), strict=True):
            torch.testing.assert_close(a.grad, b.grad, rtol=1e-4, atol=1e-3)
        assert shared.state_dict().keys() == plain.state_dict().keys()
        for name, value in plain.state_dict().items():
            torch.testing.assert_close(shared.state_dict()[name], value, rtol=1e-5, atol=1e-5)


def test_all_begin_with_the_weights_and_buffers_of_the_first(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(dist, "broadcast", lambda tensor, src: tensor.fill_(7 + src))
    network = nn.Sequential(nn.Linear(2, 3), nn.BatchNorm1d(3))
    Processes(rank=1, size=2, device=CPU).share_weights(network)
    assert all(bool((each == 7).all()) for each in network.state_dict().values())


def test_every_batch_norm_of_the_network_is_shared() -> None:
    network = ConvolutionalAutoencoder()
    before = network.state_dict()
    count = sum(isinstance(m, nn.BatchNorm1d | nn.BatchNorm2d) for m in network.modules())
    assert count == 9
    share_batch_statistics(network)
    assert sum(isinstance(m, SharedBatchNorm) for m in network.modules()) == count
    assert not any(isinstance(m, nn.BatchNorm1d | nn.BatchNorm2d) for m in network.modules())
    after = network.state_dict()
    assert after.keys() == before.keys()
    assert all(torch.equal(after[name], before[name]) for name in before)


@pytest.mark.parametrize("affine", [True, False])
@pytest.mark.parametrize("size", [(6, 3), (6, 3, 5)])
def test_any_batch_normalisation_of_one_process_is_torchs(
    group: None, affine: bool, size: tuple[int, ...]
) -> None:
    x = torch.randn(size, generator=torch.Generator().manual_seed(0))
    holder = nn.Sequential(nn.BatchNorm1d(3, affine=affine))
    expected = holder(x)
    share_batch_statistics(holder)
    torch.testing.assert_close(holder(x), expected)
    for own in (nn.BatchNorm1d(3, momentum=None), nn.BatchNorm1d(3, track_running_stats=False)):
        with pytest.raises(InputError, match="does not train in several processes"):
            share_batch_statistics(nn.Sequential(own))


@pytest.mark.slow
def test_two_processes_train_a_network_of_ones_own(sky_folder: Path, tmp_path: Path) -> None:
    place = "tests.own_network:TinyNetwork"
    config = AutoencoderConfig(
        data=sky_folder, out=tmp_path / "run", network=place, latents=8, batch=8, epochs=1
    )
    path = tmp_path / "run.yaml"
    path.write_text(config_yaml(config))
    run = torchrun(2, "train.py", path)
    assert run.returncode == 0, run.stderr
    load_network(config.out / "model.safetensors", place)
    assert json.loads((config.out / "curves.json").read_text())["processes"] == 2
