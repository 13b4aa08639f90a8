import { fromAngles, solidAngles, type Vec3 } from "../shared/frame";

// A sky is the upper half of a lat-long map: 32 rows from the zenith down, 128 columns. Angles are
// in radians here, as in the latents.

export type Rgb = [red: number, green: number, blue: number];

export const ROWS = 32;
export const COLUMNS = 128;
/** Where decoded skies have their sun: the middle of column 64 (models/networks/base.py). */
const CENTRE_AZIMUTH = Math.PI / COLUMNS;

/** cos of the zenith angle at the upper border of each row, and 0 at the horizon. */
const EDGE_COSINES = Float64Array.from({ length: ROWS + 1 }, (_, row) =>
  row === ROWS ? 0 : Math.cos((row * Math.PI) / 2 / ROWS),
);

/** Solid angle of a pixel of each row of a sky. */
export const SOLID_ANGLES = solidAngles(COLUMNS, 2 * ROWS).subarray(0, ROWS);

const DEGREES = 180 / Math.PI;
export const direction = (azimuth: number, zenith: number): Vec3 =>
  fromAngles(azimuth * DEGREES, zenith * DEGREES);

export function columnAzimuth(column: number): number {
  return ((column + 0.5) / COLUMNS - 0.5) * 2 * Math.PI;
}

export function rowZenith(row: number): number {
  return ((row + 0.5) / ROWS) * (Math.PI / 2);
}

/**
 * A decoded sky (32 x 128 x 3) turned so that its sun stands at `azimuth`: circular, with linear
 * interpolation between columns, as sphere/envmap.py's shift_columns does.
 */
export function turned(sky: Float32Array, azimuth: number): Float32Array {
  const shift = ((azimuth - CENTRE_AZIMUTH) * COLUMNS) / (2 * Math.PI);
  const whole = Math.floor(shift);
  const part = shift - whole;
  const out = new Float32Array(sky.length);
  for (let column = 0; column < COLUMNS; column++) {
    const near = (((column - whole) % COLUMNS) + COLUMNS) % COLUMNS;
    const next = (near + COLUMNS - 1) % COLUMNS;
    for (let row = 0; row < ROWS; row++) {
      const start = row * COLUMNS;
      for (let c = 0; c < 3; c++) {
        out[(start + column) * 3 + c] =
          (1 - part) * sky[(start + near) * 3 + c]! + part * sky[(start + next) * 3 + c]!;
      }
    }
  }
  return out;
}

/** Of level ground under an open sky; times albedo / pi its radiance (models/ground.py). */
export function groundIrradiance(sky: Float32Array): Rgb {
  const irradiance: Rgb = [0, 0, 0];
  for (let row = 0; row < ROWS; row++) {
    // the integral of the cosine over a pixel, exact
    const weight = ((EDGE_COSINES[row]! ** 2 - EDGE_COSINES[row + 1]! ** 2) * Math.PI) / COLUMNS;
    for (let i = row * COLUMNS * 3; i < (row + 1) * COLUMNS * 3; i++) {
      irradiance[i % 3 as 0 | 1 | 2] += weight * sky[i]!;
    }
  }
  return irradiance;
}

/** The whole sphere, 64 x 128 x 3: a sky over a ground of one radiance. */
export function withGround(sky: Float32Array, ground: readonly number[]): Float32Array {
  const map = new Float32Array(2 * sky.length);
  map.set(sky);
  for (let i = sky.length; i < map.length; i++) map[i] = ground[i % 3]!;
  return map;
}
