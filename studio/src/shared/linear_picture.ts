import { code } from "./tone";

/** A canvas whose pixels are kept as linear light, so that a new exposure needs no new rendering. */
export interface LinearPicture {
  /** RGB, row by row from the top; fill it, then call `repaint`. */
  linear: Float32Array;
  /** Opacity of each pixel, 0 to 1; opaque at first. */
  opacity: Float32Array;
  setExposure: (factor: number) => void;
  repaint: () => void;
}

/** `after` draws over the picture each time it is painted. */
export function linearPicture(
  canvas: HTMLCanvasElement,
  after?: (context: CanvasRenderingContext2D) => void,
): LinearPicture {
  const { width, height } = canvas;
  const context = canvas.getContext("2d")!;
  const image = context.createImageData(width, height);
  const linear = new Float32Array(3 * width * height);
  const opacity = new Float32Array(width * height).fill(1);
  let exposure = 1;
  let asked = 0;

  const paint = (): void => {
    asked = 0;
    for (let i = 0, from = 0, to = 0; i < opacity.length; i++, from += 3, to += 4) {
      image.data[to] = code(linear[from]! * exposure);
      image.data[to + 1] = code(linear[from + 1]! * exposure);
      image.data[to + 2] = code(linear[from + 2]! * exposure);
      image.data[to + 3] = 255 * opacity[i]!;
    }
    context.putImageData(image, 0, 0);
    after?.(context);
  };
  const repaint = (): void => {
    asked ||= requestAnimationFrame(paint); // once a frame, however fast a slider moves
  };
  return {
    linear,
    opacity,
    setExposure: (factor) => {
      exposure = factor;
      repaint();
    },
    repaint,
  };
}
