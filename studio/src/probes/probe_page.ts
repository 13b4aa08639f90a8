import "./probes.css";
import { GLTFLoader } from "three/addons/loaders/GLTFLoader.js";
import type { Group } from "three";
import { fileUrl, getBytes, getJson, type Job } from "../api";
import { alertBox } from "../shared/alert";
import { el } from "../shared/dom";
import { downloads } from "../shared/downloads";
import { jobPanel } from "../shared/job_panel";
import { resultPlace } from "./result_place";
import { lightSource } from "./light_source";
import { Turntable } from "./turntable";

/** What the server can make (GET /api/designs). */
export interface Designs {
  voxel: { probe: number; title: string }[];
  partitions: { name: string; title: string; cells: number }[];
}

/**
 * A page that has a probe made: its fields, a light if the user has one, and what came out, which
 * `show` puts together; it may use the turntable, which shows `model` at first.
 */
export function probePage<Result>(
  root: HTMLElement,
  options: {
    title: string;
    lead: string;
    label: string;
    fields: HTMLElement[];
    designs: (designs: Designs) => void;
    request: () => { kind: string; [key: string]: unknown };
    show: (result: Result, job: string, turntable: Turntable, model: Group) => HTMLElement[];
  },
): () => void {
  const alert = alertBox();
  const work = jobPanel();
  const results = resultPlace("The probe, what the checks before printing say, and its files will be here.");
  const source = lightSource({ none: "None: the probe alone", changed: () => {} });
  const begin = el(
    "button",
    { type: "button", class: "primary", disabled: true, onclick: () => void make() },
    "Make the probe",
  );
  let turntable: Turntable | undefined;

  const make = async (): Promise<void> => {
    alert.clear();
    results.replaceChildren();
    turntable?.dispose();
    turntable = undefined;
    const job = await work.run<Result>({ ...options.request(), ...source.chosen?.request });
    if (!job) return;
    try {
      await present(job);
    } catch (error) {
      alert.show(error);
    }
  };
  const present = async ({ job, result, files }: Job<Result>): Promise<void> => {
    const bytes = await getBytes(fileUrl(job, "preview.glb"));
    const { scene } = await new GLTFLoader().parseAsync(bytes, "");
    turntable = new Turntable(options.label);
    turntable.show(scene);
    results.replaceChildren(
      turntable.element,
      ...options.show(result!, job, turntable, scene),
      el("section", { class: "card stack tight" }, el("h2", {}, "Files"), downloads(job, files ?? [])),
    );
  };

  root.append(
    el("h1", {}, options.title),
    el("p", { class: "lead" }, options.lead),
    el(
      "div",
      { class: "beside form-first" },
      results,
      el("div", { class: "card stack" }, ...options.fields, source.element, begin, el("div", {}, work.element, alert.element)),
    ),
  );
  getJson<Designs>("/api/designs").then((designs) => {
    options.designs(designs);
    begin.disabled = false;
  }, alert.show);
  return () => {
    work.cancel();
    turntable?.dispose();
  };
}
