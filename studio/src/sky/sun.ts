import { columnAzimuth, COLUMNS, direction, ROWS, rowZenith, SOLID_ANGLES, type Rgb } from "./latlong";

/** The sun that a latent describes: irradiance on a plane that faces it, and how wide it is. */
export interface Sun {
  zenith: number;
  energy: Rgb;
  kappa: number;
}

const KAPPA_LOW = Math.log(200);
const KAPPA_HIGH = Math.log(30000);
const sigmoid = (x: number) => 1 / (1 + Math.exp(-x));

/** The last five of the latents, read as skylight/models/_sun_head.py does. */
export function sunOf(latent: ArrayLike<number>): Sun {
  const [height, red, green, blue, sharpness] = Array.from(latent).slice(-5) as [
    number, number, number, number, number,
  ];
  const energy = (u: number) => Math.exp(Math.min(2 * u - 1, 12));
  return {
    zenith: (Math.PI / 2) * sigmoid(1.5 * height),
    energy: [energy(red), energy(green), energy(blue)],
    kappa: Math.exp(KAPPA_LOW + (KAPPA_HIGH - KAPPA_LOW) * sigmoid(sharpness)),
  };
}

/**
 * A decoded sky without the lobe that its decoder added for the sun,
 * E exp(kappa (<s, w> - 1)) scaled to an energy of E over the pixels.
 */
export function withoutSun(sky: Float32Array, sun: Sun): Float32Array {
  const [sx, sy, sz] = direction(columnAzimuth(COLUMNS / 2), sun.zenith);
  const lobe = new Float64Array(ROWS * COLUMNS);
  let largest = -Infinity;
  for (let row = 0; row < ROWS; row++) {
    const zenith = rowZenith(row);
    for (let column = 0; column < COLUMNS; column++) {
      const [x, y, z] = direction(columnAzimuth(column), zenith);
      const exponent = (-sun.kappa / 2) * ((sx - x) ** 2 + (sy - y) ** 2 + (sz - z) ** 2);
      lobe[row * COLUMNS + column] = exponent;
      largest = Math.max(largest, exponent);
    }
  }
  let total = 0;
  for (let i = 0; i < lobe.length; i++) {
    lobe[i] = Math.exp(lobe[i]! - largest);
    total += lobe[i]! * SOLID_ANGLES[Math.floor(i / COLUMNS)]!;
  }
  const out = new Float32Array(sky.length);
  for (let i = 0; i < lobe.length; i++) {
    for (let c = 0; c < 3; c++) {
      out[3 * i + c] = Math.max(0, sky[3 * i + c]! - (lobe[i]! / total) * sun.energy[c]!);
    }
  }
  return out;
}
