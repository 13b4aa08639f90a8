import type { CompositeView, Pinhole, Placement } from "./view";

export interface Steered {
  view: CompositeView;
  camera: Pinhole;
  placement: Placement;
  /** The placement was changed. */
  changed: () => void;
  /** Tells a screen reader where the object is now. */
  say: (line: string) => void;
}

const FARTHEST = 200; // metres

/**
 * Where the object stands at first: its foot low in the picture, beside the face and as far away,
 * a fifth of the picture high. How far below the camera the ground lies follows from that.
 */
export function firstPlacement(camera: Pinhole, face?: readonly number[]): Placement {
  const { focal_px, width, height, principal } = camera;
  const away = Math.max(0.2, face ? -face[2]! : 1);
  const faceColumn = face ? principal[0] + (focal_px * face[0]!) / away : width / 2;
  const column = faceColumn > width / 2 ? 0.25 * width : 0.75 * width;
  const row = 0.9 * height;
  return {
    x: ((column - principal[0]) * away) / focal_px,
    z: away,
    size: (0.2 * Math.min(width, height) * away) / focal_px,
    turnDeg: -20,
    cameraHeight: ((row - principal[1]) * away) / focal_px,
  };
}

/** Moves the object by pointer and by keys. */
export function steer(canvas: HTMLCanvasElement, steered: Steered): void {
  const { view, camera, placement, changed } = steered;
  const pixel = (event: PointerEvent): [number, number] => {
    const box = canvas.getBoundingClientRect();
    return [
      ((event.clientX - box.left) / box.width) * camera.width,
      ((event.clientY - box.top) / box.height) * camera.height,
    ];
  };
  const footOf = ({ x, z, cameraHeight }: Placement): [number, number] => [
    camera.principal[0] + (camera.focal_px * x) / z,
    camera.principal[1] + (camera.focal_px * cameraHeight) / z,
  ];

  let grip: [number, number] | null = null; // from the pointer to the object's foot
  canvas.addEventListener("pointerdown", (event) => {
    const [column, row] = pixel(event);
    const foot = footOf(placement);
    const high = (camera.focal_px * placement.size) / placement.z;
    const isNear = Math.abs(column - foot[0]) < high && row - foot[1] < 0.4 * high && foot[1] - row < 1.3 * high;
    if (!isNear) return;
    grip = [foot[0] - column, foot[1] - row];
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
    const to = view.groundAt(column + grip[0], row + grip[1]);
    if (!to || to.z > FARTHEST) return;
    Object.assign(placement, to);
    changed();
  });
  for (const kind of ["pointerup", "pointercancel"] as const)
    canvas.addEventListener(kind, () => {
      grip = null;
    });

  const step = (columns: number, rows: number): void => {
    const [column, row] = footOf(placement);
    const to = view.groundAt(column + columns * camera.width, row + rows * camera.height);
    if (to && to.z <= FARTHEST) Object.assign(placement, to);
  };
  const keys: Record<string, () => void> = {
    ArrowLeft: () => step(-0.01, 0),
    ArrowRight: () => step(0.01, 0),
    ArrowUp: () => step(0, -0.01),
    ArrowDown: () => step(0, 0.01),
    "+": () => void (placement.size = Math.min(10, placement.size * 1.05)),
    "-": () => void (placement.size = Math.max(0.01, placement.size / 1.05)),
    ",": () => void (placement.turnDeg = turned(placement.turnDeg - 5)),
    ".": () => void (placement.turnDeg = turned(placement.turnDeg + 5)),
  };
  canvas.addEventListener("keydown", (event) => {
    const act = keys[event.key];
    if (!act || event.ctrlKey || event.metaKey || event.altKey) return;
    event.preventDefault();
    act();
    changed();
    const side = placement.x < 0 ? "left" : "right";
    const [away, aside, high] = [placement.z, Math.abs(placement.x), placement.size].map((m) => m.toPrecision(3));
    steered.say(
      `${away} metres away, ${aside} to the ${side}, ${high} high, turned ${Math.round(placement.turnDeg)} degrees`,
    );
  });
}

const turned = (degrees: number): number => ((((degrees + 180) % 360) + 360) % 360) - 180;
