import { COLUMNS, direction, ROWS, SOLID_ANGLES } from "./latlong";
import { Occluders } from "./occluders";

/** Points that receive light, what stands in its way, and a ball that does too. */
export interface Receivers {
  positions: Float32Array;
  normals: Float32Array;
  triangles: { positions: Float32Array; indices: Uint32Array };
  ball: { centre: [number, number, number]; radius: number };
}

// Sky without its sun is smooth: 8 x 32 patches of it are enough, 11 degrees wide. Each is looked
// at by two rays for what hides it.
const PATCH = 4;
const PATCH_ROWS = ROWS / PATCH;
const PATCH_COLUMNS = COLUMNS / PATCH;
const PATCHES = PATCH_ROWS * PATCH_COLUMNS;

/**
 * How the sky and the ground become irradiance at points: E = T l, where l holds the radiance of
 * 256 patches of the sky and of the ground, and T is visibility x cosine x solid angle.
 */
export class Transport {
  private readonly matrix: Float32Array;
  private readonly width = PATCHES + 1;

  constructor(private readonly receivers: Receivers) {
    this.matrix = new Float32Array((receivers.positions.length / 3) * this.width);
    const triangles = new Occluders(receivers.triangles.positions, receivers.triangles.indices);
    const rays = skyRays();
    for (let point = 0; point < receivers.positions.length / 3; point++) {
      this.fill(point, rays, triangles);
    }
  }

  /** Irradiance (RGB a point) under a sky (32 x 128 x 3) and a ground of one radiance. */
  irradiance(sky: Float32Array, ground: readonly number[]): Float32Array {
    const light = patches(sky, ground);
    const out = new Float32Array(this.receivers.positions.length);
    for (let point = 0, k = 0; point < out.length; point += 3) {
      let red = 0, green = 0, blue = 0;
      for (let i = 0; i < light.length; i += 3, k++) {
        const weight = this.matrix[k]!;
        red += weight * light[i]!;
        green += weight * light[i + 1]!;
        blue += weight * light[i + 2]!;
      }
      out[point] = red;
      out[point + 1] = green;
      out[point + 2] = blue;
    }
    return out;
  }

  private fill(point: number, rays: Ray[], triangles: Occluders): void {
    const { positions, normals, ball } = this.receivers;
    const [nx, ny, nz] = normals.subarray(3 * point, 3 * point + 3) as unknown as number[];
    // off the surface, so that it does not hide itself
    const [x, y, z] = [nx, ny, nz].map((n, axis) => positions[3 * point + axis]! + 0.004 * n!);
    const start = point * this.width;
    for (const ray of rays) {
      for (let side = 1; side >= -1; side -= 2) {
        const dy = side * ray.y;
        const cosine = nx! * ray.x + ny! * dy + nz! * ray.z;
        if (cosine <= 0 || hitsBall(ball, x!, y!, z!, ray.x, dy, ray.z)) continue;
        if (triangles.blocks(x!, y!, z!, ray.x, dy, ray.z)) continue;
        this.matrix[start + (side > 0 ? ray.patch : PATCHES)]! += cosine * ray.solidAngle;
      }
    }
  }
}

interface Ray {
  x: number;
  y: number;
  z: number;
  patch: number;
  solidAngle: number;
}

function skyRays(): Ray[] {
  const rays: Ray[] = [];
  const rows = 2 * PATCH_ROWS, columns = PATCH_COLUMNS;
  for (let row = 0; row < rows; row++) {
    // the middle of the cosine between a row's borders, so that E of an open sky comes out right
    const [above, below] = [row, row + 1].map((r) => Math.cos((r * Math.PI) / 2 / rows));
    const zenith = Math.acos((above! + below!) / 2);
    for (let column = 0; column < columns; column++) {
      // the upper row's left of the patch's middle, the lower one's right of it
      const azimuth = ((column + (row % 2 ? 0.75 : 0.25)) / columns - 0.5) * 2 * Math.PI;
      const [x, y, z] = direction(azimuth, zenith);
      const patch = Math.floor(row / 2) * PATCH_COLUMNS + column;
      rays.push({ x, y, z, patch, solidAngle: ((above! - below!) * 2 * Math.PI) / columns });
    }
  }
  return rays;
}

/** Mean radiance of each patch over its solid angle, then the ground's. */
function patches(sky: Float32Array, ground: readonly number[]): Float32Array {
  const out = new Float32Array(3 * (PATCHES + 1));
  const total = new Float64Array(PATCH_ROWS);
  for (let row = 0; row < ROWS; row++) {
    total[Math.floor(row / PATCH)]! += SOLID_ANGLES[row]! * PATCH;
  }
  for (let row = 0; row < ROWS; row++) {
    const patchRow = Math.floor(row / PATCH);
    const weight = SOLID_ANGLES[row]! / total[patchRow]!;
    for (let column = 0; column < COLUMNS; column++) {
      const to = 3 * (patchRow * PATCH_COLUMNS + Math.floor(column / PATCH));
      const from = 3 * (row * COLUMNS + column);
      for (let c = 0; c < 3; c++) out[to + c]! += weight * sky[from + c]!;
    }
  }
  out.set(ground, 3 * PATCHES);
  return out;
}

function hitsBall(
  ball: Receivers["ball"],
  x: number, y: number, z: number, dx: number, dy: number, dz: number,
): boolean {
  const [cx, cy, cz] = ball.centre;
  const along = (cx - x) * dx + (cy - y) * dy + (cz - z) * dz;
  if (along <= 0) return false;
  const aside = (cx - x - along * dx) ** 2 + (cy - y - along * dy) ** 2 + (cz - z - along * dz) ** 2;
  return aside < ball.radius ** 2;
}
