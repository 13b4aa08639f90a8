import type { Vec3 } from "../../shared/frame";
import { pixelOf, rayThrough, times, type Pinhole, type Pixel, type Plane } from "./plane";

/** What carries the object: a rod beside the face, at its distance, or a plane. */
export type Stand = { kind: "held"; depth: number } | { kind: "plane"; plane: Plane };

/** The middle of the object's foot in the camera's frame, metres, its size in metres, and its turn. */
export interface Placement {
  foot: Vec3;
  size: number;
  turnDeg: number;
}

/** How much room an object takes in the picture, for a size of 1, and its usual size in metres. */
export interface Extent {
  width: number;
  height: number;
  usual: number;
}

const PARTS = Array.from({ length: 16 }, (_, i) => 1 - 0.05 * i); // of its usual size
const HAIR = 0.025; // metres that are kept free about the bare head
const LOSS = 0.5; // metres from the face that an object may go rather than be nothing
const COVERED = 100; // worse than any place that is free
const FRAME = 0.015; // and about the picture, as part of its shorter side

/**
 * Held beside a face, as far away as that: an object on a rod from below, in the picture and free of
 * all heads, of its usual size or smaller where it is then nearer to the face. `heads` are places of
 * the photo that the heads cover. Where faces fill the picture it is as free of them as may be.
 */
export function besideFace(camera: Pinhole, eyes: Vec3, heads: readonly Pixel[], extent: Extent): Placement {
  const depth = -eyes[2];
  const scale = camera.focal_px / depth; // pixels a metre
  const face = pixelOf(camera, eyes);
  const frame = FRAME * Math.min(camera.width, camera.height);
  const step = Math.max(2, 0.01 * scale);
  const covered = thinned(heads, step / 2);
  const freeAt = ([column, row]: Pixel, wide: number, high: number): number =>
    covered.reduce((least, [x, y]) => {
      const aside = Math.max(0, Math.abs(x - column) - wide / 2);
      const beyond = Math.max(0, Math.abs(y - row) - high / 2);
      const besideRod = y > row ? Math.abs(x - column) : Infinity;
      return Math.min(least, Math.hypot(aside, beyond), besideRod);
    }, Infinity);
  const placed = (size: number, [column, row]: Pixel): Placement => {
    const low = row + (size * extent.height * scale) / 2;
    return { foot: times(rayThrough(camera, [column, low]), depth), size, turnDeg: 0 };
  };

  let best: { cost: number; size: number; at: Pixel } | null = null;
  for (const part of PARTS) {
    const size = part * extent.usual;
    const [wide, high] = [size * extent.width * scale, size * extent.height * scale];
    const small = LOSS * (1 - part);
    for (let column = frame + wide / 2; column <= camera.width - frame - wide / 2; column += step)
      for (let row = frame + high / 2; row <= camera.height - frame - high / 2; row += step) {
        const far = Math.hypot(column - face[0], 2 * (row - face[1])) / scale + small;
        if (best && far >= best.cost) continue;
        const free = freeAt([column, row], wide, high) / scale;
        const cost = free > HAIR ? far : COVERED - free + part;
        if (cost < (best?.cost ?? Infinity)) best = { cost, size, at: [column, row] };
      }
  }
  if (best) return placed(best.size, best.at);
  return placed(PARTS.at(-1)! * extent.usual, [camera.width / 2, camera.height / 2]); // larger than the picture
}

/** On the ground beside somebody's feet, on the side with more room, within the picture. */
export function besideFeet(camera: Pinhole, eyes: Vec3, plane: Plane, size: number): Placement {
  const depth = -eyes[2];
  const scale = camera.focal_px / depth;
  const [eyeColumn] = pixelOf(camera, eyes);
  const column = eyeColumn + (eyeColumn > camera.width / 2 ? -1 : 1) * (0.4 + size) * scale;
  const margin = 1.2 * size * scale;
  const x = (Math.min(camera.width - margin, Math.max(margin, column)) - camera.principal[0]) / scale;
  const [right, up, back] = plane.normal;
  return { foot: [x, (plane.offset - right * x + back * depth) / up, -depth], size, turnDeg: -20 };
}

/** One of the places in each square of that side. */
function thinned(places: readonly Pixel[], side: number): Pixel[] {
  const kept = new Map<string, Pixel>();
  for (const place of places) kept.set(`${Math.round(place[0] / side)} ${Math.round(place[1] / side)}`, place);
  return [...kept.values()];
}
