import { valueTable } from "../probes/value_table";
import { el, freshId } from "../shared/dom";

const HEIGHT = 250;
const LEFT = 62;
const RIGHT = 16;
const TOP = 14;
const BOTTOM = 44;

export interface ErrorChart {
  element: HTMLElement;
  /** Marks a number of activations. */
  mark: (count: number) => void;
}

/** The relative error of codes against how many activations they have, and the same as a table. */
export function errorChart(counts: number[], errors: number[]): ErrorChart {
  const width = Math.max(260, Math.min(560, innerWidth - 90)); // so that its letters keep their size
  const most = Math.max(...counts, 2);
  // whole decades, of the errors that are not zero to rounding
  const seen = errors.map((error) => Math.log10(Math.max(error, 1e-5)));
  const top = Math.ceil(Math.max(...seen)), bottom = Math.min(top - 1, Math.floor(Math.min(...seen)));
  const x = (count: number): number =>
    LEFT + (Math.log(count) / Math.log(most)) * (width - LEFT - RIGHT);
  const y = (error: number): number =>
    TOP + ((top - Math.log10(Math.max(error, 1e-5))) / (top - bottom)) * (HEIGHT - TOP - BOTTOM);
  const title = freshId("chart");
  const svg = node("svg", {
    viewBox: `0 0 ${width} ${HEIGHT}`,
    class: "plot code-chart",
    role: "img",
    "aria-labelledby": title,
  });
  const name = node("title", { id: title });
  name.textContent =
    `How far off the map is, by the number of pieces: from ${percent(errors[0]!)} with ` +
    `${counts[0]} to ${percent(errors.at(-1)!)} with ${counts.at(-1)}`;
  svg.append(name);
  for (let decade = bottom; decade <= top; decade++) {
    const error = 10 ** decade;
    svg.append(
      node("line", { x1: LEFT, x2: width - RIGHT, y1: y(error), y2: y(error), class: "grid" }),
      text(percent(error), { x: LEFT - 8, y: y(error) + 4, "text-anchor": "end" }),
    );
  }
  for (let count = 1; count <= most; count *= 4)
    svg.append(text(String(count), { x: x(count), y: HEIGHT - BOTTOM + 20, "text-anchor": "middle" }));
  svg.append(
    text("pieces", { x: width - RIGHT, y: HEIGHT - 6, "text-anchor": "end" }),
    node("polyline", { points: counts.map((c, i) => `${x(c)},${y(errors[i]!)}`).join(" "), class: "curve" }),
    ...counts.map((c, i) => node("circle", { cx: x(c), cy: y(errors[i]!), r: 3, class: "dot" })),
  );
  const marker = node("line", { y1: TOP, y2: HEIGHT - BOTTOM, class: "marker" });
  svg.append(marker);
  const rows = counts.map((count, i) => [String(count), percent(errors[i]!)]);
  const table = valueTable("The same as a table", ["Pieces", "Off by"], rows);
  return {
    element: el("div", { class: "stack tight" }, svg as Element as HTMLElement, table),
    mark: (count) => {
      marker.setAttribute("x1", String(x(count)));
      marker.setAttribute("x2", String(x(count)));
    },
  };
}

/** With two digits or more. */
export const percent = (share: number): string =>
  `${share === 0 || share >= 0.1 ? (100 * share).toFixed(0) : Number((100 * share).toPrecision(2))} %`;

function node(tag: string, attributes: Record<string, string | number>): SVGElement {
  const element = document.createElementNS("http://www.w3.org/2000/svg", tag);
  for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, String(value));
  return element;
}

function text(content: string, attributes: Record<string, string | number>): SVGElement {
  const element = node("text", attributes);
  element.textContent = content;
  return element;
}
