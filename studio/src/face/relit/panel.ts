import { fileUrl, forgetJob, getBytes, type Angles } from "../../api";
import { alertBox } from "../../shared/alert";
import { el, freshId } from "../../shared/dom";
import { slider } from "../../shared/fields";
import { inWords } from "../../shared/frame";
import { jobPanel } from "../../shared/job_panel";
import { panorama } from "../../shared/panorama";
import { whiteLevel } from "../../shared/radiance_map";
import { lampHandles } from "../lamp_handles";
import { readPerson, type Facts, type Person } from "./person";
import { RelitPicture } from "./picture";
import { SunLight } from "./sun_light";

const FILE = "portrait.safetensors";
const MOST_TIMES = 4;
const LOWEST_SUN = 89; // zenith angle: a sun that has set lights nobody

/**
 * The photographed person of an estimate, with its `main` light ("sun" or "main lamp") to be moved.
 * The person is taken apart when the user asks for it: it takes some seconds.
 */
export function relitPanel(job: string, title: string, main: string): { element: HTMLElement; leave: () => void } {
  const work = jobPanel();
  const alert = alertBox();
  const begin = el("button", { type: "button" }, `Move the ${main} in the portrait`);
  const place = el("div", { class: "stack" }, el("div", { class: "row" }, begin), work.element, alert.element);
  let picture: RelitPicture | null = null;
  let isLeft = false;

  const show = async (): Promise<void> => {
    begin.disabled = true;
    alert.clear();
    try {
      const done = await work.run({ kind: "portrait", job });
      if (!done) return;
      const person = readPerson(await getBytes(fileUrl(done.job, FILE)));
      forgetJob(done.job); // all of it is here now
      if (isLeft) return;
      const view = relitView(person, title, main);
      picture = view.picture;
      place.replaceChildren(view.element);
      view.focus();
    } finally {
      begin.disabled = false;
    }
  };
  begin.addEventListener("click", () => void show().catch(alert.show));
  return {
    element: el(
      "section",
      { class: "stack lamps", "aria-label": `The portrait with its ${main} moved: ${title}` },
      el("h4", {}, "The portrait relit"),
      place,
    ),
    leave: () => {
      isLeft = true;
      work.cancel();
      picture?.dispose();
    },
  };
}

function relitView(
  person: Person,
  title: string,
  main: string,
): { element: HTMLElement; picture: RelitPicture; focus: () => void } {
  const { facts } = person;
  const { width, height } = person.picture;
  const canvas = el("canvas", { class: "picture relit", role: "img" });
  // as large as the picture would be, however many pixels it has just now
  canvas.style.width = `min(${width}px, ${(75 * width) / height}vh)`;
  canvas.style.aspectRatio = `${width} / ${height}`;
  const light = new SunLight(person);
  const picture = new RelitPicture(canvas, person, light);
  const lowest = facts.is_lamp ? 180 : LOWEST_SUN;
  const found = { ...facts.sun, zenith_deg: Math.min(facts.sun.zenith_deg, lowest) };
  const sun = { ...found, on: true };
  let times = 1;

  let asked = 0;
  const draw = (): void => {
    asked = 0;
    picture.draw(light.under(sun.azimuth_deg, sun.zenith_deg, times));
    canvas.setAttribute("aria-label", `The portrait, its ${main} ${inWords(sun.azimuth_deg, sun.zenith_deg)}`);
    canvas.dataset.shows = JSON.stringify([sun.azimuth_deg, sun.zenith_deg, times]);
  };
  const command = el("code", {});
  const changed = (): void => {
    command.textContent = commandOf(facts, sun, times);
    asked ||= requestAnimationFrame(draw); // once a frame, however fast the sun moves
  };

  const said = el("p", { class: "visually-hidden", role: "status" });
  const map = panorama(`${title}: the light around the camera without its ${main}`);
  map.setMap(person.restMap);
  map.setExposure(1 / whiteLevel(person.restMap));
  const mark = facts.is_lamp ? "1" : "☀";
  const name = main.charAt(0).toUpperCase() + main.slice(1);
  const say = (line: string): void => {
    said.textContent = line;
  };
  const handles = lampHandles(map.element, [sun], changed, say, () => [name, mark], lowest);

  const strength = slider({
    label: `Strength of the ${main}`,
    min: 0,
    max: MOST_TIMES,
    step: 0.05,
    value: 1,
    words: (value) => `${value.toFixed(2)} × ${facts.was_found ? "found" : "added"}`,
    changed: (value) => {
      times = value;
      changed();
    },
  });
  strength.element.hidden = facts.strength === null; // a multiple of nothing
  const reset = el("button", { type: "button" }, "Reset");
  reset.addEventListener("click", () => {
    Object.assign(sun, found);
    times = 1;
    strength.set(1);
    handles.place();
    changed();
  });
  const save = el("button", { type: "button" }, "Save this picture");
  save.addEventListener("click", () => {
    picture.show(false); // at its own size
    savePicture(canvas, facts.warning);
  });

  const help = freshId("help");
  const notes = [
    ...(facts.warning ? [`Take care: ${facts.warning}.`] : []),
    ...facts.doubts.map((doubt) => `Take care: ${doubt}.`),
    ...(facts.was_found ? [] : ["No sun was found: one is added, as strong as under a clear sky."]),
  ].map((line) => el("p", { class: "care" }, line));
  const alone = facts.is_alone
    ? "The same at full resolution, in the terminal:"
    : "At full resolution, in the terminal (the light of this face alone, so a little different):";
  changed();
  return {
    element: el(
      "div",
      { class: "relit-grid" },
      el("figure", {}, canvas, ...notes),
      el(
        "div",
        { class: "stack" },
        el(
          "figure",
          {},
          map.element,
          el("figcaption", { id: help }, `Drag the ${main}, or move it by the arrow keys. Middle: where the camera looks.`),
        ),
        strength.element,
        el("div", { class: "row" }, holdButton(picture), reset, save),
        el("p", { class: "muted small" }, alone),
        el("p", { class: "command small" }, command),
        said,
      ),
    ),
    picture,
    focus: () => map.element.querySelector("button")!.focus(),
  };
}

