import type { Page } from "../page";
import { fileUrl } from "../api";
import { cssColour, inWords } from "../probes/colours";
import { numberField } from "../probes/number_field";
import { probePage } from "../probes/probe_page";
import { printCheck, type PrintReport } from "../probes/report";
import { swatch, valueTable } from "../probes/value_table";
import { el } from "../shared/dom";
import { chooser } from "../shared/fields";

interface VoxelResult {
  voxels: boolean[][][];
  captured: number;
  report: PrintReport & { voxels: number; material_saved: number };
  lightmap?: {
    orientation: string;
    occluders: string[];
    captured: boolean;
    radiance: [number, number, number];
  }[];
  exposure?: number;
  reconstruction_error?: number;
}

export const page: Page = (root) => {
  const probe = chooser("Design", [], () => {});
  const face = numberField("Side of a voxel (mm)", { min: 5, max: 200, step: 0.5, value: 20 });
  const wall = numberField("Walls (mm)", { min: 0.8, max: 50, step: 0.1, value: 1.6 });
  return probePage<VoxelResult>(root, {
    title: "Voxel probe",
    lead:
      "A printed star of voxels shows in a photograph how light falls on faces that look six ways, " +
      "more or less hidden by their neighbours. Voxel models are lit with what it shows.",
    label: "The probe as assembled",
    fields: [probe.element, face.element, wall.element],
    designs: ({ voxel }) => {
      probe.select.replaceChildren(
        ...voxel.map(({ probe: size, title }) => el("option", { value: size, selected: size === 3 }, title)),
      );
    },
    request: () => ({
      kind: "voxel",
      probe: Number(probe.select.value),
      face_mm: face.value,
      wall_mm: wall.value,
    }),
    show: (result, job) => [
      printCheck(result.report, [
        ["Voxels", String(result.report.voxels)],
        ["Material saved", `${(100 * result.report.material_saved).toFixed(0)} % of a solid one`],
      ]),
      ...lightmapOf(result, job),
    ],
  });
};

/** The shading of every kind of face, where a light was given. */
function lightmapOf({ lightmap, captured, exposure, reconstruction_error: error }: VoxelResult, job: string): HTMLElement[] {
  if (!lightmap) return [];
  const rows = lightmap.map((slot, i) => [
    swatch(cssColour(slot.radiance.map((value) => value * (exposure ?? 1))), String(i + 1)),
    slot.orientation,
    slot.occluders.join(", ") || "none",
    slot.captured ? "seen" : "completed",
    inWords(slot.radiance),
  ]);
  const heads = ["Kind", "Looks", "Beside it", "How known", "Radiance (R, G, B)"];
  return [
    el(
      "section",
      { class: "card stack tight" },
      el("h2", {}, "Lightmap"),
      el("p", {}, `The probe shows ${captured} of the ${lightmap.length} kinds of faces; the others are completed from them` +
        (error === undefined ? "." : `, ${(100 * error).toFixed(1)} % off.`)),
      el(
        "figure",
        {},
        el("img", {
          class: "lightmap",
          src: fileUrl(job, "lightmap.png"),
          alt: "The shading of all kinds of faces under the chosen light, a small square for each; the table has the values",
        }),
        el("figcaption", {}, "A square for each kind of face. The preview above wears it."),
      ),
      valueTable("The kinds of faces as a table", heads, rows),
    ),
  ];
}
