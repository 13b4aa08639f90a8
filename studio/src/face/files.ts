import { fileUrl, zipUrl, type JobFile } from "../api";
import { el } from "../shared/dom";
import { downloads, saving } from "../shared/downloads";

/** What each file of an estimate is for. */
const WHAT: Record<string, string> = {
  "probe.exr": "The light as a map, for 3D programs; full range.",
  "probe.hdr": "The same for programs that read no .exr.",
  "probe.png": "The same as a picture to look at.",
  "posterior.exr": "Where the main light may stand, and how likely.",
  "estimate.json": "All numbers, for programs.",
  "report.png": "One page with the photo, the face and the light.",
};
const whatIs = (name: string): string => WHAT[name] ?? (name.endsWith(".obj") ? "The head, to be placed in a 3D scene." : "");

/** The files that most want. */
export function mainFiles(job: string, files: JobFile[]): HTMLElement {
  const maps = files.filter(({ name }) => ["probe.exr", "probe.hdr"].includes(name));
  const buttons = maps.map(({ name }) => {
    const link = saving(fileUrl(job, name), name, name.replace("probe", "Map "));
    link.title = WHAT[name]!;
    return link;
  });
  const all = saving(zipUrl(job), "all files.zip", "All .zip");
  for (const link of [...buttons, all]) link.className = "button";
  return el("section", { class: "row downloads", "aria-label": "Downloads" }, ...buttons, all);
}

/** All of them, with what each is for. */
export const allFiles = (job: string, files: JobFile[]): HTMLElement =>
  el("section", { class: "stack tight all-files" }, el("h2", {}, "Files"), downloads(job, files, whatIs));
