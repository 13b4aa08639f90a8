import { Box2, Box3, Vector2, Vector3, type Camera, type Object3D, type Vector4 } from "three";

/** Metres in front of the camera where the picture begins. */
export const NEAR = 0.02;

/** The eight corners of an object's box. */
export const cornersOf = (object: Object3D): Vector3[] => cornersOfBox(new Box3().setFromObject(object));

export function cornersOfBox({ min, max }: Box3): Vector3[] {
  return [min.x, max.x].flatMap((x) =>
    [min.y, max.y].flatMap((y) => [min.z, max.z].map((z) => new Vector3(x, y, z))),
  );
}

/**
 * Writes the rectangle of the screen in which all points lie, in pixels from its lower left; false
 * where one of them lies behind the camera, so that there is no such rectangle.
 */
export function boundOnScreen(
  points: Vector3[],
  camera: Camera,
  { width, height }: { width: number; height: number },
  rectangle: Vector4,
): boolean {
  const seen = new Box2();
  for (const point of points) {
    const at = point.clone().applyMatrix4(camera.matrixWorldInverse);
    if (at.z > -NEAR) return false;
    at.applyMatrix4(camera.projectionMatrix);
    seen.expandByPoint(new Vector2(((at.x + 1) / 2) * width, ((at.y + 1) / 2) * height));
  }
  const margin = 2;
  const left = Math.max(0, Math.floor(seen.min.x) - margin);
  const low = Math.max(0, Math.floor(seen.min.y) - margin);
  const right = Math.min(width, Math.ceil(seen.max.x) + margin);
  const high = Math.min(height, Math.ceil(seen.max.y) + margin);
  rectangle.set(left, low, Math.max(0, right - left), Math.max(0, high - low));
  return true;
}
