type Attributes = Record<string, string | number | boolean | undefined | ((event: never) => void)>;

/**
 * An element: `el("button", { class: "primary", onclick: start }, "Start")`. Attributes that are
 * functions become listeners (`onclick`); false and undefined are left out, true is empty.
 */
export function el<K extends keyof HTMLElementTagNameMap>(
  tag: K,
  attributes: Attributes = {},
  ...children: (Node | string)[]
): HTMLElementTagNameMap[K] {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (typeof value === "function")
      element.addEventListener(name.replace(/^on/, ""), value as EventListener);
    else if (value === true) element.setAttribute(name, "");
    else if (value !== undefined && value !== false) element.setAttribute(name, String(value));
  }
  element.append(...children);
  return element;
}

let count = 0;
/** An id that no other element has. */
export const freshId = (prefix: string): string => `${prefix}-${++count}`;
