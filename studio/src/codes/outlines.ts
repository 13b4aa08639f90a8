import { fromAngles, toPixel } from "../shared/frame";
import type { Overlay } from "../shared/panorama";
import { encode } from "../shared/tone";
import type { Activation } from "./result";

const EVERYWHERE_DEG = 360;

/** Whether an activation adds light; of two minds in its colours, what its luminance does counts. */
export const adds = ({ weight: [r, g, b] }: Activation): boolean =>
  0.2126 * r + 0.7152 * g + 0.0722 * b >= 0;

/** The hue of its light, at full strength, for a picture. */
export function colourOf({ weight }: Activation): string {
  const peak = Math.max(...weight.map(Math.abs), 1e-30);
  const codes = weight.map((w) => Math.round(255 * encode(Math.abs(w) / peak)));
  return `rgb(${codes.join(" ")})`;
}

/** Draws activations in their places, sizes and colours; those that take light away are dashed. */
export function drawActivations(activations: Activation[]): Overlay {
  return (context, width, height) => {
    context.lineJoin = "round";
    for (const one of activations) {
      const path = pathOf(one, width, height);
      if (!path) continue;
      context.setLineDash(adds(one) ? [] : [7, 5]);
      for (const [colour, line] of [["#000", 4.5], [colourOf(one), 2.2]] as const) {
        context.strokeStyle = colour;
        context.lineWidth = line;
        context.stroke(path);
      }
    }
    context.setLineDash([]);
  };
}

/** On the map's plane; a line that leaves at one side comes in at the other. */
function pathOf(one: Activation, width: number, height: number): Path2D | undefined {
  const path = new Path2D();
  if (!one.outline.length) {
    if (one.width_deg >= EVERYWHERE_DEG) return undefined;
    const [x, y] = toPixel(fromAngles(one.azimuth_deg, one.zenith_deg), width, height);
    path.arc(x + 0.5, y + 0.5, Math.max(3, ((one.width_deg / 180) * height) / 2), 0, 2 * Math.PI);
    return path;
  }
  const corners = one.outline.map(([a, z]) => toPixel(fromAngles(a, z), width, height));
  corners.forEach(([x, y], i) => {
    const [px, py] = corners[(i || corners.length) - 1]!;
    const jump = Math.abs(x - px) > width / 2 ? Math.sign(x - px) * width : 0;
    path.moveTo(px, py);
    path.lineTo(x - jump, y);
    if (!jump) return;
    path.moveTo(px + jump, py);
    path.lineTo(x, y);
  });
  return path;
}
