import { el } from "./dom";

export interface Alert {
  element: HTMLElement;
  show: (error: unknown) => void;
  clear: () => void;
}

/** A place for one line that says what went wrong; read out when it appears, silent when empty. */
export function alertBox(): Alert {
  const element = el("div", { role: "alert" });
  return {
    element,
    show: (error) => {
      if (error instanceof DOMException && error.name === "AbortError") return; // the user's own wish
      const line = error instanceof Error ? error.message : String(error);
      const sentence = line.charAt(0).toUpperCase() + line.slice(1);
      element.replaceChildren(el("p", { class: "alert" }, sentence));
    },
    clear: () => element.replaceChildren(),
  };
}
