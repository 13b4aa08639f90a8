"""The summary of a stitched light probe: a line, warnings, and JSON."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from skylight import __version__
from skylight.app.probes.panorama.brackets import Bracket
from skylight.cameras.response import Response, describe_response
from skylight.probes.panorama.panorama import Panorama
from skylight.probes.panorama.shots import Shot

_UNSEEN = 0.005  # share of the sphere below which a gap is no news
_GOOD_PX = 2.0
_NAMED_MOST = 5


@dataclass(frozen=True, kw_only=True)
class Stitched:
    """A panorama, the files it is of, and the response that they were linearised by."""

    brackets: tuple[Bracket, ...]
    shots: tuple[Shot, ...]
    panorama: Panorama
    response: Response | None

    @property
    def rms_px(self) -> float:
        """Of the matches, in pixels of the pictures as they were taken."""
        return self.panorama.bundle.rms_px / self.shots[0].scale

    @property
    def focal_px(self) -> float:
        """In pixels of the pictures as they were taken."""
        return self.panorama.bundle.lens.focal_px / self.shots[0].scale


def summary(out: Path, result: Stitched) -> str:
    """The command's result in a line."""
    height, width = result.panorama.probe.environment.layout
    placed = len(result.panorama.bundle.rotations)
    return (
        f"{out / 'probe.exr'}: {width}x{height} from {placed} of {len(result.shots)} directions, "
        f"{100 * (1 - result.panorama.probe.unseen_share):.3g} % of the sphere; focal length "
        f"{result.focal_px:.0f} px, matches off by {result.rms_px:.2f} px"
    )


def warnings(result: Stitched) -> list[str]:
    """What the user should know before the map is trusted, a line each."""
    panorama, lines = result.panorama, []
    if panorama.left_out:
        lines.append(
            "left out, as they are not linked to the largest group of shots: "
            f"{_names(result, panorama.left_out)}; say where they look with --turns"
        )
    if panorama.by_hint:
        lines.append(
            f"placed by --turns alone, as they match no other shot: "
            f"{_names(result, panorama.by_hint)}"
        )
    if panorama.probe.unseen_share > _UNSEEN:
        lines.append(
            f"{100 * panorama.probe.unseen_share:.2g} % of the sphere is in no shot and was "
            "filled from what is beside it"
        )
    if panorama.bundle.rms_px > _GOOD_PX:
        lines.append(
            f"matches are off by {result.rms_px:.1f} px: the camera moved as it turned, or things "
            "are near; turn it about its lens"
        )
    if any(each.seconds is not None and len(each.files) == 1 for each in result.brackets):
        lines.append(
            "one exposure only: whatever is white in it was brighter by an unknown factor; take "
            "several, the shortest of which shows the sun"
        )
    if panorama.clipping is not None:
        lines.append(panorama.clipping.sentence())
    return lines


def describe(result: Stitched) -> dict[str, object]:
    """The content of probe.json."""
    panorama = result.panorama
    bundle = panorama.bundle
    return {
        "kind": "hdr probe",
        "source": "turning camera",
        "frame": "lat-long, skylight's: +Y is up, the centre shows where the first shot looked, "
        "or azimuth 0 of the turns that were given",
        "unit": "that of the merged files"
        if result.brackets[0].seconds is None
        else "1 saturates the longest exposure",
        "views": [
            {
                "files": [str(path) for path in bracket.files],
                "seconds": bracket.seconds,
                "world_from_camera": None
                if number not in bundle.rotations
                else bundle.rotations[number].tolist(),
                "by_hint": number in panorama.by_hint,
            }
            for number, bracket in enumerate(result.brackets)
        ],
        "response": describe_response(result.response),
        "lens": {"focal_length_px": result.focal_px, "k1": bundle.lens.k1},
        "matches": bundle.matches,
        "rms_px": result.rms_px,
        "unseen_share": panorama.probe.unseen_share,
        "clipped": None if panorama.clipping is None else asdict(panorama.clipping),
        "version": __version__,
    }


def _names(result: Stitched, numbers: Sequence[int]) -> str:
    names = [Path(result.shots[number].name).name for number in numbers[:_NAMED_MOST]]
    more = f" and {len(numbers) - _NAMED_MOST} more" if len(numbers) > _NAMED_MOST else ""
    return ", ".join(names) + more
