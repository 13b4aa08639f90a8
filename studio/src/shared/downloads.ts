import { fileUrl, zipUrl, type JobFile } from "../api";
import { el } from "./dom";

const size = (bytes: number): string =>
  bytes < 1000 ? `${bytes} B` : bytes < 1e6 ? `${Math.round(bytes / 1e3)} kB` : `${(bytes / 1e6).toFixed(1)} MB`;

/** Links to every file of a job, and to all of them in one zip. */
export function downloads(job: string, files: JobFile[]): HTMLElement {
  const link = (href: string, name: string, note: string): HTMLElement =>
    el(
      "li",
      {},
      el("a", { href: `${href}?download=1`, download: name }, name, el("span", { class: "muted" }, note)),
    );
  return el(
    "ul",
    { class: "files", "aria-label": "Files" },
    ...files.map((file) => link(fileUrl(job, file.name), file.name, size(file.size))),
    link(zipUrl(job), "all files.zip", ""),
  );
}
