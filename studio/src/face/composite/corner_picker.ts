import { freshId } from "../../shared/dom";
import type { Pinhole, Pixel } from "./plane";

const NAMES = ["first", "second", "third", "fourth"];
const SVG = "http://www.w3.org/2000/svg";

export interface CornerPicker {
  element: SVGSVGElement;
  isPicking: () => boolean;
  begin: () => void;
  end: () => void;
}

/**
 * Four places of the photo, by pointer or by keys: the arrows move a cross (with Shift in small
 * steps), Enter takes its place, Backspace takes the last one back, Escape ends. It lies over the
 * photo while it picks.
 */
export function cornerPicker(options: {
  camera: Pinhole;
  say: (line: string) => void;
  picked: (corners: Pixel[]) => void;
  left: () => void;
}): CornerPicker {
  const { camera, say, picked, left } = options;
  const { width, height } = camera;
  const element = document.createElementNS(SVG, "svg");
  element.setAttribute("class", "corners");
  element.setAttribute("viewBox", `0 0 ${width} ${height}`);
  element.setAttribute("tabindex", "0");
  element.setAttribute("role", "application");
  element.setAttribute("id", freshId("corners"));
  element.setAttribute(
    "aria-label",
    "Corners of a rectangle on a table or on the floor: move the cross by the arrow keys, take its place by Enter",
  );
  const shape = (name: string): SVGElement => element.appendChild(document.createElementNS(SVG, name));
  const line = shape("polygon");
  const cross = shape("path");
  const dots = NAMES.map(() => shape("circle"));
  let corners: Pixel[] = [];
  let at: [number, number] = [width / 2, height / 2];
  let isPicking = false;
  const show = (): void => {
    element.style.display = isPicking ? "" : "none";
    line.setAttribute("points", [...corners, at].map((place) => place.join(",")).join(" "));
    dots.forEach((dot, i) => {
      const [column, row] = corners[i] ?? [-99, -99];
      dot.setAttribute("cx", String(column));
      dot.setAttribute("cy", String(row));
      dot.setAttribute("r", String(0.007 * width));
    });
    const arm = 0.025 * width;
    cross.setAttribute("d", `M${at[0] - arm} ${at[1]}h${2 * arm}M${at[0]} ${at[1] - arm}v${2 * arm}`);
  };
  const ask = (): void => {
    say(`Click the ${NAMES[corners.length]} corner of a rectangle that lies on a table or on the floor; Escape ends.`);
    show();
  };
  const end = (): void => {
    isPicking = false;
    show();
  };
  const take = (): void => {
    corners.push([...at]);
    if (corners.length < 4) return ask();
    end();
    picked(corners);
  };
  const pointed = (event: PointerEvent): void => {
    const box = element.getBoundingClientRect();
    at = [((event.clientX - box.left) / box.width) * width, ((event.clientY - box.top) / box.height) * height];
  };
  element.addEventListener("pointermove", (event) => {
    pointed(event);
    show();
  });
  element.addEventListener("pointerdown", (event) => {
    event.preventDefault();
    element.focus();
    pointed(event);
    take();
  });
  const moves: Record<string, [number, number]> = {
    ArrowLeft: [-1, 0],
    ArrowRight: [1, 0],
    ArrowUp: [0, -1],
    ArrowDown: [0, 1],
  };
  element.addEventListener("keydown", (event) => {
    const move = moves[event.key];
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    if (move) {
      const step = (event.shiftKey ? 0.001 : 0.01) * Math.max(width, height);
      at = [
        Math.min(width, Math.max(0, at[0] + step * move[0])),
        Math.min(height, Math.max(0, at[1] + step * move[1])),
      ];
      show();
    } else if (event.key === "Enter") take();
    else if (event.key === "Backspace") {
      corners.pop();
      ask();
    } else if (event.key === "Escape") {
      end();
      left();
    } else return;
    event.preventDefault();
  });
  show();
  return {
    element,
    isPicking: () => isPicking,
    begin: () => {
      corners = [];
      at = [width / 2, 0.75 * height];
      isPicking = true;
      ask();
      element.focus();
    },
    end,
  };
}
