import { el } from "./dom";
import { toPixel, type Vec3 } from "./frame";
import { linearPicture } from "./linear_picture";
import { sampler, type RadianceMap } from "./radiance_map";

export type Overlay = (context: CanvasRenderingContext2D, width: number, height: number) => void;
export interface Panorama {
  element: HTMLElement;
  canvas: HTMLCanvasElement;
  setMap: (map: RadianceMap) => void;
  /** What radiance is multiplied by before 1 is shown as white. */
  setExposure: (factor: number) => void;
  /** Draws over the map after each paint; the context's units are the canvas' pixels. */
  setOverlay: (draw: Overlay | null) => void;
}

const WIDTH = 768;
const HEIGHT = 384;

/**
 * A probe as a tone-mapped lat-long picture: its middle is where the camera looks, its right half
 * lies to the right. The canvas is 768 x 384 whatever the map's size.
 */
export function panorama(label: string): Panorama {
  const canvas = el("canvas", { width: WIDTH, height: HEIGHT, role: "img", "aria-label": label });
  let overlay: Overlay | null = null;
  const picture = linearPicture(canvas, (context) => overlay?.(context, WIDTH, HEIGHT));
  return {
    element: el("div", { class: "panorama" }, canvas),
    canvas,
    setMap: (map) => {
      const look = sampler(map);
      for (let row = 0, at = 0; row < HEIGHT; row++)
        for (let column = 0; column < WIDTH; column++, at += 3)
          look(
            ((column + 0.5) / WIDTH) * map.width - 0.5,
            ((row + 0.5) / HEIGHT) * map.height - 0.5,
            picture.linear,
            at,
          );
      picture.repaint();
    },
    setExposure: picture.setExposure,
    setOverlay: (draw) => {
      overlay = draw;
      picture.repaint();
    },
  };
}

/** A ring with a dot where a direction lies, readable on any ground. */
export function markDirection(
  context: CanvasRenderingContext2D,
  direction: Vec3,
  width: number,
  height: number,
  color = "#ffd23f",
): void {
  const [column, row] = toPixel(direction, width, height);
  for (const [stroke, line] of [["#000", 5], [color, 2.5]] as const) {
    context.strokeStyle = context.fillStyle = stroke;
    context.lineWidth = line;
    context.beginPath();
    context.arc(column + 0.5, row + 0.5, 11, 0, 2 * Math.PI);
    context.stroke();
    context.beginPath();
    context.arc(column + 0.5, row + 0.5, line / 2 + 0.6, 0, 2 * Math.PI);
    context.fill();
  }
}
