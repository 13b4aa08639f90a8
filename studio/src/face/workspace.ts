import { ApiError, fileUrl, forgetJob, forgetPhoto, getJson, getText, type EstimateResult, type Job, type Photo } from "../api";
import { alertBox } from "../shared/alert";
import { el } from "../shared/dom";
import { chooser, exposureSlider } from "../shared/fields";
import { History, historyKeys } from "../shared/history";
import { jobPanel } from "../shared/job_panel";
import { tinted } from "../shared/radiance_map";
import { currentSession, endSession, updateSession, type FoundLight } from "../shared/session";
import { tabs } from "../shared/tabs";
import { compositePanel, type CompositePanel } from "./composite/panel";
import { headMesh, type Person } from "./composite/people";
import { faceChooser } from "./face_chooser";
import { lightChoice } from "./light_choice";
import { firstStops } from "./light_view";
import { keyButtons } from "./relit/panel";
import { readResult, type Result } from "./result";

export interface Workspace {
  element: HTMLElement;
  /** Forgets the photo, here and in the studio. */
  close: () => void;
}

/**
 * Everything about the photo of the current session in one view: its faces and what is asked of
 * them, then objects in it, the portrait relit, the map, and beside these the verdict and the
 * files. `another` is where the next photo goes.
 */
export function workspace(photo: Photo, another: HTMLElement, closed: () => void): Workspace {
  const kept = currentSession()!;
  const chooser_ = faceChooser(photo);
  const job = jobPanel();
  const light = lightChoice();
  const alert = alertBox();
  const results: Result[] = [];
  let composite: CompositePanel | null = null;
  let factor = 1;
  let isLeft = false;

  const button = (words: string, label: string, onclick: () => void): HTMLButtonElement =>
    el("button", { type: "button", class: "quiet", "aria-label": label, title: label, onclick }, words);
  const undo = button("↶", "Undo (Ctrl-Z)", () => history.undo());
  const redo = button("↷", "Redo (Ctrl-Y)", () => history.redo());
  const history = new History(
    kept.edits,
    (edits) => updateSession({ edits }),
    (canUndo, canRedo) => {
      undo.disabled = !canUndo;
      redo.disabled = !canRedo;
    },
  );
  const leaveKeys = historyKeys(() => (element.isConnected ? history : null));
  undo.disabled = redo.disabled = true;

  // the panels, and what stands beside all of them
  const start = el("button", { type: "button", class: "primary" }, "Find the light");
  const form = el("div", { class: "card stack" });
  if (photo.faces.length === 0) {
    const line = "No face was found in this photo. Take one where a face of 100 pixels or more looks roughly into the camera.";
    form.append(el("p", { class: "alert", role: "alert" }, line));
  } else form.append(light.element, start, job.element, alert.element);
  const panel = (...children: HTMLElement[]): HTMLElement => el("div", { class: "panel" }, ...children);
  const ask = panel(el("div", { class: "beside" }, chooser_.element, form));
  // until there is something to draw it with
  const plain = el("img", { class: "picture plain", src: chooser_.image.src, alt: "Your photo" });
  const objects = panel(plain);
  const portrait = panel();
  const mapPlace = el("div", { class: "stack" });
  const ballsPlace = el("div", {});
  const lampsPlace = el("div", {});
  const map = panel(el("div", { class: "beside" }, mapPlace, ballsPlace), lampsPlace);
  const numbersPlace = el("div", { class: "columns" });
  const details = panel(numbersPlace, el("p", { class: "muted small kept" }, KEPT));
  const side = el("div", { class: "side stack", hidden: true });
  const keys = el(
    "section",
    { class: "stack tight side-keys", "aria-label": "Relight the portrait" },
    el("h2", {}, "Relight from"),
    keyButtons((key) => {
      all.choose("portrait");
      shown()?.relit.open(key);
    }),
  );

  const all = tabs(
    "Views",
    [
      { name: "photo", title: "Photo", panel: ask },
      { name: "objects", title: "Objects", panel: objects },
      { name: "portrait", title: "Portrait", panel: portrait },
      { name: "map", title: "Map", panel: map },
      { name: "result", title: "Result", panel: details },
    ],
    (tab) => {
      element.dataset.tab = tab;
      updateSession({ tab });
      placeLight();
      scrollTo(0, 0); // on a phone the last one may have been scrolled
      if (tab === "portrait") shown()?.relit.open();
    },
  );
  const exposure = exposureSlider((to) => {
    factor = to;
    for (const one of results) one.setExposure(to);
  });
  const lights = chooser("Light shown", [], () => show());
  lights.element.classList.add("row");
  lights.element.hidden = true;
  const shown = (): Result | undefined => results.find(({ title }) => title === lights.select.value);
  /** The panorama is large in its own tab, and beside the others. */
  const placeLight = (): void => {
    const one = shown();
    if (!one) return;
    if (all.chosen === "map") mapPlace.prepend(one.light);
    else one.verdict.after(one.light);
  };
  const show = (): void => {
    const one = shown()!;
    updateSession({ shown: one.title });
    side.replaceChildren(one.verdict, one.downloads, keys);
    portrait.replaceChildren(one.relit.element);
    mapPlace.replaceChildren(exposure.element);
    ballsPlace.replaceChildren(one.balls);
    lampsPlace.replaceChildren(...(one.lamps ? [one.lamps] : []));
    numbersPlace.replaceChildren(...one.details);
    placeLight();
    composite?.show(one.title);
    if (all.chosen === "portrait") one.relit.open();
  };

  const add = async (found: FoundLight, done: Job<EstimateResult>): Promise<void> => {
    const one = await readResult(found.title, photo.name, done, history, {
      showMap: () => all.choose("map"),
      showPortrait: () => all.choose("portrait"),
    });
    if (isLeft) return one.leave();
    if (results.length === 0) {
      exposure.set(firstStops(one.map));
      factor = 2 ** exposure.value;
      start.textContent = "Find this light too, to compare";
      side.hidden = false;
      all.offer(["photo", "objects", "portrait", "map", "result"]);
    }
    results.push(one);
    one.setExposure(factor);
    lights.select.append(el("option", { value: one.title }, one.title));
    lights.element.hidden = results.length < 2;
    lights.select.value = one.title;
    composite?.addLight(...litBy(one, done));
    show();
    all.choose("objects");
    if (composite) return;
    const [people] = await Promise.all([peopleOf(done), chooser_.image.decode(), painted()]);
    if (isLeft) return;
    const faces = photo.faces.map(({ box }) => box);
    composite = compositePanel({ image: chooser_.image, camera: done.result!.camera, people, faces });
    composite.addLight(...litBy(one, done));
    composite.remember(history, () => all.choose("objects"));
    objects.replaceChildren(composite.element);
  };
  const found: FoundLight[] = [];
  const note = (one: FoundLight): void => {
    found.push(one);
    updateSession({ lights: [...found], running: undefined });
  };

  const run = async (): Promise<void> => {
    alert.clear();
    start.disabled = true;
    const face = chooser_.chosen;
    const { name, title, place } = light.chosen;
    const of = photo.faces.length < 2 ? "" : face === "all" ? ", all faces" : `, face ${face}`;
    const called = title + of + (place === "auto" ? "" : `, ${place}`);
    const again = found.filter((one) => one.title.replace(/ \(\d+\)$/, "") === called).length;
    const mine = { job: "", title: `${called}${again ? ` (${again + 1})` : ""}` };
    const request = { kind: "estimate", photo: photo.photo, face, light: name, place };
    const done = await job.run<EstimateResult>(request, (begun) => {
      mine.job = begun;
      updateSession({ running: mine });
    });
    await finish(mine, done);
  };
  const finish = async (mine: FoundLight, done: Job<EstimateResult> | null): Promise<void> => {
    start.disabled = false;
    if (!done) return updateSession({ running: undefined });
    note(mine);
    await add(mine, done);
    if (!isLeft) side.querySelector<HTMLElement>("h2")!.focus({ preventScroll: true });
  };
  start.addEventListener("click", () => void run().catch(alert.show).finally(() => (start.disabled = false)));

  /** What was found before the page was loaded again. */
  const restore = async ({ lights: before, running, shown: title, tab }: typeof kept): Promise<void> => {
    start.disabled = true;
    for (const one of before) {
      const done = await getJson<Job<EstimateResult>>(`/api/jobs/${one.job}`).catch((error: unknown) => {
        if (!(error instanceof ApiError && error.status === 404)) throw error;
        alert.show(`the studio has forgotten the light “${one.title}” meanwhile: find it again`);
      });
      if (!done) continue;
      found.push(one);
      await add(one, done);
    }
    updateSession({ lights: [...found] });
    if (title && results.some((one) => one.title === title)) {
      lights.select.value = title;
      show();
    }
    if (results.length) all.choose(tab ?? "objects");
    if (!running) return;
    updateSession({ running });
    await finish(running, await job.resume<EstimateResult>(running.job));
  };
  const before = { ...kept };

  const close = (): void => {
    isLeft = true;
    leaveKeys();
    job.cancel();
    composite?.dispose();
    for (const one of results) one.leave();
    for (const one of found) forgetJob(one.job);
    forgetPhoto(photo.photo);
    endSession();
  };
  const closing = button("✕", "Close this photo: the studio forgets it and its light", () => {
    close();
    closed();
  });
  const element = el(
    "div",
    { class: "work", "data-tab": "photo" },
    el(
      "div",
      { class: "work-head" },
      el("h1", {}, "Light from a face"),
      all.element,
      el("div", { class: "row work-tools" }, lights.element, undo, redo, another, closing),
    ),
    el("div", { class: "panels" }, ask, objects, portrait, map, details),
    side,
  );
  all.offer(["photo"]);
  restore(before).catch(alert.show).finally(() => (start.disabled = false));
  return { element, close };
}

const KEPT =
  "Photo and results are in the studio’s own folder on the machine that runs it, until you close the photo or the studio ends. " +
  "This tab knows which are yours and what you changed: a reload loses nothing, closing the tab does. Your own 3D models never leave the page.";

const litBy = ({ title, map }: Result, { result }: Job<EstimateResult>) =>
  [title, tinted(map, result!.white_balance), result!.edit] as const;

/** Once what the page shows by now is on the screen. */
const painted = (): Promise<void> =>
  new Promise((go) => requestAnimationFrame(() => requestAnimationFrame(() => go())));

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
