import { fileUrl, forgetJob, getBytes, type Angles } from "../../api";
import { alertBox } from "../../shared/alert";
import { el, freshId } from "../../shared/dom";
import { slider } from "../../shared/fields";
import { whereFrom } from "../../shared/frame";
import type { History } from "../../shared/history";
import { jobPanel } from "../../shared/job_panel";
import { panorama } from "../../shared/panorama";
import { whiteLevel } from "../../shared/radiance_map";
import { lampHandles } from "../lamp_handles";
import { KeyLight } from "./key_light";
import { readPerson, type Facts, type Person } from "./person";
import { RelitPicture } from "./picture";

const FILE = "portrait.safetensors";
const MOST_STRENGTH = 16;
const SIZES_DEG = [5, 60] as const;

/** The key lights' names, for buttons that are there before the person is. */
export const KEYS = ["left", "right", "top", "rim", "front"] as const;

export interface RelitPanel {
  element: HTMLElement;
  /** Takes the person apart where that has not begun; then puts the key light where it is named. */
  open: (key?: string) => void;
  leave: () => void;
}

/**
 * The photographed person of an estimate under a key light that is to be moved, over a dim fill.
 * The person is taken apart when it is first opened: it takes some seconds. `bring` shows what a
 * change of the history changes.
 */
export function relitPanel(job: string, title: string, history: History, bring: () => void): RelitPanel {
  const work = jobPanel();
  const alert = alertBox();
  const again = el("button", { type: "button", hidden: true, onclick: () => open() }, "Relight the portrait");
  const place = el("div", { class: "stack" }, el("div", { class: "row" }, again), work.element, alert.element);
  let view: ReturnType<typeof relitView> | null = null;
  let wanted: string | undefined;
  let isUnderWay = false;
  let isLeft = false;

  const show = async (): Promise<void> => {
    const done = await work.run({ kind: "portrait", job });
    if (!done) return;
    const person = readPerson(await getBytes(fileUrl(done.job, FILE)));
    forgetJob(done.job); // all of it is here now
    if (isLeft) return;
    view = relitView(person, title);
    place.replaceChildren(view.element);
    view.remember(history, `key ${job}`, bring);
    if (wanted) view.put(wanted);
    view.focus();
  };
  const open = (key?: string): void => {
    wanted = key ?? wanted;
    if (view && key) view.put(key);
    if (view || isUnderWay) return;
    isUnderWay = true;
    again.hidden = true;
    alert.clear();
    show()
      .catch(alert.show)
      .finally(() => {
        isUnderWay = false;
        again.hidden = view !== null;
      });
  };
  return {
    element: el("section", { class: "stack relit-section", "aria-label": `The portrait relit: ${title}` }, place),
    open,
    leave: () => {
      isLeft = true;
      work.cancel();
      view?.picture.dispose();
    },
  };
}

interface RelitView {
  element: HTMLElement;
  picture: RelitPicture;
  /** Puts the key light where it is named. */
  put: (key: string) => void;
  /** Has its changes noted in a history under that name. */
  remember: (history: History, name: string, bring: () => void) => void;
  focus: () => void;
}

