import { el, freshId } from "../../shared/dom";

export interface LengthField {
  element: HTMLElement;
  set: (metres: number) => void;
  setLabel: (label: string) => void;
}

/** A length to be typed in centimetres, or set by a slider that goes in equal ratios. */
export function lengthField(options: {
  label: string;
  least: number; // metres
  most: number;
  value: number;
  changed: (metres: number) => void;
}): LengthField {
  const { least, most, changed } = options;
  const id = freshId("length");
  const label = el("label", { for: id });
  const typed = el("input", { type: "number", id, min: 100 * least, max: 100 * most, step: "any", inputmode: "decimal" });
  typed.className = "length";
  const slid = el("input", { type: "range", min: Math.log10(least), max: Math.log10(most), step: 0.005 });
  const say = (metres: number): void => {
    typed.value = String(Number((100 * metres).toPrecision(3)));
    slid.setAttribute("aria-valuetext", `${typed.value} cm`);
  };
  const set = (metres: number): void => {
    say(metres);
    slid.valueAsNumber = Math.log10(metres);
  };
  const setLabel = (to: string): void => {
    label.textContent = `${to}, cm`;
    slid.setAttribute("aria-label", to);
  };
  typed.addEventListener("change", () => {
    const metres = Math.min(most, Math.max(least, typed.valueAsNumber / 100));
    if (!Number.isFinite(metres)) return;
    set(metres);
    changed(metres);
  });
  slid.addEventListener("input", () => {
    const metres = 10 ** slid.valueAsNumber;
    say(metres);
    changed(metres);
  });
  set(options.value);
  setLabel(options.label);
  return {
    element: el("div", { class: "field" }, el("div", { class: "row split" }, label, typed), slid),
    set,
    setLabel,
  };
}
