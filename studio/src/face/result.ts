import { fileUrl, type EstimateResult, type Job } from "../api";
import { el } from "../shared/dom";
import type { History } from "../shared/history";
import { loadRadianceMap, type RadianceMap } from "../shared/radiance_map";
import { allFiles, mainFiles } from "./files";
import { lampEditor } from "./lamp_editor";
import { lightView } from "./light_view";
import { relitPanel, type RelitPanel } from "./relit/panel";
import { verdictCard } from "./verdict";

/** One estimate, in parts for the page to arrange. */
export interface Result {
  title: string;
  map: RadianceMap;
  verdict: HTMLElement;
  /** The panorama with its legend. */
  light: HTMLElement;
  balls: HTMLElement;
  /** Where there are lamps. */
  lamps: HTMLElement | null;
  relit: RelitPanel;
  downloads: HTMLElement;
  /** All numbers and files. */
  details: HTMLElement[];
  setExposure: (factor: number) => void;
  leave: () => void;
}

/** `showMap` and `showPortrait` bring into sight what a change of the history changes. */
export async function readResult(
  title: string,
  photo: string,
  job: Job<EstimateResult>,
  history: History,
  { showMap, showPortrait }: { showMap: () => void; showPortrait: () => void },
): Promise<Result> {
  const result = job.result!;
  const [map, density] = await Promise.all([
    loadRadianceMap(fileUrl(job.job, "probe.exr")),
    loadRadianceMap(fileUrl(job.job, "posterior.exr")),
  ]);
  const view = lightView(title, result, map, result.posterior.is_seen ? density : null);
  const relit = relitPanel(job.job, title, history, showPortrait);
  const { lamp_facts } = result;
  return {
    title,
    map,
    verdict: verdictCard(result.verdict, result.advice, photo),
    light: view.figure,
    balls: view.balls,
    lamps: lamp_facts
      ? lampEditor(job.job, result.lamps, lamp_facts, view.panorama, { shown: view.setMap, history, bring: showMap })
      : null,
    relit,
    downloads: mainFiles(job.job, job.files ?? []),
    details: [
      el("section", { class: "stack tight" }, el("h2", {}, "Details"), view.numbers),
      allFiles(job.job, job.files ?? []),
    ],
    setExposure: view.setExposure,
    leave: relit.leave,
  };
}
