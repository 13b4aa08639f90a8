import type { Angles } from "../api";
import { el } from "../shared/dom";

/** A lamp where it is now. */
export interface MovedLamp extends Angles {
  on: boolean;
}

export interface LampHandles {
  /** Puts the handles where the lamps are. */
  place: () => void;
}

const whole = (degrees: number): string => `${Math.round(degrees)}°`;
const placeInWords = ({ azimuth_deg, zenith_deg }: Angles): string =>
  `azimuth ${whole(Math.abs(azimuth_deg))} ${azimuth_deg < 0 ? "left" : "right"}, zenith ${whole(zenith_deg)}`;
const turned = (degrees: number): number => ((((degrees + 180) % 360) + 360) % 360) - 180;

/**
 * A handle for each lamp over a panorama: dragged, or moved by a degree with the arrow keys, by ten
 * with Shift. `moved` hears of each change of `lamps`, `said` where a lamp is that was moved by a
 * key. `named` is what a lamp is called and what its handle shows; none goes below `lowest`.
 */
export function lampHandles(
  panorama: HTMLElement,
  lamps: MovedLamp[],
  moved: () => void,
  said: (line: string) => void,
  named: (i: number) => [name: string, mark: string] = (i) => [`Lamp ${i + 1}`, String(i + 1)],
  lowest = 180,
): LampHandles {
  const upright = (degrees: number): number => Math.min(lowest, Math.max(0, degrees));
  const handles = lamps.map((lamp, i) => {
    const handle = el("button", { type: "button", class: "lamp-handle" }, named(i)[1]);
    const move = (azimuth_deg: number, zenith_deg: number): void => {
      Object.assign(lamp, { azimuth_deg: turned(azimuth_deg), zenith_deg: upright(zenith_deg) });
      place();
      moved();
    };
    let grip: [number, number] | null = null; // from the pointer to the handle's middle
    handle.addEventListener("pointerdown", (event) => {
      const box = handle.getBoundingClientRect();
      grip = [box.x + box.width / 2 - event.clientX, box.y + box.height / 2 - event.clientY];
      handle.setPointerCapture(event.pointerId);
    });
    handle.addEventListener("pointermove", (event) => {
      if (!grip) return;
      const box = panorama.getBoundingClientRect();
      move(
        ((event.clientX + grip[0] - box.x) / box.width - 0.5) * 360,
        ((event.clientY + grip[1] - box.y) / box.height) * 180,
      );
    });
    for (const kind of ["pointerup", "pointercancel"] as const)
      handle.addEventListener(kind, () => {
        grip = null;
      });
    const keys: Record<string, [number, number]> = {
      ArrowLeft: [-1, 0],
      ArrowRight: [1, 0],
      ArrowUp: [0, -1],
      ArrowDown: [0, 1],
    };
    handle.addEventListener("keydown", (event) => {
      const step = keys[event.key];
      if (!step || event.ctrlKey || event.metaKey || event.altKey) return;
      event.preventDefault();
      const by = event.shiftKey ? 10 : 1;
      move(lamp.azimuth_deg + by * step[0], lamp.zenith_deg + by * step[1]);
      said(placeInWords(lamp));
    });
    panorama.append(handle);
    return handle;
  });
  const place = (): void => {
    handles.forEach((handle, i) => {
      const lamp = lamps[i]!;
      handle.style.left = `${(lamp.azimuth_deg / 360 + 0.5) * 100}%`;
      handle.style.top = `${(lamp.zenith_deg / 180) * 100}%`;
      handle.classList.toggle("off", !lamp.on);
      handle.setAttribute(
        "aria-label",
        `${named(i)[0]}${lamp.on ? "" : ", off"}: ${placeInWords(lamp)}; arrow keys move it by a degree, with Shift by ten`,
      );
    });
  };
  place();
  return { place };
}
