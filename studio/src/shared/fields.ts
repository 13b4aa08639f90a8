import { el, freshId } from "./dom";

export interface Slider {
  element: HTMLElement;
  get value(): number;
  set: (value: number) => void;
}

/** A labelled slider with its value beside it, in words that a screen reader says too. */
export function slider(options: {
  label: string;
  min: number;
  max: number;
  step: number;
  value: number;
  words?: (value: number) => string;
  changed: (value: number) => void;
}): Slider {
  const { label, min, max, step, value, changed } = options;
  const words = options.words ?? String;
  const id = freshId("slider");
  const input = el("input", { type: "range", id, min, max, step, value });
  const output = el("output", { for: id });
  const say = (): void => {
    output.value = words(input.valueAsNumber);
    input.setAttribute("aria-valuetext", output.value);
  };
  input.addEventListener("input", () => {
    say();
    changed(input.valueAsNumber);
  });
  say();
  return {
    element: el(
      "div",
      { class: "field" },
      el("div", { class: "row split" }, el("label", { for: id }, label), output),
      input,
    ),
    get value() {
      return input.valueAsNumber;
    },
    set: (to) => {
      input.valueAsNumber = to;
      say();
    },
  };
}

/** Exposure of the views in stops; `changed` gets the factor 2^stops. Files stay as they are. */
export function exposureSlider(changed: (factor: number) => void): Slider {
  return slider({
    label: "Exposure of the views",
    min: -6,
    max: 6,
    step: 0.25,
    value: 0,
    words: (stops) => `${stops > 0 ? "+" : ""}${stops} EV`,
    changed: (stops) => changed(2 ** stops),
  });
}

/** A labelled choice among a few. */
export function chooser(
  label: string,
  options: { value: string; title: string }[],
  changed: (value: string) => void,
): { element: HTMLElement; select: HTMLSelectElement } {
  const id = freshId("choice");
  const select = el(
    "select",
    { id },
    ...options.map(({ value, title }) => el("option", { value }, title)),
  );
  select.addEventListener("change", () => changed(select.value));
  return {
    element: el("div", { class: "field" }, el("label", { for: id }, label), select),
    select,
  };
}
