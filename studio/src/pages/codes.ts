import "../codes/codes.css";
import type { Page } from "../page";
import { about, fileUrl, type Job } from "../api";
import { activationTable } from "../codes/activation_table";
import { errorChart, percent } from "../codes/error_chart";
import { drawActivations } from "../codes/outlines";
import type { CodeResult } from "../codes/result";
import { lightSource, type GivenLight } from "../probes/light_source";
import { resultPlace } from "../probes/result_place";
import { alertBox } from "../shared/alert";
import { el } from "../shared/dom";
import { downloads } from "../shared/downloads";
import { chooser, exposureSlider, slider } from "../shared/fields";
import { jobPanel } from "../shared/job_panel";
import { panorama } from "../shared/panorama";
import { loadRadianceMap, whiteLevel, type RadianceMap } from "../shared/radiance_map";

export const page: Page = (root) => {
  const alert = alertBox();
  const work = jobPanel();
  const results = resultPlace("The map, the map put together again from its pieces, and how good it is with how many will be here.");
  const begin = el("button", { type: "button", class: "primary", onclick: () => void code() }, "Take it apart");
  const ready = (): void => {
    begin.disabled = source.chosen === undefined;
  };
  const source = lightSource({ changed: ready });
  const dictionary = chooser("Shape of the pieces", [], () => {});
  const count = slider({
    label: "Pieces at most",
    min: 1, max: 256, step: 1, value: 64,
    changed: () => {},
  });
  ready();

  const code = async (): Promise<void> => {
    const light = source.chosen;
    if (!light) return;
    alert.clear();
    results.replaceChildren();
    const job = await work.run<CodeResult>({
      kind: "code",
      dictionary: dictionary.select.value,
      activations: count.value,
      ...light.request,
    });
    if (!job) return;
    try {
      const maps = await Promise.all([light.load(), loadRadianceMap(fileUrl(job.job, "decoded.hdr"))]);
      results.replaceChildren(...shown(light, job, ...maps));
    } catch (error) {
      alert.show(error);
    }
  };

  root.append(
    el("h1", {}, "Light in few pieces"),
    el(
      "p",
      { class: "lead" },
      "A map of light as a sum of a few soft patches, each of its own place, width, turn and colour: a sparse code. " +
        "It is made by this machine; a coarse map takes seconds, a fine one longer.",
    ),
    el(
      "div",
      { class: "beside form-first" },
      results,
      el(
        "div",
        { class: "card stack" },
        source.element, dictionary.element, count.element, begin,
        el("div", {}, work.element, alert.element),
      ),
    ),
  );
  about().then(
    ({ dictionaries }) =>
      dictionary.select.replaceChildren(
        ...dictionaries.map(({ name, title }) => el("option", { value: name }, title)),
      ),
    alert.show,
  );
  return work.cancel;
};

/** What came out: both maps, how good codes of each size are, and their pieces (activations). */
function shown(
  light: GivenLight,
  { job, result, files }: Job<CodeResult>,
  original: RadianceMap,
  decoded: RadianceMap,
): HTMLElement[] {
  const { counts, errors, activations, floats, map_floats } = result!;
  const white = whiteLevel(original);
  const [before, after] = [original, decoded].map((map, i) => {
    const view = panorama(i ? "The map put together from its pieces" : `The map ${light.title} with its pieces drawn on it`);
    view.setMap(map);
    view.setExposure(1 / white);
    return view;
  });
  const chart = errorChart(counts, errors);
  const line = el("p", { role: "status", "aria-live": "polite", class: "small" });
  const show = (number: number): void => {
    before!.setOverlay(drawActivations(activations.slice(0, number)));
    chart.mark(Math.max(1, number));
    const nearest = counts.reduce((best, each, i) => (each <= number ? i : best), 0);
    line.textContent = `With ${counts[nearest]} pieces it is off by ${percent(errors[nearest]!)} (root of the mean square).`;
  };
  const drawn = slider({
    label: "Strongest pieces to show",
    min: 0, max: activations.length, step: 1, value: Math.min(24, activations.length),
    words: (number) => `${number} of ${activations.length}`,
    changed: show,
  });
  show(drawn.value);
  const exposure = exposureSlider((factor) => {
    before!.setExposure(factor / white);
    after!.setExposure(factor / white);
  });
  return [
    el(
      "section",
      { class: "stack", "aria-label": "Maps" },
      el(
        "div",
        { class: "columns" },
        el("figure", {}, before!.element, el("figcaption", {}, "The map; rings where a piece has half its height, dashed where it takes light away")),
        el("figure", {}, after!.element, el("figcaption", {}, `Put together from ${activations.length} pieces: ${floats} numbers for the map's ${map_floats}`)),
      ),
      el("div", { class: "columns" }, drawn.element, exposure.element),
    ),
    el("section", { class: "card stack tight" }, el("h2", {}, "How far off, by the number of pieces"), chart.element, line),
    el("section", { class: "card stack tight" }, el("h2", {}, "The pieces"), activationTable(activations)),
    el("section", { class: "card stack tight" }, el("h2", {}, "Files"), downloads(job, files ?? [])),
  ];
}
