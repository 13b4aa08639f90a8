import { el } from "../shared/dom";
import "../shared/tables.css";

/** A table that opens on demand; a row's first cell is its head. */
export function valueTable(summary: string, heads: string[], rows: (string | Node)[][]): HTMLElement {
  return el(
    "details",
    {},
    el("summary", {}, summary),
    el(
      "div",
      { class: "scroller", tabindex: 0, role: "region", "aria-label": summary },
      el(
        "table",
        {},
        el("thead", {}, el("tr", {}, ...heads.map((head) => el("th", { scope: "col" }, head)))),
        el(
          "tbody",
          {},
          ...rows.map(([first, ...others]) =>
            el("tr", {}, el("th", { scope: "row" }, first!), ...others.map((cell) => el("td", {}, cell))),
          ),
        ),
      ),
    ),
  );
}

/** A text with a patch of a CSS colour before it, which adds nothing that is not said. */
export function swatch(colour: string, text: string): HTMLElement {
  const patch = el("span", { class: "swatch", "aria-hidden": "true" });
  patch.style.background = colour;
  return el("span", {}, patch, text);
}
