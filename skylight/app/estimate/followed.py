"""What following a person through a film found, kept between runs."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import torch

from skylight.cameras.turns import Link
from skylight.errors import InputError
from skylight.faces.detection.mediapipe_face import to_ibug
from skylight.faces.film.follow import Followed, Keyframe, Shot
from skylight.faces.landmarks import DetectedFace
from skylight.io.files import write_png
from skylight.io.tensors import read_tensors, write_tensors

FOLLOWING = "following"  # the folder in that of the results
FOLLOWED = "followed.safetensors"
_FACTS = "facts"


def write_followed(folder: Path, followed: Followed) -> None:
    """followed.safetensors, and a picture of each keyframe that has no file of its own."""
    shot, pictures, readings = followed.shot, [], []
    for keyframe in shot.keyframes:
        assert keyframe.face.readings is not None  # MediaPipe's
        readings.append(keyframe.face.readings)
        if isinstance(keyframe.picture, Path):
            pictures.append(str(keyframe.picture.resolve()))
        else:
            pictures.append(f"keyframe_{keyframe.number:06d}.png")
            write_png(folder / pictures[-1], keyframe.picture)
    counts = [len(link.before) for link in shot.links]
    none = np.zeros((0, 2))
    facts = {
        "pictures": pictures,
        "size": followed.size,
        "frames": followed.frames,
        "end_s": followed.end_s,
        "notes": followed.notes,
        "shot": [shot.first, shot.begin_s, shot.end_s, shot.seen_s],
        "gaps": shot.gaps,
    }
    tensors = {
        "readings": np.array(readings),
        "scores": np.array([one.face.score for one in shot.keyframes]),
        "numbers": np.array([one.number for one in shot.keyframes]),
        "times_s": np.array([one.time_s for one in shot.keyframes]),
        "links": np.array([[link.start, link.end] for link in shot.links]).reshape(-1, 2),
        "counts": np.array(counts, dtype=np.int64),
        "before": np.concatenate([none, *(link.before for link in shot.links)]),
        "after": np.concatenate([none, *(link.after for link in shot.links)]),
    }
    write_tensors(
        folder / FOLLOWED,
        {name: torch.from_numpy(array) for name, array in tensors.items()},
        {_FACTS: json.dumps(facts)},
    )


def read_followed(folder: Path) -> Followed:
    """What :func:`write_followed` wrote; pictures are their files.

    Raises
    ------
    InputError
        It is damaged.
    """
    try:
        tensors, metadata = read_tensors(folder / FOLLOWED)
        arrays = {name: tensor.numpy() for name, tensor in tensors.items()}
        return _followed(folder, arrays, json.loads(metadata[_FACTS]))
    except (OSError, ValueError, KeyError, IndexError, TypeError, AttributeError, OverflowError,
            RecursionError) as error:  # fmt: skip
        reason = " ".join(str(error).split())
        raise InputError(
            f"{folder / FOLLOWED}: damaged ({reason}); delete {folder}, and the film is followed "
            "again"
        ) from error


def _followed(folder: Path, arrays: dict[str, np.ndarray], facts: dict[str, Any]) -> Followed:
    """What arrays and facts say; any error of a look-up, type or value where they cannot be."""
    first, begin_s, end_s, seen_s = facts["shot"]
    shot = Shot(
        first=first,
        begin_s=begin_s,
        end_s=end_s,
        seen_s=seen_s,
        gaps=[(begin, end) for begin, end in facts["gaps"]],
    )
    for k, picture in enumerate(facts["pictures"]):
        readings = arrays["readings"][k]
        face = DetectedFace(
            points=to_ibug(readings.mean(0)),
            score=float(arrays["scores"][k]),
            readings=readings,
        )
        shot.keyframes.append(
            Keyframe(
                number=int(arrays["numbers"][k]),
                time_s=float(arrays["times_s"][k]),
                face=face,
                picture=folder / picture,
            )
        )
    begin = 0
    for (start, end), count in zip(arrays["links"], arrays["counts"], strict=True):
        rows = slice(begin, begin + int(count))
        begin += int(count)
        shot.links.append(
            Link(
                start=int(start),
                end=int(end),
                before=arrays["before"][rows],
                after=arrays["after"][rows],
            )
        )
    width, height = facts["size"]
    return Followed(
        shot=shot,
        size=(width, height),
        frames=facts["frames"],
        end_s=facts["end_s"],
        notes=tuple(facts["notes"]),
    )
