import { drawBall } from "../shared/ball";
import { el } from "../shared/dom";
import { fromAngles, toAngles, toPixel, type Vec3 } from "../shared/frame";
import { linearPicture } from "../shared/linear_picture";
import { sampler, type RadianceMap } from "../shared/radiance_map";
import type { Posterior } from "./posterior";

const SIZE = 200;
const HORIZON = 0.012; // half the width of the lines, in radians

/**
 * All directions as a ball seen from outside: the light, the posterior of its `main` source painted
 * over it, the horizon, and where the camera looks. It turns by pointer and by arrow keys.
 */
export function posteriorBall(
  map: RadianceMap,
  posterior: Posterior | null,
  sun: { azimuth_deg: number; zenith_deg: number },
  main: "sun" | "main lamp",
): { element: HTMLElement; setExposure: (factor: number) => void } {
  const label =
    `Ball of all directions, turned by dragging or by arrow keys: the light around the camera` +
    (posterior ? ` with the region where the ${main} may stand` : "");
  const canvas = el("canvas", {
    width: SIZE,
    height: SIZE,
    tabindex: 0,
    role: "application",
    "aria-label": label,
    class: "turnable",
  });
  // drawn again at every turn and exposure: its lines must not fade with the light
  const picture = linearPicture(canvas, (context) => drawMarks(context));
  const look = sampler(map);
  const light = new Float32Array(3);
  let exposure = 1;
  // seen from somewhat above, the sun in front and the camera's way as near as that allows
  let azimuth = sun.azimuth_deg - Math.sign(sun.azimuth_deg) * Math.min(60, Math.abs(sun.azimuth_deg) / 2);
  let zenith = 65;
  let axes = axesOf(azimuth, zenith);

  function axesOf(a: number, z: number): { right: Vec3; up: Vec3; front: Vec3 } {
    const front = fromAngles(a, z);
    const up = fromAngles(a, z - 90);
    const right: Vec3 = [
      up[1] * front[2] - up[2] * front[1],
      up[2] * front[0] - up[0] * front[2],
      up[0] * front[1] - up[1] * front[0],
    ];
    return { right, up, front };
  }

  const draw = (): void => {
    axes = axesOf(azimuth, zenith);
    const { right, up, front } = axes;
    drawBall(picture, SIZE, ([x, y, z], out, at) => {
      const towards: Vec3 = [
        x * right[0] + y * up[0] + z * front[0],
        x * right[1] + y * up[1] + z * front[1],
        x * right[2] + y * up[2] + z * front[2],
      ];
      const [column, row] = toPixel(towards, map.width, map.height);
      look(column, row, light, 0);
      let red = Math.min(1, light[0]! * exposure);
      let green = Math.min(1, light[1]! * exposure);
      let blue = Math.min(1, light[2]! * exposure);
      if (posterior) {
        const { width, height } = posterior.density;
        const [c, r] = toPixel(towards, width, height);
        const density = posterior.at(c, r);
        const inside = density >= posterior.level;
        const share = inside ? 0.35 + 0.5 * Math.sqrt(density / posterior.most) : 0;
        red += (1 - red) * share;
        green += (0.62 - green) * share;
        blue += (0.05 - blue) * share;
      }
      if (Math.abs(towards[1]) < HORIZON) red = green = blue = 0.75;
      out[at] = red;
      out[at + 1] = green;
      out[at + 2] = blue;
    });
  };

  const project = ([x, y, z]: Vec3): { x: number; y: number; isFront: boolean } => {
    const along = (axis: Vec3): number => x * axis[0] + y * axis[1] + z * axis[2];
    const radius = SIZE / 2 - 1;
    return {
      x: SIZE / 2 + radius * along(axes.right),
      y: SIZE / 2 - radius * along(axes.up),
      isFront: along(axes.front) > 0,
    };
  };
  const drawMarks = (context: CanvasRenderingContext2D): void => {
    const marks: [Vec3, string, string][] = [
      [[0, 0, -1], "camera", "#ffffff"],
      [fromAngles(sun.azimuth_deg, sun.zenith_deg), posterior ? main : "most light", "#ffd23f"],
      [[0, 1, 0], "up", "#ffffff"],
    ];
    context.font = "600 15px system-ui, sans-serif";
    context.textAlign = "center";
    for (const [direction, words, color] of marks) {
      const at = project(direction);
      if (!at.isFront) continue;
      context.beginPath();
      context.arc(at.x, at.y, 4, 0, 2 * Math.PI);
      context.fillStyle = color;
      context.strokeStyle = "#000";
      context.lineWidth = 2;
      context.stroke();
      context.fill();
      const half = context.measureText(words).width / 2;
      const x = Math.min(SIZE - half - 2, Math.max(half + 2, at.x));
      const y = at.y < 24 ? at.y + 20 : at.y - 9;
      context.lineWidth = 3;
      context.strokeText(words, x, y);
      context.fillText(words, x, y);
    }
  };

  const turn = (byAzimuth: number, byZenith: number): void => {
    azimuth = toAngles(fromAngles(azimuth + byAzimuth, 90)).azimuth_deg;
    zenith = Math.min(170, Math.max(10, zenith + byZenith));
    draw();
  };
  canvas.addEventListener("pointerdown", (event) => canvas.setPointerCapture(event.pointerId));
  canvas.addEventListener("pointermove", (event) => {
    if (canvas.hasPointerCapture(event.pointerId)) turn(event.movementX * 0.6, -event.movementY * 0.6);
  });
  const keys: Record<string, [number, number]> = {
    ArrowLeft: [-10, 0],
    ArrowRight: [10, 0],
    ArrowUp: [0, 10],
    ArrowDown: [0, -10],
  };
  canvas.addEventListener("keydown", (event) => {
    const by = keys[event.key];
    if (!by) return;
    event.preventDefault();
    turn(...by);
  });
  draw();
  return {
    element: el(
      "figure",
      { class: "posterior-ball" },
      canvas,
      el("figcaption", {}, posterior ? `Where the ${main} may be` : "All around"),
    ),
    setExposure: (factor) => {
      exposure = factor;
      draw();
    },
  };
}
