/** Linear light to display codes: 255 srgb(min(1, L)), by a table fine enough for 8 bits. */
const STEPS = 1 << 14;
const TABLE = Uint8ClampedArray.from({ length: STEPS + 1 }, (_, i) => 255 * encode((i / STEPS) ** 2));

/** IEC 61966-2-1's curve. */
export function encode(linear: number): number {
  return linear <= 0.0031308 ? 12.92 * linear : 1.055 * linear ** (1 / 2.4) - 0.055;
}

/** The table is even in the root of light, where the eye is: no step of it skips a code. */
export function code(linear: number): number {
  return TABLE[linear >= 1 ? STEPS : linear > 0 ? (Math.sqrt(linear) * STEPS + 0.5) | 0 : 0]!;
}
