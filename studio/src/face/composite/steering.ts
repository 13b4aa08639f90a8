import type { Vec3 } from "../../shared/frame";
import { pixelOf, planeAt, rayThrough, times, type Pinhole, type Pixel } from "./plane";
import type { Placement, Stand } from "./placement";
import type { CompositeView } from "./view";

export interface Steered {
  view: CompositeView;
  camera: Pinhole;
  placement: Placement;
  /** What the object stands on now. */
  stand: () => Stand;
  /** The placement was changed. */
  changed: () => void;
  /** Tells a screen reader where the object is now. */
  say: (line: string) => void;
}

const FARTHEST = 200; // metres
const REACH = 12; // pixels of the screen about the object that still move it
/** Sizes that may be set, metres. */
export const SMALLEST = 0.01;
export const LARGEST = 10;

/** The place under a pixel that an object on the stand can have: the size in metres stays. */
export function footAt(stand: Stand, camera: Pinhole, pixel: Pixel): Vec3 | null {
  if (stand.kind === "held") return times(rayThrough(camera, pixel), stand.depth);
  const place = planeAt(stand.plane, camera, pixel);
  return place && -place[2] <= FARTHEST ? place : null;
}

/** Moves the object by pointer and by keys. */
export function steer(canvas: HTMLCanvasElement, steered: Steered): void {
  const { view, camera, placement, stand, changed } = steered;
  const pixel = (event: PointerEvent): [number, number] => {
    const box = canvas.getBoundingClientRect();
    return [
      ((event.clientX - box.left) / box.width) * camera.width,
      ((event.clientY - box.top) / box.height) * camera.height,
    ];
  };
  const moveTo = (to: Pixel): boolean => {
    const foot = footAt(stand(), camera, to);
    if (foot) placement.foot = foot;
    return foot !== null;
  };

  let grip: [number, number] | null = null; // from the pointer to the object's foot
  canvas.addEventListener("pointerdown", (event) => {
    const at = pixel(event);
    if (!view.isOnObject(at, (REACH * camera.width) / canvas.clientWidth)) return;
    const foot = pixelOf(camera, placement.foot);
    grip = [foot[0] - at[0], foot[1] - at[1]];
    canvas.setPointerCapture(event.pointerId);
  });
  canvas.addEventListener(
    "touchstart",
    (event) => {
      if (grip) event.preventDefault(); // a finger on the object moves it, beside it the page
    },
    { passive: false },
  );
  canvas.addEventListener("pointermove", (event) => {
    if (!grip) return;
    const [column, row] = pixel(event);
    if (moveTo([column + grip[0], row + grip[1]])) changed();
  });
  for (const kind of ["pointerup", "pointercancel"] as const)
    canvas.addEventListener(kind, () => {
      grip = null;
    });

  const step = (columns: number, rows: number): void => {
    const [column, row] = pixelOf(camera, placement.foot);
    moveTo([column + columns * camera.width, row + rows * camera.height]);
  };
  const keys: Record<string, () => void> = {
    ArrowLeft: () => step(-0.01, 0),
    ArrowRight: () => step(0.01, 0),
    ArrowUp: () => step(0, -0.01),
    ArrowDown: () => step(0, 0.01),
    "+": () => void (placement.size = Math.min(LARGEST, placement.size * 1.05)),
    "-": () => void (placement.size = Math.max(SMALLEST, placement.size / 1.05)),
    ",": () => void (placement.turnDeg = turned(placement.turnDeg - 5)),
    ".": () => void (placement.turnDeg = turned(placement.turnDeg + 5)),
  };
  canvas.addEventListener("keydown", (event) => {
    const act = keys[event.key];
    if (!act || event.ctrlKey || event.metaKey || event.altKey) return;
    event.preventDefault();
    act();
    changed();
    const [x, , z] = placement.foot;
    const [away, aside] = [-z, Math.abs(x)].map((m) => m.toPrecision(3));
    const size = (100 * placement.size).toPrecision(3);
    steered.say(
      `${away} metres away, ${aside} to the ${x < 0 ? "left" : "right"}, ${size} centimetres, turned ${Math.round(placement.turnDeg)} degrees`,
    );
  });
}

const turned = (degrees: number): number => ((((degrees + 180) % 360) + 360) % 360) - 180;
