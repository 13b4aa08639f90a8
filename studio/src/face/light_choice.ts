import { about } from "../api";
import { alertBox } from "../shared/alert";
import { el, freshId } from "../shared/dom";

/** What each light model assumes, for people who choose one. */
const HINTS: Record<string, string> = {
  sphere: "Outdoors, rooms, studios, streets: sky and ground, windows and lamps; uses what stands behind the face.",
  autoencoder: "Daylight outdoors: a sky over level ground.",
  sunsky: "A clear sky and a sun, few parameters.",
  lamps: "Rooms, studios, streets at night: up to three lamps.",
  auto: "One of these two; takes as long as both.",
  sh9: "Quick and soft; assumes nothing, indoors too.",
  sh25: "Soft, with more detail; assumes nothing.",
};

export interface LightChoice {
  element: HTMLElement;
  get chosen(): { name: string; title: string; place: string };
}

/** One of the server's light models, its default at the start, and what kind of place it was. */
export function lightChoice(): LightChoice {
  const group = el("fieldset", {}, el("legend", {}, "What the light may look like"));
  const place = el("select", { id: freshId("place") });
  const alert = alertBox();
  const name = freshId("light");
  let chosen = { name: "sphere", title: "Any place, all round" };
  about().then(({ light: usual, lights, places }) => {
    place.append(...places.map((each) => el("option", { value: each.name }, each.title)));
    chosen = lights.find((light) => light.name === usual) ?? chosen;
    for (const light of lights) {
      const id = freshId("light");
      const input = el("input", { type: "radio", name, id, value: light.name, checked: light.name === chosen.name });
      input.addEventListener("change", () => {
        chosen = light;
      });
      const hint = el("span", { class: "muted small" }, HINTS[light.name] ?? "");
      group.append(el("div", { class: "choice" }, input, el("label", { for: id }, light.title, el("br"), hint)));
    }
  }, alert.show);
  return {
    element: el("div", { class: "stack" }, group, el("label", { for: place.id }, "Where it was taken ", place), alert.element),
    get chosen() {
      return { ...chosen, place: place.value || "auto" };
    },
  };
}
