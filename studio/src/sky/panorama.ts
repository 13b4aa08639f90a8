import { code } from "../shared/tone";
import { COLUMNS, ROWS } from "./latlong";

/**
 * Paints skies over their ground on a canvas, smoothly but with a sharp horizon; radiance times
 * exposure, 1 is white.
 */
export function skyPainter(canvas: HTMLCanvasElement): (map: Float32Array, exposure: number) => void {
  canvas.width = 4 * COLUMNS;
  canvas.height = 8 * ROWS;
  const picture = new ImageData(COLUMNS, ROWS);
  const small = new OffscreenCanvas(COLUMNS, ROWS);
  const from = small.getContext("2d")!, to = canvas.getContext("2d")!;
  return (map, exposure) => {
    const shown = (i: number) => code(exposure * map[i]!);
    for (let i = 0, j = 0; j < picture.data.length; i += 3, j += 4) {
      picture.data[j] = shown(i);
      picture.data[j + 1] = shown(i + 1);
      picture.data[j + 2] = shown(i + 2);
      picture.data[j + 3] = 255;
    }
    from.putImageData(picture, 0, 0);
    const middle = canvas.height / 2;
    to.drawImage(small, 0, 0, canvas.width, middle);
    const [red, green, blue] = [3, 2, 1].map((back) => shown(map.length - back));
    to.fillStyle = `rgb(${red} ${green} ${blue})`;
    to.fillRect(0, middle, canvas.width, middle);
    canvas.dataset.painted = "";
  };
}
