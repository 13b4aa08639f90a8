import { fileUrl, type EstimateResult, type Job } from "../api";
import { el } from "../shared/dom";
import { downloads } from "../shared/downloads";
import { loadRadianceMap, type RadianceMap } from "../shared/radiance_map";
import { lampEditor } from "./lamp_editor";
import { lightView } from "./light_view";
import { relitPanel } from "./relit/panel";

export interface ResultCard {
  element: HTMLElement;
  map: RadianceMap;
  setExposure: (factor: number) => void;
  leave: () => void;
}

/** One estimate: its light as panorama and balls, where the sun may stand, numbers, files. */
export async function resultCard(title: string, job: Job<EstimateResult>): Promise<ResultCard> {
  const result = job.result!;
  const [map, density] = await Promise.all([
    loadRadianceMap(fileUrl(job.job, "probe.exr")),
    loadRadianceMap(fileUrl(job.job, "posterior.exr")),
  ]);
  const view = lightView(title, result, map, result.posterior.is_seen ? density : null);
  const relit = relitPanel(job.job, title);
  const element = el(
    "article",
    { class: "card stack result", "aria-label": title },
    el("h3", { tabindex: -1 }, title),
    el(
      "div",
      { class: "result-grid" },
      view.figure,
      view.balls,
      ...(result.lamp_facts ? [lampEditor(job.job, result.lamps, result.lamp_facts, view.panorama, view.setMap)] : []),
      relit.element,
      view.numbers,
      el("div", { class: "stack" }, ...view.advice, downloads(job.job, job.files ?? [])),
    ),
  );
  return { element, map, leave: relit.leave, setExposure: view.setExposure };
}
