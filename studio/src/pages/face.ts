import { about, fileUrl, forgetJob, getText, uploadPhoto, type EstimateResult, type Job, type Photo } from "../api";
import { compositePanel, type CompositePanel } from "../face/composite/panel";
import { headMesh, type Person } from "../face/composite/people";
import { exampleRow } from "../face/example_row";
import "../face/face.css";
import { faceChooser, type FaceChooser } from "../face/face_chooser";
import { lightChoice } from "../face/light_choice";
import { firstStops } from "../face/light_view";
import { resultCard, type ResultCard } from "../face/result_card";
import type { Page } from "../page";
import { alertBox } from "../shared/alert";
import { el } from "../shared/dom";
import { exposureSlider } from "../shared/fields";
import { fileDrop } from "../shared/file_drop";
import { jobPanel } from "../shared/job_panel";
import { tinted } from "../shared/radiance_map";
import { forgetLight, rememberLight } from "../shared/session";

// Built once and kept while the tab lives: who comes back from another page finds it as it was.
let built: HTMLElement | null = null;

export const page: Page = (root) => {
  built ??= build();
  root.append(built);
  return () => {};
};

function build(): HTMLElement {
  const alert = alertBox();
  const work = el("div", { class: "stack" });
  const said = el("p", { class: "visually-hidden", role: "status" });
  let shown: { leave: () => void } | null = null;
  let asking: AbortController | null = null;

  const take = async (chosen: File | Promise<File>): Promise<void> => {
    asking?.abort();
    const mine = (asking = new AbortController());
    alert.clear();
    drop.element.setAttribute("aria-busy", "true");
    said.textContent = "Looking for faces";
    busy.hidden = false;
    try {
      const photo = await uploadPhoto(await chosen, mine.signal);
      if (mine.signal.aborted) return;
      const count = photo.faces.length;
      said.textContent = `${count} ${count === 1 ? "face" : "faces"} found`;
      shown?.leave();
      const next = photoWork(photo);
      shown = next;
      work.replaceChildren(next.element);
      drop.element.classList.add("small");
      prompt.hidden = true;
    } catch (error) {
      if (asking !== mine) return;
      said.textContent = "";
      alert.show(error);
    } finally {
      if (asking === mine) {
        busy.hidden = true;
        drop.element.removeAttribute("aria-busy");
      }
    }
  };
  const drop = fileDrop({
    prompt: "Drop a photo here, paste one, or",
    button: "Choose a photo",
    accept: "image/jpeg,image/png,image/tiff,image/webp,image/bmp,image/avif,.heic,.heif,.hif,.exr,.hdr",
    paste: true,
    chosen: (file) => void take(file),
  });
  const prompt = drop.element.querySelector("p")!;
  const limits = el("p", { class: "muted small" });
  drop.element.append(limits);
  about().then(({ limits: { upload_mb, megapixels } }) => {
    limits.textContent = `Up to ${upload_mb} MB and ${megapixels} megapixels. It stays on the machine that runs the studio.`;
  }, alert.show);
  const tries = el("div", {});
  exampleRow((file) => void take(file)).then((row) => tries.append(row), alert.show);
  const busy = el("p", { class: "muted", "aria-hidden": "true" }, "Looking for faces …");
  busy.hidden = true;
  return el(
    "div",
    { class: "stack" },
    el(
      "div",
      {},
      el("h1", {}, "Light from a face"),
      el(
        "p",
        { class: "lead" },
        "A face in a photo tells where the light came from. Give one portrait, and get its light as an environment map, with an object of yours standing in it.",
      ),
    ),
    drop.element,
    tries,
    busy,
    alert.element,
    said,
    work,
  );
}

/** Everything about one photo: its faces, the choice of light, the job, the results. */
function photoWork(photo: Photo): { element: HTMLElement; leave: () => void } {
  const chooser: FaceChooser = faceChooser(photo);
  const job = jobPanel();
  const light = lightChoice();
  const start = el("button", { type: "button", class: "primary" }, "Find the light");
  const results = el("div", { class: "stack results" });
  const cards: ResultCard[] = [];
  const jobs: string[] = [];
  const names: string[] = [];
  const alert = alertBox();
  let isLeft = false;
  let composite: CompositePanel | null = null;
  let factor = 1;

  const exposure = exposureSlider((to) => {
    factor = to;
    for (const card of cards) card.setExposure(to);
  });
  const columns = el("div", { class: "columns" });
  const picture = el("div", {});

  const run = async (): Promise<void> => {
    start.disabled = true;
    const face = chooser.chosen;
    const { name, title, place } = light.chosen;
    const done = await job.run<EstimateResult>({ kind: "estimate", photo: photo.photo, face, light: name, place });
    start.disabled = false;
    if (!done) return;
    jobs.push(done.job);
    const of = photo.faces.length < 2 ? "" : face === "all" ? ", all faces" : `, face ${face}`;
    const again = names.filter((one) => one === title + of).length;
    names.push(title + of);
    const name_ = `${title}${of}${again ? ` (${again + 1})` : ""}`;
    const card = await resultCard(name_, done);
    const people = composite ? [] : await peopleOf(done);
    if (isLeft) return;
    rememberLight({ job: done.job, title: `${photo.name}: ${name_}` });
    if (cards.length === 0) {
      exposure.set(firstStops(card.map));
      factor = 2 ** exposure.value;
      composite = compositePanel({
        image: chooser.image,
        camera: done.result!.camera,
        people,
        faces: photo.faces.map(({ box }) => box),
      });
      picture.append(composite.element);
      results.append(
        section("In your photo", picture),
        section("The light", exposure.element, columns),
      );
      start.textContent = "Find this light too, to compare";
      head.classList.add("has-results");
    }
    cards.push(card);
    card.setExposure(factor);
    columns.append(card.element);
    composite!.addLight(name_, tinted(card.map, done.result!.white_balance), done.result!.edit);
    (cards.length === 1 ? results : card.element).querySelector<HTMLElement>("[tabindex='-1']")?.focus();
  };
  start.addEventListener("click", () => {
    alert.clear();
    run().catch(alert.show);
  });

  const head = el("div", { class: "beside" });
  const side = el("div", { class: "card stack" });
  if (photo.faces.length === 0) {
    const line = "No face was found in this photo. Take one where a face of 100 pixels or more looks roughly into the camera.";
    side.append(el("p", { class: "alert", role: "alert" }, line));
  } else side.append(light.element, start, job.element, alert.element);
  head.append(chooser.element, side);
  return {
    element: el("div", { class: "stack" }, head, results),
    leave: () => {
      isLeft = true;
      job.cancel();
      composite?.dispose();
      for (const card of cards) card.leave();
      for (const one of jobs) {
        forgetJob(one);
        forgetLight(one);
      }
    },
  };
}

/** The people of an estimate, with their heads. */
function peopleOf({ job, files, result }: Job<EstimateResult>): Promise<Person[]> {
  const meshes = files!.map(({ name }) => name).filter((name) => name.endsWith(".obj"));
  const numbered = meshes.sort((a, b) => a.localeCompare(b, "en", { numeric: true })); // in the faces' order
  return Promise.all(
    result!.faces.map(async ({ eyes, forward, albedo }, i) => ({
      head: headMesh(await getText(fileUrl(job, numbered[i]!))),
      eyes,
      forward,
      albedo,
    })),
  );
}

function section(title: string, ...children: HTMLElement[]): HTMLElement {
  return el("section", { class: "stack", "aria-label": title }, el("h2", { tabindex: -1 }, title), ...children);
}
