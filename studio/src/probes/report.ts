import { el } from "../shared/dom";
import { valueTable } from "./value_table";

/** What the checks before printing found: report.json, as far as the pages show it. */
export interface PrintReport {
  sound: boolean;
  problems: string[];
  thinnest_wall_mm: number;
  least_clearance_mm: number;
  largest_clearance_mm: number;
  overlap_mm3: number;
  bed_mm: [number, number, number];
  parts: { name: string; watertight: boolean; pieces: number; volume_mm3: number }[];
}

/** The verdict first, then the figures, then each part. */
export function printCheck(report: PrintReport, more: [term: string, value: string][] = []): HTMLElement {
  const { bed_mm: bed, parts } = report;
  const clearances = [report.least_clearance_mm, report.largest_clearance_mm].map((mm) => mm.toFixed(2));
  const numbers: [string, string][] = [
    ["Parts", `${parts.length}, all watertight: ${parts.every((part) => part.watertight) ? "yes" : "no"}`],
    ["Thinnest wall", `${report.thinnest_wall_mm.toFixed(2)} mm`],
    ["Clearances", `${clearances.join(" to ")} mm`],
    ["On the bed", `${bed.map((mm) => mm.toFixed(0)).join(" × ")} mm`],
    ...more,
  ];
  const rows = parts.map(({ name, watertight, volume_mm3 }) => [
    name,
    watertight ? "yes" : "no",
    `${(volume_mm3 / 1000).toFixed(2)} cm³`,
  ]);
  return el(
    "section",
    { class: "card stack tight" },
    el("h2", {}, "Print check"),
    report.sound
      ? el("p", {}, "✓ Sound: nothing stands against printing it.")
      : el("ul", { class: "care" }, ...report.problems.map((line) => el("li", {}, line))),
    el("dl", { class: "numbers" }, ...numbers.flatMap(([dt, dd]) => [el("dt", {}, dt), el("dd", {}, dd)])),
    valueTable("Each part", ["Part", "Watertight", "Volume"], rows),
  );
}