/** Shows the photograph as it was while it is held down, by pointer or by key. */
function holdButton(picture: RelitPicture): HTMLElement {
  const button = el("button", { type: "button", "aria-pressed": "false" }, "Hold: as photographed");
  const hold = (isBefore: boolean): void => {
    button.setAttribute("aria-pressed", String(isBefore));
    picture.show(isBefore);
  };
  button.addEventListener("pointerdown", (event) => {
    button.setPointerCapture(event.pointerId);
    hold(true);
  });
  for (const kind of ["pointerup", "pointercancel", "blur"]) button.addEventListener(kind, () => hold(false));
  const isKey = (event: KeyboardEvent): boolean => event.key === " " || event.key === "Enter";
  button.addEventListener("keydown", (event) => {
    if (isKey(event) && !event.repeat) hold(true);
  });
  button.addEventListener("keyup", (event) => {
    if (isKey(event)) hold(false);
  });
  return button;
}

/** The words that make the same picture in a terminal. */
function commandOf(facts: Facts, { azimuth_deg, zenith_deg }: Angles, times: number): string {
  const place = `--sun=${azimuth_deg.toFixed(1)},${(90 - zenith_deg).toFixed(1)}`;
  const strength = times === 1 ? "" : ` --strength ${(times * (facts.strength ?? 0)).toPrecision(4)}`;
  return `${facts.command} ${place}${strength} --out relit.png`;
}

/** A PNG of the canvas, with a line below it where there is a warning. */
function savePicture(canvas: HTMLCanvasElement, warning: string): void {
  const size = Math.max(10, Math.min(canvas.width / 40, 28));
  const whole = el("canvas", { width: canvas.width, height: canvas.height + (warning ? Math.round(2 * size) : 0) });
  const context = whole.getContext("2d")!;
  context.fillStyle = "rgb(40 40 40)";
  context.fillRect(0, 0, whole.width, whole.height);
  context.drawImage(canvas, 0, 0);
  context.fillStyle = "#ffd23f";
  context.font = `${size}px system-ui, sans-serif`;
  context.fillText(warning, size / 2, canvas.height + 1.35 * size, whole.width - size);
  whole.toBlob((blob) => {
    if (!blob) return;
    const link = el("a", { href: URL.createObjectURL(blob), download: "relit.png" });
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 1000);
  });
}
