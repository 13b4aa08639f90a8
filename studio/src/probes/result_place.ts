import "./result_place.css";
import { el } from "../shared/dom";

/** Where results will be; until there are some, a line says what they will be. */
export function resultPlace(line: string): HTMLElement {
  return el("div", { class: "stack" }, el("p", { class: "to-come" }, line));
}
