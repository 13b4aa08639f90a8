import { fromPixel, solidAngles } from "./frame";
import { shrink, type RadianceMap } from "./radiance_map";

/** The map that a surface of this lobe shows: 64 x 32, smooth, to be looked up between pixels. */
const WIDTH = 64;
const HEIGHT = 32;

interface Kernel {
  /** For each output row and input row: the first column offset with weight, and the weights. */
  rows: { first: number; weights: Float32Array }[][];
}
const kernels = new Map<string, Kernel>();

/**
 * Radiance seen through a cosine lobe,
 *
 *     L_n(d) = sum_w L(w) max(0, d.w)^n dw / sum_w max(0, d.w)^n dw,
 *
 * so n = 1 is irradiance / pi, what a white Lambertian surface facing d sends out, and larger n a
 * glossy one about its mirror direction d (Phong's lobe). The sums run over all pixels of the map.
 */
export function prefilter(map: RadianceMap, exponent: number): RadianceMap {
  const source = shrink(map, exponent < 20 ? 64 : 128);
  const { rows } = kernel(source.width, source.height, exponent);
  const data = new Float32Array(3 * WIDTH * HEIGHT);
  for (let row = 0; row < HEIGHT; row++)
    for (let column = 0; column < WIDTH; column++) {
      // exact where 64 divides the width; else at most one input pixel off
      const base = Math.floor((column * source.width) / WIDTH) + 2 * source.width;
      let red = 0;
      let green = 0;
      let blue = 0;
      for (let from = 0; from < source.height; from++) {
        const { first, weights } = rows[row]![from]!;
        for (let k = 0; k < weights.length; k++) {
          const at = 3 * (from * source.width + ((base + first + k) % source.width));
          const weight = weights[k]!;
          red += weight * source.data[at]!;
          green += weight * source.data[at + 1]!;
          blue += weight * source.data[at + 2]!;
        }
      }
      data.set([red, green, blue], 3 * (row * WIDTH + column));
    }
  return { width: WIDTH, height: HEIGHT, data };
}

/** Weights depend on the rows and on the difference of columns alone; made once for each size. */
function kernel(width: number, height: number, exponent: number): Kernel {
  const key = `${width} ${height} ${exponent}`;
  const known = kernels.get(key);
  if (known) return known;
  const omega = solidAngles(width, height);
  const rows = Array.from({ length: HEIGHT }, (_, row) => {
    const [dx, dy, dz] = fromPixel(0, row, WIDTH, HEIGHT);
    let total = 0;
    const lines = Array.from({ length: height }, (_, from) => {
      const weights = new Float32Array(width);
      for (let k = 0; k < width; k++) {
        const [x, y, z] = fromPixel(k - width / 2, from, width, height);
        weights[k] = Math.max(0, dx * x + dy * y + dz * z) ** exponent * omega[from]!;
        total += weights[k]!;
      }
      return weights;
    });
    return lines.map((weights) => {
      const some = weights.map((w) => w / total);
      let start = 0;
      let end = width;
      while (start < end && some[start]! < 1e-9) start++;
      while (end > start && some[end - 1]! < 1e-9) end--;
      return { first: start - width / 2, weights: some.slice(start, end) };
    });
  });
  const made = { rows };
  kernels.set(key, made);
  return made;
}
