import { toPixel, type Vec3 } from "./frame";
import { linearPicture, type LinearPicture } from "./linear_picture";
import { prefilter } from "./prefilter";
import { sampler, type RadianceMap } from "./radiance_map";

/**
 * Draws a ball as a camera far away sees it that looks along -Z: `shade` writes the linear colour
 * of the point with the given unit normal.
 */
export function drawBall(
  picture: LinearPicture,
  size: number,
  shade: (normal: Vec3, out: Float32Array, at: number) => void,
): void {
  const radius = size / 2 - 1;
  for (let row = 0, i = 0; row < size; row++)
    for (let column = 0; column < size; column++, i++) {
      const x = (column + 0.5 - size / 2) / radius;
      const y = (size / 2 - row - 0.5) / radius;
      const r = Math.hypot(x, y);
      picture.opacity[i] = Math.min(1, Math.max(0, (1 - r) * radius + 0.5)); // a smooth edge
      if (picture.opacity[i] === 0) continue;
      const inside = Math.max(r, 1); // the edge's half-covered pixels take the rim's normal
      shade([x / inside, y / inside, Math.sqrt(Math.max(0, 1 - r * r))], picture.linear, 3 * i);
    }
  picture.repaint();
}

/** The direction in which a mirror ball's point shows the world to a camera that looks along -Z. */
export const mirrored = ([x, y, z]: Vec3): Vec3 => [2 * z * x, 2 * z * y, 2 * z * z - 1];

/**
 * Phong's exponent of the silver ball: half the lobe's height at 19 degrees, as of a GGX metal of
 * roughness 0.5 (alpha 0.25) seen head-on, which is the silver that `skylight score` renders.
 */
export const SILVER_EXPONENT = 12;

export type Finish = "mirror" | "silver" | "matte";

/** Balls of each finish, all white: reflectance 1. */
export function shadeOf(finish: Finish, map: RadianceMap): (normal: Vec3, out: Float32Array, at: number) => void {
  const seen =
    finish === "mirror" ? map : prefilter(map, finish === "silver" ? SILVER_EXPONENT : 1);
  const look = sampler(seen);
  return (normal, out, at) => {
    const direction = finish === "matte" ? normal : mirrored(normal);
    const [column, row] = toPixel(direction, seen.width, seen.height);
    look(column, row, out, at);
  };
}

export interface Balls {
  element: HTMLElement;
  setMap: (map: RadianceMap) => void;
  setExposure: (factor: number) => void;
}

const TITLES: Record<Finish, string> = { mirror: "Mirror", silver: "Silver", matte: "Matte" };

/** Mirror, silver and matte balls under a map. */
export function balls(label: string, size = 200): Balls {
  const element = document.createElement("div");
  element.className = "balls";
  const shown = (Object.keys(TITLES) as Finish[]).map((finish) => {
    const canvas = document.createElement("canvas");
    canvas.width = canvas.height = size;
    canvas.setAttribute("role", "img");
    canvas.setAttribute("aria-label", `${TITLES[finish]} ball: ${label}`);
    const figure = document.createElement("figure");
    const caption = document.createElement("figcaption");
    caption.textContent = TITLES[finish];
    figure.append(canvas, caption);
    element.append(figure);
    return { finish, picture: linearPicture(canvas) };
  });
  return {
    element,
    setMap: (map) => {
      for (const { finish, picture } of shown) drawBall(picture, size, shadeOf(finish, map));
    },
    setExposure: (factor) => {
      for (const { picture } of shown) picture.setExposure(factor);
    },
  };
}
