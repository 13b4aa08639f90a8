import { el, freshId } from "./dom";

export interface Tab {
  name: string;
  title: string;
  panel: HTMLElement;
}

export interface Tabs {
  /** The row of tabs; its panels are for the page to arrange. */
  element: HTMLElement;
  get chosen(): string;
  choose: (name: string) => void;
  /** Those that are of use now. */
  offer: (names: string[]) => void;
}

/** Panels of which one is shown: chosen by a click, or by the arrow keys, Home and End. */
export function tabs(label: string, all: Tab[], changed: (name: string) => void): Tabs {
  let chosen = all[0]!.name;
  const buttons = all.map(({ name, title, panel }) => {
    panel.id ||= freshId("panel");
    const button = el("button", { type: "button", role: "tab", id: freshId("tab"), "aria-controls": panel.id }, title);
    panel.setAttribute("role", "tabpanel");
    panel.setAttribute("aria-labelledby", button.id);
    button.addEventListener("click", () => choose(name));
    return button;
  });
  const show = (): void =>
    all.forEach(({ name, panel }, i) => {
      const isChosen = name === chosen;
      buttons[i]!.setAttribute("aria-selected", String(isChosen));
      buttons[i]!.tabIndex = isChosen ? 0 : -1;
      panel.hidden = !isChosen;
    });
  const choose = (name: string): void => {
    if (name === chosen) return;
    chosen = name;
    show();
    changed(name);
  };
  const element = el("div", { class: "tabs", role: "tablist", "aria-label": label }, ...buttons);
  element.addEventListener("keydown", (event) => {
    const usable = buttons.filter((button) => !button.hidden);
    const at = usable.indexOf(document.activeElement as HTMLButtonElement);
    const to = { ArrowLeft: at - 1, ArrowRight: at + 1, Home: 0, End: usable.length - 1 }[event.key];
    if (at < 0 || to === undefined) return;
    event.preventDefault();
    const button = usable[(to + usable.length) % usable.length]!;
    button.focus();
    button.click();
  });
  show();
  return {
    element,
    get chosen() {
      return chosen;
    },
    choose,
    offer: (names) => {
      all.forEach(({ name }, i) => {
        buttons[i]!.hidden = !names.includes(name);
      });
      element.hidden = names.length < 2;
      if (!names.includes(chosen)) choose(names[0]!);
    },
  };
}
