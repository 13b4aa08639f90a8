import { sampler, type RadianceMap } from "../shared/radiance_map";

/** Where the sun may stand: its density per sr, and the region that holds most of it. */
export interface Posterior {
  density: RadianceMap;
  /** The density on the region's edge. */
  level: number;
  most: number;
  at: (column: number, row: number) => number;
}

export function posteriorOf(density: RadianceMap, level: number): Posterior {
  const look = sampler(density);
  const out = new Float32Array(3);
  return {
    density,
    level,
    most: density.data.reduce((most, value) => Math.max(most, value), 0),
    at: (column, row) => {
      look(column, row, out, 0);
      return out[0]!;
    },
  };
}

/**
 * Line pieces of the region's edge in pixels of the density (marching squares over cell centres,
 * round in azimuth and over the zenith, whose row goes on half a turn away).
 */
export function outline({ density, level }: Posterior): [number, number, number, number][] {
  const { width, height, data } = density;
  const value = (column: number, row: number): number => {
    const over = row < 0 ? width / 2 : 0;
    return row >= height ? 0 : data[3 * (Math.max(row, 0) * width + ((column + over + width) % width))]!;
  };
  const pieces: [number, number, number, number][] = [];
  for (let row = -1; row < height; row++)
    for (let column = -1; column < width; column++) {
      const corners = [
        [column, row],
        [column + 1, row],
        [column + 1, row + 1],
        [column, row + 1],
      ] as const;
      const crossings: [number, number][] = [];
      corners.forEach(([c0, r0], i) => {
        const [c1, r1] = corners[(i + 1) % 4]!;
        const a = value(c0, r0) - level;
        const b = value(c1, r1) - level;
        if (a < 0 === b < 0) return;
        const share = a / (a - b);
        crossings.push([c0 + share * (c1 - c0), r0 + share * (r1 - r0)]);
      });
      for (let i = 0; i + 1 < crossings.length; i += 2)
        pieces.push([...crossings[i]!, ...crossings[i + 1]!]);
    }
  return pieces;
}

/** Draws the edge over a lat-long picture of the given size. */
export function drawOutline(
  context: CanvasRenderingContext2D,
  posterior: Posterior,
  pieces: [number, number, number, number][],
  width: number,
  height: number,
): void {
  const x = width / posterior.density.width;
  const y = height / posterior.density.height;
  for (const [color, line] of [["rgba(0,0,0,0.75)", 5], ["#ffd23f", 2.5]] as const) {
    context.strokeStyle = color;
    context.lineWidth = line;
    context.lineCap = "round";
    context.beginPath();
    for (const [c0, r0, c1, r1] of pieces) {
      context.moveTo((c0 + 0.5) * x, (r0 + 0.5) * y);
      context.lineTo((c1 + 0.5) * x, (r1 + 0.5) * y);
    }
    context.stroke();
  }
}
