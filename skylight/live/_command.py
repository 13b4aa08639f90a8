"""``skylight live``: the light of a webcam or of a film as it plays."""

from __future__ import annotations

import json
import time
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro
from tyro.conf import Positional

if TYPE_CHECKING:
    from skylight.imaging._film import FilmFrame
    from skylight.live._live import Light, Timing

Decoding = tyro.conf.create_mutex_group(required=False)


def live(
    source: Positional[str],
    out: Path | None = None,
    every: int = 1,
    no_page: bool = False,
    no_browser: bool = False,
    port: int = 8601,
    gamma: Annotated[float | None, Decoding] = None,
    linear: Annotated[bool, Decoding] = False,
    benchmark: bool = False,
) -> None:
    """Show the light of a webcam, or of a film of a face, as it plays; Ctrl-C ends it.

    A page in the browser has the picture, a white, a grey and a mirror ball in the light found, and
    where the main light is, with how sure that is. Nothing leaves this machine, and nothing is
    kept but OUT.

    The largest face is followed. It is quick, not careful: `skylight
    estimate` of one frame, or of the film with --video, knows more.

    Args:
        source: A webcam's number, 0 for the first; or a film (mp4, mov, ...).
        out: Write a line of JSON a frame: time_s, frame, seen (false: no face, the last light),
            direction (towards the main light; +X right, +Y up, the camera looks along -Z),
            radius_90_deg (its 90 % credible radius), irradiance (of the main light), sh27 (all
            light as harmonics of radiance, RGB of each) and mean_luminance (of the light). A film
            then plays once; else it begins again at its end. Frames of a webcam, and of a film on
            the page, that come too late are left out.
        every: Look at one of so many frames.
        no_page: Show no page. A film goes as fast as it can.
        no_browser: Only say where the page is.
        port: Port of the page; 0 takes one that is free.
        gamma: The picture's values are light to the power of 1/GAMMA, instead of sRGB.
        linear: The picture's values are proportional to light, instead of sRGB.
        benchmark: Say at the end how many frames a second it was, and what took how long.
    """
    from skylight.io._atomic import atomic_path, require_place
    from skylight.live._live import LiveLight
    from skylight.live._page import serving
    from skylight.live._play import played, source_of

    where = source_of(source)
    if out is not None:
        require_place(out)
    found = LiveLight("linear" if linear else "srgb" if gamma is None else gamma)
    again = isinstance(where, Path) and out is None and not no_page and not benchmark
    with ExitStack() as stack:
        file = None
        if out is not None:
            file = stack.enter_context(open(stack.enter_context(atomic_path(out)), "w"))
        page, told = None, _Told()
        with suppress(KeyboardInterrupt):
            while True:
                with played(where, every=every, in_time=not no_page) as frames:
                    for frame in frames:
                        if page is None and not no_page:  # now that there is something to show
                            page = stack.enter_context(serving(port, browser=not no_browser))
                        light = found.update(frame.codes, frame.time_s)
                        told.count(light)
                        if page is not None:
                            page.show(frame, light, told.rate)
                        if file is not None:
                            print(json.dumps(line_of(frame, light)), file=file)
                if not again:
                    break
                found = LiveLight(found.decode)
    print(told.summary(found.timing if benchmark else None))
    if out is not None:
        print(f"written: {out}")


@dataclass
class _Told:
    """Frames so far and the last light; ``rate`` a second is that of the last second or so.

    A film that begins again has a new LiveLight, so what was seen is remembered here.
    """

    frames: int = 0
    seen: int = 0
    light: Light | None = None
    timed: int = 0
    begun_s: float = 0.0
    cpu_s: float = 0.0
    rate: float = 0.0
    last_s: float = 0.0

    def count(self, light: Light | None) -> None:
        """One more frame; timed are those after the first light, whose head takes longer."""
        now = time.monotonic()
        if self.frames > 0:
            passed = max(now - self.last_s, 1e-6)
            share = min(passed, 1.0)
            self.rate += share * (1 / passed - self.rate) if self.rate else 1 / passed
        self.last_s = now
        self.frames += 1
        self.timed += self.light is not None
        if light is None:
            return
        if self.light is None:
            self.begun_s, self.cpu_s = now, time.process_time()
        self.light = light
        self.seen += light.seen

    def summary(self, timing: Timing | None) -> str:
        """``timing`` is told where it is given."""
        if self.light is None:
            return "no face was seen: show one from the front, at least 60 pixels high"
        line = f"{self.seen} of {self.frames} frames with a face; last: {self.light.words}"
        if timing is None or self.timed == 0:
            return line
        count = self.timed
        wall_s, cpu_s = self.last_s - self.begun_s, time.process_time() - self.cpu_s
        landmarks, light = timing.each_ms()
        return (
            f"{line}\n{count / wall_s:.1f} frames a second; {count / cpu_s:.1f} a second of a "
            f"core's time\nof a frame {1000 * cpu_s / count:.1f} ms: landmarks and pose "
            f"{landmarks:.1f}, light {light:.1f}, the rest decoding and showing it"
        )


def line_of(frame: FilmFrame, light: Light | None) -> dict[str, object]:
    """A frame's line of ``--out``; before the first face there is no light."""
    line: dict[str, object] = {"time_s": round(frame.time_s, 4), "frame": frame.number}
    return line | ({"seen": False} if light is None else light.facts())
