import { exampleFile, examples, exampleUrl } from "../api";
import { el } from "../shared/dom";

/** Photographs to try, each a button with what to expect of it; `chosen` is given its file. */
export async function exampleRow(chosen: (file: Promise<File>) => void): Promise<HTMLElement> {
  const buttons = (await examples()).map(({ name, description, expected, credit }) =>
    el(
      "button",
      { type: "button", class: "example", onclick: () => chosen(exampleFile(name)) },
      el("img", { src: exampleUrl(name), alt: `${description}.`, width: 72, height: 72 }),
      el(
        "span",
        {},
        expected.charAt(0).toUpperCase() + expected.slice(1),
        el("span", { class: "muted small" }, credit),
      ),
    ),
  );
  const title = "Try one of these";
  return el(
    "section",
    { class: "stack tight", "aria-label": title },
    el("h2", {}, title),
    el("div", { class: "row" }, ...buttons),
  );
}
