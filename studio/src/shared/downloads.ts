import { fileUrl, zipUrl, type JobFile } from "../api";
import { el } from "./dom";

const size = (bytes: number): string =>
  bytes < 1000 ? `${bytes} B` : bytes < 1e6 ? `${Math.round(bytes / 1e3)} kB` : `${(bytes / 1e6).toFixed(1)} MB`;

/** A link that saves a file. */
export const saving = (href: string, name: string, ...words: (Node | string)[]): HTMLAnchorElement =>
  el("a", { href: `${href}?download=1`, download: name }, ...words);

/** Links to every file of a job, with what it is where `what` knows, and to all of them in one zip. */
export function downloads(job: string, files: JobFile[], what: (name: string) => string = () => ""): HTMLElement {
  const line = (href: string, name: string, note: string): HTMLElement =>
    el("li", {}, saving(href, name, name, el("span", { class: "muted" }, note)), what(name));
  return el(
    "ul",
    { class: "files", "aria-label": "Files" },
    ...files.map((file) => line(fileUrl(job, file.name), file.name, size(file.size))),
    line(zipUrl(job), "all files.zip", ""),
  );
}
