import { about } from "../api";
import { alertBox } from "../shared/alert";
import { el, freshId } from "../shared/dom";
import { chooser } from "../shared/fields";

/** What is said of a place; the studio's own names are for other clients. */
const PLACES: Record<string, [title: string, hint: string]> = {
  auto: ["Decide for me", "The face tells, and what is seen behind it."],
  outdoors: ["Outdoors", "Under the open sky, by day or in a street at night."],
  indoors: ["Indoors", "At home, at work, in a studio or a car."],
  flash: ["Flash", "A flash on the camera lit the face."],
};

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

/** Where the photo was taken; and, for who wants to choose it, the model of its light. */
export function lightChoice(): LightChoice {
  const alert = alertBox();
  const group = el("fieldset", {}, el("legend", {}, "Where was it taken?"));
  const hint = el("p", { class: "muted small" });
  const models = chooser("Model of the light", [], () => say());
  const name = freshId("place");
  let place = "auto";
  let offered = [{ name: "sphere", title: "Any place, all round" }];
  const say = (): void => {
    hint.textContent = HINTS[models.select.value] ?? "";
  };
  about().then(({ light, lights, places }) => {
    offered = lights;
    models.select.append(...lights.map((one) => el("option", { value: one.name, selected: one.name === light }, one.title)));
    say();
    for (const { name: value, title } of places) {
      const id = freshId("place");
      const input = el("input", { type: "radio", name, id, value, checked: value === place });
      input.addEventListener("change", () => {
        place = value;
      });
      const [question, explained] = PLACES[value] ?? [title, ""];
      const words = el("label", { for: id }, question, el("span", { class: "muted small" }, explained));
      group.append(el("div", { class: "choice" }, input, words));
    }
  }, alert.show);
  const more = el("details", { class: "stack tight" }, el("summary", {}, "More"), models.element, hint);
  return {
    element: el("div", { class: "stack" }, group, more, alert.element),
    get chosen() {
      return { ...(offered.find((one) => one.name === models.select.value) ?? offered[0]!), place };
    },
  };
}
