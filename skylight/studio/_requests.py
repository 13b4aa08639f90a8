"""Strict validation of the JSON bodies of POST /api/jobs, and of edited lamps."""

from typing import Annotated, Literal, get_args

from fastapi.exceptions import RequestValidationError
from pydantic import BaseModel, ConfigDict, Field

from skylight._names import BuiltinName, LightName, Place

LIGHTS: dict[LightName, str] = {
    "sphere": "Any place, all round",
    "autoencoder": "Learnt skies",
    "sunsky": "Preetham's sky and a sun",
    "lamps": "Lamps in ambient light",
    "auto": "Learnt skies or lamps, whichever is likelier",
    "sh9": "Spherical harmonics, 9 coefficients",
    "sh25": "Spherical harmonics, 25 coefficients",
}
PLACES: dict[Place, str] = {
    "auto": "Any place",
    "outdoors": "Outdoors",
    "indoors": "Indoors",
    "flash": "Flash on the camera",
}
DICTIONARIES: dict[BuiltinName, str] = {
    "ani": "Soft patches, round or long",
    "iso": "Soft round patches",
    "vmf": "Soft round patches of one width",
    "box": "Soft patches and sharp panels",
}

Token = Annotated[str, Field(max_length=64)]


class _Request(BaseModel):
    model_config = ConfigDict(strict=True, extra="forbid", frozen=True, allow_inf_nan=False)


class EstimateRequest(_Request):
    """The light of an uploaded photograph."""

    kind: Literal["estimate"]
    photo: Token
    face: Annotated[int, Field(ge=1, le=1000)] | Literal["all"] = 1
    light: LightName | None = None
    """None: the studio's default."""
    place: Place = "auto"


class PortraitRequest(_Request):
    """The person of an estimate that is done, taken apart for a page that moves the sun."""

    kind: Literal["portrait"]
    job: Token


class _LitRequest(_Request):
    """With a light: an uploaded map, or the result of an estimate."""

    map: Token | None = None
    job: Token | None = None


class CodeRequest(_LitRequest):
    """A map of light as a sparse code."""

    kind: Literal["code"]
    dictionary: BuiltinName = "ani"
    activations: Annotated[int, Field(ge=1, le=256)] = 64


class VoxelRequest(_LitRequest):
    """A star-shaped voxel probe for the printer, and how it would look in a light."""

    kind: Literal["voxel"]
    probe: Literal[1, 3, 5, 7] = 3
    face_mm: Annotated[float, Field(gt=0, le=200)] = 20.0
    wall_mm: Annotated[float, Field(gt=0, le=50)] = 1.6


class PartitionsRequest(_LitRequest):
    """A partition probe for the printer, and how it would look in a light."""

    kind: Literal["partitions"]
    design: Annotated[str, Field(max_length=64)]
    size_mm: Annotated[float, Field(gt=0, le=1000)] | None = None


class LampsEdit(BaseModel):
    """An estimate's lamps, in its order: where each is now, and whether it is on."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)
    azimuth_deg: list[Annotated[float, Field(ge=-360, le=360)]]
    zenith_deg: list[Annotated[float, Field(ge=0, le=180)]]
    on: list[bool]
    ambient: bool
    download: bool = False


JobRequest = Annotated[
    EstimateRequest | PortraitRequest | CodeRequest | VoxelRequest | PartitionsRequest,
    Field(discriminator="kind"),
]
_KINDS = {
    kind
    for request in get_args(get_args(JobRequest)[0])
    for kind in get_args(request.model_fields["kind"].annotation)
}


def what_is_wrong(error: RequestValidationError) -> str:
    """The first fault of a request, in one line."""
    first = error.errors()[0]
    if first["type"] == "json_invalid":
        return "the request is no JSON"
    _, *inside = first["loc"]  # of the body, the query or the path
    # pydantic names the branch that it took
    place = ".".join(str(part) for part in inside if part not in _KINDS)
    return f"{place or 'the request'}: {first['msg']}"
