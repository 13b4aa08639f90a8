import { compositePanel } from "../face/composite/panel";
import "../face/face.css";
import { firstStops, lightView } from "../face/light_view";
import { inWordsOf, sentence } from "../face/verdict";
import { alertBox } from "../shared/alert";
import { el } from "../shared/dom";
import { exposureSlider } from "../shared/fields";
import { tinted } from "../shared/radiance_map";
import { bytesOf, decodeMap, peopleOf, readData, type ViewerData } from "./data";
import "./viewer.css";

/** The page of one estimate, all of it from what the page itself holds. */
async function show(main: HTMLElement, data: ViewerData): Promise<void> {
  const { result, name } = data;
  document.title = `The light of ${name}`;
  const lead =
    "The light in which this photograph was taken, found by its faces, and an object that stands in the same light. " +
    "All of it is in this one file: nothing is fetched and nothing is sent.";
  const { light: found, doubt } = result.verdict;
  const told = inWordsOf(result.verdict).map(([name, words]) => `${name}: ${words}.`);
  const verdict = el(
    "p",
    { class: doubt ? "verdict care" : "verdict", role: "note" },
    el("strong", {}, `${sentence(found)}.`),
    ` ${told.join(" ")}`,
  );
  const picture = el("div", { class: "stack" });
  const light = el("div", { class: "stack" });
  main.append(
    el("div", {}, el("h1", {}, `The light of ${name}`), el("p", { class: "lead" }, lead)),
    verdict,
    section("In the photograph", picture),
    section("The light", light),
    el("footer", { class: "muted small" }, `Made by skylight ${data.version}.`),
  );

  const image = el("img", { class: "picture", alt: "The photograph" });
  image.src = `data:image/jpeg;base64,${data.photo.jpeg}`;
  await image.decode();
  const composite = compositePanel({ image, camera: result.camera, people: peopleOf(data), faces: [] });
  picture.append(composite.element);
  if (!composite.element.querySelector("canvas")) picture.append(image); // it says why it cannot draw
  const map = decodeMap(data.probe);
  composite.addLight("the estimate", tinted(map, result.white_balance), result.edit);
  if (data.object) composite.showModel(new File([bytesOf(data.object.content)], data.object.name));

  const view = lightView(name, result, map, data.posterior && decodeMap(data.posterior));
  const exposure = exposureSlider(view.setExposure);
  exposure.set(firstStops(map));
  view.setExposure(2 ** exposure.value);
  const advice = el("div", { class: "stack" }, ...view.advice);
  advice.hidden = view.advice.length === 0;
  light.append(
    exposure.element,
    el(
      "div",
      { class: "card result" },
      el("div", { class: "result-grid" }, view.figure, view.balls, view.numbers, advice),
    ),
  );
}

const section = (title: string, ...children: HTMLElement[]): HTMLElement =>
  el("section", { class: "stack", "aria-label": title }, el("h2", {}, title), ...children);

const main = document.querySelector<HTMLElement>("#main")!;
const alert = alertBox();
// A file dropped beside its place would make the browser leave for it.
for (const kind of ["dragover", "drop"] as const)
  addEventListener(kind, (event) => event.preventDefault());
main.append(alert.element);
const data = readData();
if (data) show(main, data).catch(alert.show);
else alert.show("This page holds no estimate: skylight export viewer writes one into it.");
