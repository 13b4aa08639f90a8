"""A model of places of one's own: read from its folder or file, estimated with, and refused."""

import pickle
from pathlib import Path

import pytest
import torch

from skylight.errors import InputError
from skylight.estimation._settings import EstimateSettings
from skylight.inverse._estimate import light_problems
from skylight.inverse._lamps import LampsProblem
from skylight.io._tensors import write_tensors
from skylight.models._bundle import SHIPPED, LightBundle, is_of_places, load_model
from skylight.models._manifest import PLACES
from skylight.models._sphere import Places, SphereLight, SpherePrior, shipped


@pytest.fixture(scope="module")
def outdoors_only() -> Places:
    """Of one kind of place, with fewer latents than the shipped."""
    whole = shipped()
    kind = whole.kinds.index("outdoors")
    rows = (whole.kind == kind).nonzero()[:, 0]
    return Places(
        kinds=("outdoors",),
        across=whole.across,
        control=whole.control,
        basis=whole.basis[:40].clone(),
        log_weights=whole.log_weights[rows].log_softmax(0),
        means=whole.means[rows, :40].clone(),
        precision_factors=whole.precision_factors[rows, :40, :40].clone(),
        kind=torch.zeros(len(rows), dtype=torch.int64),
        **{
            name: getattr(whole, name)[kind, None].clone()
            for name in ("log_counts", "lamp_means", "lamp_factors", "lamp_up", "lamp_ahead")
        },
    )


@pytest.fixture
def folder(outdoors_only: Places, tmp_path: Path) -> Path:
    outdoors_only.save(tmp_path / PLACES, {})
    return tmp_path


def test_a_folder_and_its_file_are_the_model(folder: Path, outdoors_only: Places) -> None:
    for model in (folder, str(folder), folder / PLACES):
        assert is_of_places(model)
        found = load_model(model)
        assert isinstance(found, Places)
        assert found.fingerprint == outdoors_only.fingerprint != shipped().fingerprint
    sent = pickle.loads(pickle.dumps(EstimateSettings(model=folder, device="cpu").with_model))
    assert sent.light == "sphere"
    assert sent.facts()["model"] == outdoors_only.fingerprint


def test_the_light_is_looked_for_among_these_places(folder: Path) -> None:
    """Also where the exposure and the place speak of kinds that the model has not got."""
    (problem,) = light_problems(
        "sphere", model=folder, exposures=[12.0], place="outdoors", device="cpu"
    )
    assert isinstance(problem, LampsProblem)
    light, prior = problem.family.light(1), problem.family.prior(1)
    assert isinstance(light, SphereLight)
    assert isinstance(prior, SpherePrior)
    assert (light.latents, prior.kinds) == (40, ("outdoors",))


@pytest.mark.parametrize("light", ["autoencoder", "sunsky", "auto"])
def test_skies_refuse_it(folder: Path, light: str) -> None:
    with pytest.raises(InputError, match=f"holds places, for --light sphere, not {light}"):
        EstimateSettings(light=light, model=folder, device="cpu")


def test_what_is_damaged_is_one_line(folder: Path, outdoors_only: Places) -> None:
    def refused(why: str) -> None:
        with pytest.raises(InputError, match=why) as caught:
            load_model(folder)
        assert str(caught.value).endswith("make one with: skylight train --config sphere")
        assert "\n" not in str(caught.value)

    whole, told = outdoors_only.tensors, {"across": "13", "kinds": "outdoors"}
    for tensors, facts, why in (
        ({}, {"across": "14"}, "of shape"),
        ({}, {"across": "1000000000"}, "1000000000 control points across"),
        ({}, {"kinds": "outdoors home"}, "lamp_ahead of shape"),
        ({"means": whole["means"][:, 1:].contiguous()}, {}, "means of shape"),
        ({"lamp_up": whole["lamp_up"] * torch.nan}, {}, "lamp_up is not made of finite"),
        ({"lamp_up": whole["lamp_up"].double()}, {}, "lamp_up is not made of finite"),
        ({"kind": whole["kind"] + 1}, {}, "components of an unknown kind"),
        ({"more": torch.ones(1)}, {}, "more"),
    ):
        write_tensors(folder / PLACES, {**whole, **tensors}, {**told, **facts})
        refused(why)
    (folder / PLACES).write_bytes(b"nothing")
    refused("holds no usable model of places")
    (folder / PLACES).unlink()
    with pytest.raises(InputError, match="no light model"):
        load_model(folder)
    with pytest.raises(InputError, match="no such file"):
        load_model(folder / PLACES)


def test_the_shipped_skies_are_not_places() -> None:
    assert not is_of_places(SHIPPED)
    assert isinstance(load_model(SHIPPED), LightBundle)
