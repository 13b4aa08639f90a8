import { el, freshId } from "../shared/dom";

/** A labelled number; NaN where the field holds none, which the server then refuses by name. */
export function numberField(
  label: string,
  range: { min: number; max: number; step: number; value: number },
): { element: HTMLElement; get value(): number } {
  const id = freshId("number");
  const input = el("input", { type: "number", id, inputmode: "decimal", ...range });
  return {
    element: el("div", { class: "field" }, el("label", { for: id }, label), input),
    get value() {
      return input.valueAsNumber;
    },
  };
}
