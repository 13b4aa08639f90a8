import type { Page } from "../page";
import type { Group } from "three";
import { fileUrl } from "../api";
import { cellSphere, type Cell } from "../probes/cells";
import { cssColour, inWords } from "../probes/colours";
import { numberField } from "../probes/number_field";
import { probePage } from "../probes/probe_page";
import { printCheck, type PrintReport } from "../probes/report";
import type { Turntable } from "../probes/turntable";
import { swatch, valueTable } from "../probes/value_table";
import { el } from "../shared/dom";
import { chooser } from "../shared/fields";

interface PartitionsResult {
  design: string;
  cells: Cell[];
  report: PrintReport & { pins: number; loss: number[]; leak: number[] };
}

export const page: Page = (root) => {
  const design = chooser("Design", [], () => {});
  const size = numberField("Diameter of the shell (mm)", { min: 20, max: 1000, step: 1, value: 80 });
  return probePage<PartitionsResult>(root, {
    title: "Partitions probe",
    lead:
      "A shell that lets each face of its kernel see one cell of the sphere. The shading of the faces " +
      "is the light of the cells, and any mesh can be lit with it.",
    label: "The probe",
    fields: [design.element, size.element],
    designs: ({ partitions }) => {
      design.select.replaceChildren(
        ...partitions.map(({ name, title }) => el("option", { value: name }, title)),
      );
    },
    request: () => ({ kind: "partitions", design: design.select.value, size_mm: size.value }),
    show: ({ cells, report }, job, turntable, model) => [
      views(cells, turntable, model),
      printCheck(report, [
        ["Pins", String(report.pins)],
        ["Light lost", `${mean(report.loss)} of a cell's, on average`],
        ["Light of other cells", `${mean(report.leak)}, on average`],
      ]),
      cellsOf(cells, job),
    ],
  });
};

const mean = (shares: number[]): string =>
  `${((100 * shares.reduce((a, b) => a + b, 0)) / shares.length).toFixed(1)} %`;

/** What radiance shows as white: the brightest cell's largest channel. */
const whiteOf = (cells: Cell[]): number => Math.max(1e-30, ...cells.flatMap(({ radiance }) => radiance ?? []));

/** The same probe in several ways: the parts, its cells, and the light that they tell of. */
function views(cells: Cell[], turntable: Turntable, model: Group): HTMLElement {
  const shell = model.children.filter(({ name }) => !name.includes("kernel"));
  const parts = (whole: boolean) => () => {
    for (const part of shell) part.visible = whole;
    return model;
  };
  const white = whiteOf(cells);
  const all: Record<string, { title: string; object: () => Group }> = {
    cells: { title: "Its cells on the sphere", object: () => cellSphere(cells, ({ colour }) => colour) },
    parts: { title: "The parts, assembled", object: parts(true) },
    kernel: { title: "The kernel alone", object: parts(false) },
  };
  if (cells[0]?.radiance) {
    const scaled = ({ radiance }: Cell) => radiance!.map((value) => value / white) as [number, number, number];
    all.light = { title: "The light that the cells tell of", object: () => cellSphere(cells, scaled) };
  }
  const options = Object.entries(all).map(([value, { title }]) => ({ value, title }));
  const choice = chooser("Show", options, (value) => turntable.show(all[value]!.object()));
  choice.select.value = all.light ? "light" : "cells";
  turntable.show(all[choice.select.value]!.object());
  return choice.element;
}

function cellsOf(cells: Cell[], job: string): HTMLElement {
  const lit = cells[0]?.radiance !== undefined;
  const white = whiteOf(cells);
  const rows = cells.map((cell) => [
    swatch(cssColour(lit ? cell.radiance!.map((value) => value / white) : cell.colour), String(cell.number + 1)),
    cell.solid_angle_sr.toFixed(3),
    cell.direction.map((value) => value.toFixed(2)).join(", "),
    ...(lit ? [inWords(cell.shading!), inWords(cell.radiance!)] : []),
  ]);
  const heads = ["Cell", "Solid angle (sr)", "Face looks (x, y, z)", ...(lit ? ["Shading (R, G, B)", "Radiance (R, G, B)"] : [])];
  const picture = lit ? "lightmap.png" : "cells.png";
  const alt = lit
    ? "The chosen light as a panorama, and below it what the cells tell of it"
    : "The cells as a lat-long picture, each in its colour";
  return el(
    "section",
    { class: "card stack tight" },
    el("h2", {}, lit ? "The light, and what the probe tells of it" : "Cells"),
    el("img", { class: "lightmap", src: fileUrl(job, picture), alt }),
    valueTable(`The ${cells.length} cells as a table`, heads, rows),
  );
}