function relitView(person: Person, title: string): RelitView {
  const { facts } = person;
  const { width, height } = person.picture;
  const canvas = el("canvas", { class: "picture relit", role: "img" });
  // as large as the picture would be, however many pixels it has just now
  canvas.style.width = `min(${width}px, calc(var(--room, 75vh) * ${width / height}))`;
  canvas.style.aspectRatio = `${width} / ${height}`;
  const light = new KeyLight(person);
  const picture = new RelitPicture(canvas, person, light);
  const key = { ...inMap(facts.keys.left!), on: true };
  let { size_deg, strength } = facts.usual;

  let asked = 0;
  const draw = (): void => {
    asked = 0;
    picture.draw(light.under(key.azimuth_deg, key.zenith_deg, strength, size_deg));
    canvas.setAttribute("aria-label", `The portrait, the key light ${whereFrom(key.azimuth_deg, key.zenith_deg)}`);
    canvas.dataset.shows = JSON.stringify([key.azimuth_deg, key.zenith_deg, strength, size_deg]);
  };
  const command = el("code", {});
  let noted = (): void => {};
  const changed = (): void => {
    command.textContent = commandOf(facts, key, strength, size_deg);
    asked ||= requestAnimationFrame(draw); // once a frame, however fast the light moves
    noted();
  };

  const said = el("p", { class: "visually-hidden", role: "status" });
  const map = panorama(`${title}: the light around the camera`);
  map.setMap(person.foundMap);
  map.setExposure(1 / whiteLevel(person.foundMap));
  const say = (line: string): void => {
    said.textContent = line;
  };
  const handles = lampHandles(map.element, [key], changed, say, () => ["Key light", "☀"]);
  const put = (name: string): void => {
    Object.assign(key, inMap(facts.keys[name]!));
    handles.place();
    changed();
  };
  const presets = keyButtons(put);

  const strengths = slider({
    label: "Strength",
    min: 0,
    max: MOST_STRENGTH,
    step: 0.25,
    value: strength,
    words: (value) => `${value.toFixed(2)} × the fill`,
    changed: (value) => {
      strength = value;
      changed();
    },
  });
  const softness = slider({
    label: "Softness",
    min: SIZES_DEG[0],
    max: SIZES_DEG[1],
    step: 1,
    value: size_deg,
    words: (value) => `${value}° wide`,
    changed: (value) => {
      size_deg = value;
      changed();
    },
  });
  const wipe = slider({
    label: "Before and after",
    min: 0,
    max: 100,
    step: 1,
    value: 0,
    words: (value) => `${value} % as photographed`,
    changed: (value) => picture.show(value / 100),
  });
  const set = (to: Angles & { strength: number; size_deg: number }): void => {
    Object.assign(key, { azimuth_deg: to.azimuth_deg, zenith_deg: to.zenith_deg });
    ({ size_deg, strength } = to);
    strengths.set(strength);
    softness.set(size_deg);
    handles.place();
    changed();
  };
  const reset = el("button", { type: "button" }, "Reset");
  reset.addEventListener("click", () => {
    wipe.set(0);
    picture.show(0);
    set({ ...inMap(facts.keys.left!), ...facts.usual });
  });
  const save = el("button", { type: "button" }, "Save this picture");
  save.addEventListener("click", () => {
    picture.show(0); // all of it, at its own size
    savePicture(canvas, facts.warning);
    picture.show(wipe.value / 100);
  });

  const help = freshId("help");
  const notes = [
    ...(facts.warning ? [`Take care: ${facts.warning}.`] : []),
    ...facts.doubts.map((doubt) => `Take care: ${doubt}.`),
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
        presets,
        strengths.element,
        softness.element,
        wipe.element,
        el("div", { class: "row keys" }, holdButton(picture, () => wipe.value / 100), reset, save),
        el(
          "figure",
          {},
          map.element,
          el("figcaption", { id: help }, "Drag the key light, or move it by the arrow keys. Middle: where the camera looks; either end: at the camera."),
        ),
        el(
          "details",
          {},
          el("summary", {}, "At full resolution"),
          el("p", { class: "muted small" }, alone),
          el("p", { class: "command small" }, command),
        ),
        said,
      ),
    ),
    picture,
    put,
    remember: (history, name, bring) => {
      noted = history.watch(
        name,
        () => ({ azimuth_deg: key.azimuth_deg, zenith_deg: key.zenith_deg, strength, size_deg }),
        set,
        bring,
      );
    },
    focus: () => map.element.querySelector("button")!.focus({ preventScroll: true }),
  };
}

/** A button for each key light by name. */
export function keyButtons(put: (name: string) => void): HTMLElement {
  const buttons = KEYS.map((name) =>
    el("button", { type: "button", onclick: () => put(name) }, name.charAt(0).toUpperCase() + name.slice(1)),
  );
  return el("div", { class: "row keys", role: "group", "aria-label": "Key light from" }, ...buttons);
}

/** Shows the photograph as it was while it is held down, by pointer or by key, then so much of it. */
function holdButton(picture: RelitPicture, before: () => number): HTMLElement {
  const button = el("button", { type: "button", "aria-pressed": "false" }, "Hold: as photographed");
  const hold = (isHeld: boolean): void => {
    button.setAttribute("aria-pressed", String(isHeld));
    picture.show(isHeld ? 1 : before());
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

/** Angles seen by the viewer, 0 at the camera, as those of the map, 0 ahead of it. */
function inMap([azimuth, elevation]: [number, number]): Angles {
  return { azimuth_deg: opposite(azimuth), zenith_deg: 90 - elevation };
}

/** 180 degrees less it, from -180 to 180: from one of both to the other. */
const opposite = (azimuth: number): number => (azimuth > 0 ? 180 - azimuth : -180 - azimuth);

/** The words that make the same picture in a terminal. */
function commandOf(facts: Facts, { azimuth_deg, zenith_deg }: Angles, strength: number, size: number): string {
  const { usual } = facts;
  return [
    facts.command,
    `--angle=${opposite(azimuth_deg).toFixed(1)},${(90 - zenith_deg).toFixed(1)}`,
    ...(strength === usual.strength ? [] : [`--strength ${strength}`]),
    ...(size === usual.size_deg ? [] : [`--size ${size}`]),
    "--out relit.png",
  ].join(" ");
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
