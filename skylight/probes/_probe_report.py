"""What is written and said of an HDR light probe: its files, a figure, doubts and a line.

Probes merged from exposures of a mirror ball and probes stitched from the shots of a turning camera
have the same results: ``probe.exr``, ``probe.hdr``, ``probe.json`` and ``report.png``. They differ
in the pictures that the figure shows beside the map, and in some of the facts, numbers and doubts.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float, UInt8

from skylight import __version__
from skylight._figures import ACCENT, STYLE, save, show, show_probe, write_numbers
from skylight.imaging._preview import write_probe
from skylight.io._bounded import write_json
from skylight.probes._probe_map import ProbeMap
from skylight.probes.cameras._exposures import Clipping
from skylight.probes.cameras._response import Response
from skylight.sphere._envmap import luminance
from skylight.work._progress import Tell

_DARKER = 16.0  # the second exposure of the map, against the first
_LONGEST = 190  # letters of a doubt that fit on the figure


@dataclass(frozen=True, kw_only=True)
class Panel:
    """A picture of the figure, and ``curves`` on it: a colour, and points (x,y) in px.

    The centre of the first pixel is (0, 0).
    """

    title: str
    picture: UInt8[np.ndarray, "h w 3"]
    curves: Sequence[tuple[str, Float[np.ndarray, "_ 2"]]] = ()


@dataclass(frozen=True, kw_only=True)
class ProbeReport:
    """A probe and what its files, figure and lines say.

    ``facts`` go into probe.json, ``numbers`` and ``panels`` into the figure, each beside what all
    probes tell. ``own_doubts`` are those besides saturated light. ``source`` completes the sentence
    "A map of so many pixels from ...".
    """

    title: str
    source: str
    probe: ProbeMap
    clipping: Clipping | None
    facts: Mapping[str, object]
    numbers: Sequence[tuple[str, str]]
    panels: Sequence[Panel]
    own_doubts: Sequence[str]
    notes: Sequence[str] = ()

    @property
    def doubts(self) -> list[str]:
        """What the user should know before the map is trusted, a line each."""
        clipped = [] if self.clipping is None else [self.clipping.sentence()]
        return [*clipped, *self.own_doubts]

    def write(self, folder: Path) -> None:
        """Write probe.exr, probe.hdr, probe.json and report.png."""
        write_probe(folder, self.probe.environment)
        content = {
            "kind": "hdr probe",
            **self.facts,
            "unseen_share": self.probe.unseen_share,
            "clipped": None if self.clipping is None else asdict(self.clipping),
            "version": __version__,
        }
        write_json(folder / "probe.json", content)
        self._write_figure(folder / "report.png")

    def say(self, out: Path, tell: Tell, warn: Tell) -> None:
        """``warn`` of each doubt; ``tell`` the notes, and the result in a line."""
        for line in self.doubts:
            warn(line)
        height, width = self.probe.environment.layout
        for line in (*self.notes, f"{out / 'probe.exr'}: {width}x{height} from {self.source}"):
            tell(line)

    def _write_figure(self, path: Path) -> None:
        """The panels above the numbers, and beside them the map at two exposures."""
        from matplotlib import rc_context
        from matplotlib.figure import Figure

        environment = self.probe.environment
        values = luminance(environment.flat)
        white = float(values.kthvalue(round(0.85 * len(values))).values)
        with rc_context(STYLE):
            figure = Figure(figsize=(16, 10.2), dpi=120, facecolor="white")
            figure.text(0.02, 0.962, self.title, fontsize=17, fontweight="bold")
            if self.doubts:
                care = f"Take care: {self.doubts[0]}"[:_LONGEST]
                figure.text(0.02, 0.936, care, color=ACCENT, fontsize=9.5)
            grid = figure.add_gridspec(
                2, 2, width_ratios=(1, 1.55), left=0.02, right=0.98, top=0.9, bottom=0.045
            )
            left = grid[:, 0].subgridspec(len(self.panels) + 1, 1, hspace=0.16)
            for number, panel in enumerate(self.panels):
                axes = figure.add_subplot(left[number])
                show(axes, panel.picture, panel.title)
                for colour, points in panel.curves:
                    axes.plot(*points.T, color=colour, linewidth=0.9)
            clipped_sr = 0.0 if self.clipping is None else self.clipping.solid_angle_sr
            rows = [
                *self.numbers,
                ("not seen", f"{100 * self.probe.unseen_share:.2g} % of the sphere"),
                ("saturated in all exposures", f"{clipped_sr:.2g} sr"),
            ]
            write_numbers(figure.add_subplot(left[-1]), "In numbers", rows, pitch=0.085)
            for number, (title, level) in enumerate(
                (("The map", white), (f"{_DARKER:g} times darker", _DARKER * white))
            ):
                show_probe(figure.add_subplot(grid[number, 1]), environment, title, white=level)
            save(figure, path)


def exposure_number(seconds: Sequence[float]) -> tuple[str, str]:
    """The row of the figure's numbers that tells how many exposures there are, and which."""
    return "exposures", f"{len(seconds)}, {min(seconds):.3g} to {max(seconds):.3g} s"


def response_number(response: Response | None) -> tuple[str, str]:
    """The row of the figure's numbers that tells how codes were made linear."""
    return "response", "linear" if response is None else response.kind
