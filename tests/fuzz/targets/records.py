"""JSON files that say what they are, cameras, latents, and tables: all readers on each content."""

import json
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch

from skylight.io._bounded import write_json
from skylight.io._files import read_categories
from skylight.models._ground import KnownGround, load_ground
from skylight.probes.cameras._board import Board, load_board, save_board
from skylight.probes.cameras._intrinsics import Intrinsics, load_intrinsics, save_intrinsics
from skylight.probes.cameras._response import Response, load_response, save_response
from skylight.probes.panorama._brackets import read_turns
from skylight.probes.partitions._captured import load_capture
from skylight.probes.partitions._cells import Cells
from skylight.probes.partitions._kernel_albedo import KernelAlbedo, read_albedo, save_albedo
from skylight.probes.partitions._optimise import named_design
from skylight.probes.partitions._seeds import load_design, save_design
from skylight.probes.partitions.printed._assembly import PartitionAssembly, load_partition_assembly
from skylight.probes.partitions.printed._halves import standing_rotation
from skylight.probes.partitions.printed._solids import ProbeSizes
from skylight.probes.voxel._assembly import load_voxel_assembly
from skylight.relight._decoder import read_latent
from skylight.skies._captures import read_days
from skylight.skies._index import read_index
from skylight.sphere._rotation import RigidTransform
from skylight.training._config import read_config
from skylight.transport._cameras import read_object_camera
from tests.fuzz.files import PLACE, as_file, read_by_any, written

_READERS: tuple[Callable[[Path], object], ...] = (
    load_board,
    load_intrinsics,
    load_response,
    load_design,
    load_capture,
    load_partition_assembly,
    load_voxel_assembly,
    read_latent,
    read_index,
    read_days,
    read_config,
    lambda path: read_albedo(str(path)),
    load_ground,
    lambda path: read_turns(path, 1),
    lambda path: read_categories(path.parent),
    lambda path: read_object_camera(path, height=30, width=40),
)


def seeds() -> list[bytes]:
    cells = Cells.of(named_design("6d"))
    six = torch.eye(6, dtype=torch.float64)
    standing = PartitionAssembly(
        cells=cells,
        sizes=ProbeSizes(),
        board_from_probe=RigidTransform.from_numpy(
            standing_rotation(cells), np.array([90.0, 150.0, 60.0])
        ),
        pole_mm=(90.0, 60.0, 3.0, 110.0),
        board_mm=(175.0, 125.0),
        response=six,
    )
    cell = {
        "known": True, "area_px": 9.0, "clipped": 0.0, "saturated": False, "disagreement": None,
        "shading": [0.1, 0.2, 0.3],
    }  # fmt: skip
    plain: list[Any] = [
        {"fov_deg": 36, "position": [3, 1.2, -2.6], "look_at": [0, 0, 0], "up": [0, 1, 0]},
        {"focal_px": 50.5, "center_px": [20, 15], "world_from_camera": torch.eye(4).tolist()},
        {"latent": [0.5] * 64, "exposure": 1.5, "ground_albedo": [0.1, 0.2, 0.3]},
        standing.to_json(),
        {
            "kind": "voxel probe assembly", "format": 1, "cells": [[0, 0, 0], [1, 0, 0]],
            "voxel_mm": 20.0, "rotation": torch.eye(3).tolist(), "translation_mm": [0, 90, 0],
            "pole_mm": None, "board_mm": [175, 125],
        },
        {
            "kind": "partition probe capture", "format": 1, "design": "6d", "fingerprint": "0",
            "kernel_albedo": [0.5, 0.5, 0.5], "cells": [cell, cell],
        },
    ]  # fmt: skip
    curve = torch.linspace(0, 1, 256, dtype=torch.float64).repeat(3, 1) ** 2
    power = Response(kind="curve", curve=curve.numpy())
    lens = {"width": 640, "height": 480, "fx": 500.0, "fy": 500.0, "cx": 320.0, "cy": 240.0}
    names = Intrinsics.__dataclass_fields__
    camera = Intrinsics(**{name: lens.get(name, 0.0) for name in names})  # type: ignore[arg-type]
    albedo = KernelAlbedo(rgb=curve[:, 200], error=curve[:, 9], reference="a card")
    index = (
        "file,day,time,split,regime,sun_zenith_deg,sun_azimuth_deg,map_azimuth_deg,"
        "sun_transmittance,latitude_deg,longitude_deg,seed,layout,field_deg\n"
        "a.exr,d,,train,clear,40,,0,1,,,3,skylatlong,\n"
    )
    return [
        *(json.dumps(each).encode() for each in plain),
        written("a.json", lambda path: save_board(path, Board())),
        written("a.json", lambda path: save_intrinsics(path, camera)),
        written("a.json", lambda path: save_response(path, power)),
        written("a.json", lambda path: save_response(path, Response(kind="gamma", gamma=2.2))),
        written("a.json", lambda path: save_design(path, cells.design)),
        written("a.json", lambda path: save_albedo(path, albedo)),
        written("a.json", lambda path: write_json(path, [0.25] * 64)),
        written("a.json", lambda path: KnownGround(albedo=(0.2, 0.1, 0.1)).save(path, {})),
        b"azimuth_deg,elevation_deg\n30,-10\n",
        index.encode(),
        b"file,category\na.exr,urban\n",
        b"file,day,time\na.exr,20160515,\n",
        b"kind: autoencoder\nepochs: 2\nlearning_rate: 1e-5\n",
    ]


def read(content: bytes) -> None:
    """Refused by all, or read by one of them."""
    (PLACE / "a.json").unlink(missing_ok=True)
    path = as_file(content, "index.csv")
    read_by_any(partial(reader, path) for reader in _READERS)
