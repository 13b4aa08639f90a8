import { fromPixel, solidAngles } from "./frame";
import { luminance, shrink, type RadianceMap } from "./radiance_map";

export interface Lights {
  count: number;
  /** Unit vectors towards the light, three numbers each. */
  directions: Float32Array;
  /** Each light's share of the flux, sum of L dw in Rec.709, three numbers each. */
  fluxes: Float32Array;
}

const GOLDEN = 0.6180339887498949;

/**
 * A map as directional lights of like luminance. The pixels are strung along a Hilbert curve and the
 * string is cut where the luminance gathered reaches 1/count, 2/count, ... of all of it. A light
 * gets exactly the flux of its piece, so the sum over the lights is the map's integral, and it shines
 * from the piece's mean direction. A pixel brighter than a piece (the sun) is cut into several, which
 * are spread over its area: the penumbra is as wide as the pixel.
 */
export function lightStrata(map: RadianceMap, count: number): Lights {
  const { width, height, data } = shrink(map, 128);
  const omega = solidAngles(width, height);
  const order = hilbertOrder(width, height);
  const power = order.map((pixel) => {
    const at = 3 * pixel;
    return (
      Math.max(0, luminance(data[at]!, data[at + 1]!, data[at + 2]!)) * omega[Math.floor(pixel / width)]!
    );
  });
  const total = power.reduce((sum, one) => sum + one, 0);
  const directions = new Float32Array(3 * count);
  const fluxes = new Float32Array(3 * count);
  let gathered = 0;
  order.forEach((pixel, place) => {
    const own = power[place]!;
    if (own === 0) return;
    const row = Math.floor(pixel / width);
    const start = (gathered / total) * count;
    gathered += own;
    const end = (gathered / total) * count;
    const last = Math.min(count - 1, Math.ceil(end) - 1);
    for (let piece = Math.min(last, Math.floor(start)); piece <= last; piece++) {
      const from = Math.max(start, piece);
      const to = piece === last ? end : piece + 1;
      const share = (to - from) / (end - start);
      if (!(share > 0)) continue;
      const across = (from + to - 2 * start) / (2 * (end - start)) - 0.5;
      const along = (((piece * GOLDEN) % 1) - 0.5) * (1 - share);
      const towards = fromPixel((pixel % width) + across, row + along, width, height);
      for (let k = 0; k < 3; k++) {
        directions[3 * piece + k]! += towards[k]! * own * share;
        fluxes[3 * piece + k]! += Math.max(0, data[3 * pixel + k]!) * omega[row]! * share;
      }
    }
  });
  for (let at = 0; at < 3 * count; at += 3) {
    const length = Math.hypot(directions[at]!, directions[at + 1]!, directions[at + 2]!);
    if (length > 0) for (let k = 0; k < 3; k++) directions[at + k]! /= length;
    else directions[at + 1] = 1; // a black map, or light from all sides: its flux still counts
  }
  return { count, directions, fluxes };
}

/** Pixel numbers along a Hilbert curve over the smallest square of a power of two about the map. */
function hilbertOrder(width: number, height: number): number[] {
  let side = 1;
  while (side < Math.max(width, height)) side *= 2;
  const order: number[] = [];
  for (let step = 0; step < side * side; step++) {
    let x = 0;
    let y = 0;
    let rest = step;
    for (let s = 1; s < side; s *= 2) {
      const rx = 1 & (rest / 2);
      const ry = 1 & (rest ^ rx);
      if (ry === 0) {
        if (rx === 1) [x, y] = [s - 1 - x, s - 1 - y];
        [x, y] = [y, x];
      }
      x += s * rx;
      y += s * ry;
      rest = Math.floor(rest / 4);
    }
    if (x < width && y < height) order.push(y * width + x);
  }
  return order;
}
