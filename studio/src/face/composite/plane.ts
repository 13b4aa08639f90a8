/**
 * The plane that an object stands on, in the camera's frame (metres; the camera is at the origin,
 * looks along -Z and is level, +Y up): the ground under a head, or a rectangle seen in the photo.
 * What a user can do wrong throws an Error of one line.
 */
import type { Vec3 } from "../../shared/frame";

/** A level pinhole camera; lengths in pixels of the photo. */
export interface Pinhole {
  focal_px: number;
  width: number;
  height: number;
  principal: readonly [x: number, y: number];
}

/** All x with normal . x = offset. The unit normal points to the camera's side, so offset < 0. */
export interface Plane {
  normal: Vec3;
  offset: number;
}

/** A place of the photo in pixels, from its upper left. */
export type Pixel = readonly [column: number, row: number];

export const dot = (a: Vec3, b: Vec3): number => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
export const times = (a: Vec3, s: number): Vec3 => [a[0] * s, a[1] * s, a[2] * s];
export const less = (a: Vec3, b: Vec3): Vec3 => [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
const length = (a: Vec3): number => Math.hypot(...a);
const unit = (a: Vec3): Vec3 => times(a, 1 / length(a));
const cross = (a: Vec3, b: Vec3): Vec3 => [
  a[1] * b[2] - a[2] * b[1],
  a[2] * b[0] - a[0] * b[2],
  a[0] * b[1] - a[1] * b[0],
];
const degreesBetween = (a: Vec3, b: Vec3): number => (Math.atan2(length(cross(a, b)), dot(a, b)) * 180) / Math.PI;

/** The point of depth 1 that is seen at a pixel: K^-1 (column, row, 1), with y up and z = -1. */
export function rayThrough({ focal_px, principal }: Pinhole, [column, row]: Pixel): Vec3 {
  return [(column - principal[0]) / focal_px, (principal[1] - row) / focal_px, -1];
}

/** Where a point before the camera is seen. */
export function pixelOf({ focal_px, principal }: Pinhole, [x, y, z]: Vec3): Pixel {
  return [principal[0] - (focal_px * x) / z, principal[1] + (focal_px * y) / z];
}

/** The point of the plane that is seen at a pixel; null at and beyond the plane's horizon. */
export function planeAt(plane: Plane, camera: Pinhole, pixel: Pixel): Vec3 | null {
  const ray = rayThrough(camera, pixel);
  const depth = plane.offset / dot(plane.normal, ray);
  return depth > 0 && Number.isFinite(depth) ? times(ray, depth) : null;
}

/** Level ground, where eyes at that place (camera's frame) are `eyeHeight` metres above it. */
export function groundUnder(eyes: Vec3, eyeHeight: number): Plane {
  const offset = eyes[1] - eyeHeight;
  if (offset < 0) return { normal: [0, 1, 0], offset };
  throw new Error(
    `eyes ${eyeHeight} m over the ground would put the camera under it: it looks up at them from ${eyes[1].toFixed(2)} m below`,
  );
}

/** Whether the plane's point under another one (along the plane's normal) is within the photo. */
export function showsFootOf(plane: Plane, camera: Pinhole, above: Vec3): boolean {
  const down = dot(plane.normal, above) - plane.offset;
  const foot = less(above, times(plane.normal, down));
  if (foot[2] >= 0) return false;
  const [column, row] = pixelOf(camera, foot);
  return column > 0 && column < camera.width && row > 0 && row < camera.height;
}

/** A rectangle seen in the photo; lengths as if its plane were 1 metre from the camera. */
export interface SeenRectangle {
  normal: Vec3;
  /** From the first corner to the second. */
  side: number;
  /** How far in front of the camera its middle lies. */
  depth: number;
  /** Between the normal and the camera's up, degrees. */
  tiltDeg: number;
  /** Standard deviation of the normal's direction where each click is off by CLICK of the photo. */
  tiltErrorDeg: number;
  /** Between its sides: 90 where the clicks, and the camera's focal length, are right. */
  cornerDeg: number;
}

/** Standard deviation of a click along each axis, as part of the photo's longer side. */
export const CLICK = 0.002;
const FLATTEST = 0.01; // of three corners: twice their area / the rectangle's largest diagonal squared
const STEEPEST_DEG = 60;
const MOST_ERROR_DEG = 20;
const MOST_SKEW_DEG = 30;
const EDGE_ON = 0.03; // sine of the angle between the plane and a ray to a corner

/**
 * The plane of a rectangle whose corners are clicked one after the other, in either sense.
 *
 * With x_i = K^-1 p_i, opposite sides meet at the vanishing directions
 *
 *     d1 = (x1 x x2) x (x3 x x4),   d2 = (x2 x x3) x (x4 x x1),   n ~ d1 x d2,
 *
 * which is K^T times the vanishing line of the homography from a square (Hartley & Zisserman 2004,
 * section 8.6): four points give it 8 numbers, a plane up to its distance, a place in it and two
 * directions. That these are at right angles is not used; it is what the clicks are judged by. The
 * error is propagated through central differences of n by the eight coordinates.
 *
 * Throws where three corners are on a line, sides cross, a corner would lie behind the camera, the
 * plane is seen edge-on, from below or is a wall, or is not told by the clicks.
 */
export function planeOfRectangle(camera: Pinhole, corners: readonly Pixel[]): SeenRectangle {
  if (corners.length !== 4 || corners.flat().some((one) => !Number.isFinite(one)))
    throw new Error("a rectangle has four corners: click each of them once");
  checkShape(corners);
  const rays = corners.map((corner) => rayThrough(camera, corner));
  const { normal, d1, d2 } = normalOf(rays);
  if (rays.some((ray) => dot(normal, unit(ray)) > -EDGE_ON))
    throw new Error("these corners show a plane edge-on: take one that is seen more from above");
  const tiltDeg = degreesBetween(normal, [0, 1, 0]);
  if (tiltDeg > 180 - STEEPEST_DEG) throw new Error("this plane is seen from below: nothing can stand on it");
  if (tiltDeg > STEEPEST_DEG)
    throw new Error(
      `this plane is tilted by ${tiltDeg.toFixed(0)}°, like a wall: click a rectangle that lies on a table or on the floor`,
    );
  const between = degreesBetween(d1, d2);
  const cornerDeg = Math.min(between, 180 - between);
  if (90 - cornerDeg > MOST_SKEW_DEG)
    throw new Error(
      `seen by this camera the sides would meet at ${cornerDeg.toFixed(0)}°: click the four corners of a rectangle`,
    );
  const tiltErrorDeg = normalError(camera, corners);
  if (tiltErrorDeg > MOST_ERROR_DEG)
    throw new Error(
      `these corners tell the tilt within ± ${tiltErrorDeg.toFixed(0)}° only: click a larger rectangle, or one that is nearer`,
    );
  const places = rays.map((ray) => times(ray, -1 / dot(normal, ray)));
  const depth = -places.reduce((sum, place) => sum + place[2], 0) / 4;
  return { normal, side: length(less(places[1]!, places[0]!)), depth, tiltDeg, tiltErrorDeg, cornerDeg };
}

/** The rectangle's plane where its first side is that long, metres. */
export function withSide({ normal, side }: SeenRectangle, metres: number): Plane {
  if (!(metres > 0 && Number.isFinite(metres))) throw new Error("the first side's length must be more than 0 cm");
  return { normal, offset: -metres / side };
}

/** Of the first side, where the rectangle's middle is that far in front of the camera; metres. */
export const sideAtDepth = ({ side, depth }: SeenRectangle, metres: number): number => (side * metres) / depth;

function checkShape(corners: readonly Pixel[]): void {
  const far = (a: Pixel, b: Pixel): number => (a[0] - b[0]) ** 2 + (a[1] - b[1]) ** 2;
  const largest = Math.max(...corners.flatMap((a) => corners.map((b) => far(a, b))));
  const turns = corners.map((a, i) => {
    const b = corners[(i + 1) % 4]!;
    const c = corners[(i + 2) % 4]!;
    return ((b[0] - a[0]) * (c[1] - b[1]) - (b[1] - a[1]) * (c[0] - b[0])) / largest;
  });
  if (!turns.every((turn) => Math.abs(turn) > FLATTEST))
    throw new Error("three of these corners are on a line: click the four corners of a rectangle");
  const left = turns.filter((turn) => turn > 0).length;
  if (left === 2) throw new Error("these sides cross: click the corners in order, around the rectangle");
  if (left % 4) throw new Error("one of these corners would lie behind the camera: no rectangle looks like that");
}

/** The unit normal towards the camera, and the directions of the sides. */
function normalOf(rays: readonly Vec3[]): { normal: Vec3; d1: Vec3; d2: Vec3 } {
  const [x1, x2, x3, x4] = rays as [Vec3, Vec3, Vec3, Vec3];
  const d1 = unit(cross(cross(x1, x2), cross(x3, x4)));
  const d2 = unit(cross(cross(x2, x3), cross(x4, x1)));
  const normal = unit(cross(d1, d2));
  return { normal: dot(normal, x1) > 0 ? times(normal, -1) : normal, d1, d2 };
}

function normalError(camera: Pinhole, corners: readonly Pixel[]): number {
  const step = CLICK * Math.max(camera.width, camera.height);
  let sum = 0;
  for (let corner = 0; corner < 4; corner++)
    for (const axis of [0, 1]) {
      const [more, fewer] = [step / 2, -step / 2].map((by) => {
        const moved = corners.map(([column, row], i): Pixel => {
          if (i !== corner) return [column, row];
          return axis === 0 ? [column + by, row] : [column, row + by];
        });
        return normalOf(moved.map((one) => rayThrough(camera, one))).normal;
      });
      sum += degreesBetween(more!, fewer!) ** 2;
    }
  return Math.sqrt(sum);
}
