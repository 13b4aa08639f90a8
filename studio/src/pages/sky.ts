import "../sky/sky.css";
import type { Page } from "../page";
import { getBytes, getJson } from "../api";
import { alertBox } from "../shared/alert";
import { el } from "../shared/dom";
import { exposureSlider, slider, type Slider } from "../shared/fields";
import { Decoder, type Latents } from "../sky/decoder";
import type { Sky } from "../sky/decoder.worker";
import { COLUMNS, ROWS, type Rgb } from "../sky/latlong";
import { Pace } from "../sky/pace";
import { skyPainter } from "../sky/panorama";
import { radianceFile } from "../sky/radiance_file";
import { SkyScene } from "../sky/scene";
import { stillLife } from "../sky/still_life";
import { describeSun } from "../sky/words";

const DEGREE = Math.PI / 180;
// What radiance is white; the mean luminance of skies is about 1.
const WHITE = 1.5;

const LIT = "Lit by the sky. Drag to walk round it.";

export const page: Page = (root) => {
  const alert = alertBox();
  const status = el("span", { role: "status", "aria-live": "polite" }, "Loading the sky model …");
  const scene = el("canvas", {
    class: "picture sky-scene",
    role: "img",
    "aria-label": "A matte knot and a mirror ball on the ground, lit by the decoded sky",
  });
  const map = el("canvas", {
    class: "picture sky-map",
    role: "img",
    "aria-label": "The decoded sky and the ground as a panorama; straight ahead is in the middle",
  });
  const paintMap = skyPainter(map);
  const rate = el("span", { class: "figure" });
  const sunLine = el("p", { class: "small" });
  const controls = el("div", { class: "stack" });
  root.append(
    el("h1", {}, "Make a sky"),
    el(
      "p",
      { class: "lead" },
      "A sky by hand, and the light that it sheds: the learnt model of skies, run by this page. Each slider is one way in which " +
        "skies differ from the mean one: 0 is the mean, 1 is common, 3 is rare.",
    ),
    alert.element,
    el(
      "div",
      { class: "beside sky-page" },
      el(
        "div",
        { class: "stack" },
        el("figure", { class: "in-sight" }, scene, el("figcaption", { class: "row split" }, status, rate)),
        el("figure", {}, map, el("figcaption", {}, "The sky over its ground. Left and right edges are behind you.")),
        sunLine,
      ),
      el("div", { class: "card" }, controls),
    ),
  );

  const life = stillLife();
  let view: SkyScene;
  try {
    view = new SkyScene(scene, life);
  } catch {
    alert.show("this browser shows no WebGL, which the picture of the object needs: switch it on");
    status.textContent = "";
    return () => {};
  }

  let latents: Latents | undefined;
  let components: Slider[] = [];
  let shown: Sky | undefined; // and what is yet to be painted:
  let fresh: Sky | undefined;
  let exposure = 1;
  let painted: number[] = [];
  let asked = 0;
  let sharpness = 1;
  /** Draws with the next frame, so that the browser sets the pace. */
  const draw = () => {
    asked ||= requestAnimationFrame((now) => {
      if (fresh) paintSky(fresh, now);
      if (shown) view.draw(turn.value * DEGREE, exposure / WHITE);
      asked = 0;
    });
  };
  const paintSky = (sky: Sky, now: number) => {
    fresh = undefined;
    shown = sky;
    view.setSky(sky);
    paintMap(sky.map, exposure / WHITE);
    if (status.textContent !== LIT) status.textContent = LIT;
    sunLine.textContent = describeSun(sky);
    painted = [...painted.filter((time) => now - time < 1000), now];
    rate.textContent = painted.length > 5 ? `${painted.length} updates a second` : "";
    scene.dataset.updates = String(Number(scene.dataset.updates ?? 0) + 1);
    pace.frame(now);
  };
  const fit = () => {
    view.resize(scene.clientWidth, scene.clientHeight, sharpness);
    draw();
  };
  const pace = new Pace((to) => {
    sharpness = to;
    if (to > 1) rate.textContent = ""; // at rest
    fit();
  });

  const decoder = new Decoder(
    (sky) => {
      fresh = sky;
      draw();
    },
    (message) => {
      status.textContent = "";
      alert.show(message);
    },
  );
  const wish = () => {
    if (!latents) return;
    const latent = Float32Array.from(latents.mean);
    components.forEach(({ value }, k) => {
      latents!.components[k]!.forEach((c, i) => (latent[i]! += value * latents!.sigmas[k]! * c));
    });
    // the hue of common grounds, its mean as chosen
    const hue = latents.ground_albedo;
    const mean = (hue[0] + hue[1] + hue[2]) / 3;
    const grounds = hue.map((value) => Math.min(1, (value / mean) * albedo.value));
    decoder.show({
      kind: "sky",
      latent,
      azimuth: azimuth.value * DEGREE,
      albedo: grounds as Rgb,
    });
  };

  const degrees = (value: number) => `${value}°`;
  const azimuth = slider({
    label: "Side of the sun",
    min: -180, max: 180, step: 1, value: 115, words: (a) => `${a}° ${a < 0 ? "left" : a > 0 ? "right" : "ahead"}`,
    changed: wish,
  });
  const albedo = slider({
    label: "Brightness of the ground",
    min: 0, max: 0.9, step: 0.01, value: 0.15, words: (a) => a.toFixed(2),
    changed: wish,
  });
  const turn = slider({
    label: "Camera looks towards",
    min: -180, max: 180, step: 1, value: 0, words: degrees,
    changed: draw,
  });
  const brightness = exposureSlider((factor) => {
    exposure = factor;
    if (shown) paintMap(shown.map, exposure / WHITE);
    draw();
  });

  const set = (value: () => number) => {
    for (const one of components) one.set(Math.min(3, Math.max(-3, Math.round(value() * 20) / 20)));
    wish();
  };
  const save = (blob: Blob, name: string) => {
    const url = URL.createObjectURL(blob);
    el("a", { href: url, download: name }).click();
    setTimeout(() => URL.revokeObjectURL(url), 10_000);
  };
  const saveMap = () => shown && save(radianceFile(shown.map, 2 * ROWS, COLUMNS), "sky.hdr");
  const saveLatent = () => {
    if (!shown) return;
    const { latent, azimuth, albedo } = shown.wish;
    const content = {
      light: "autoencoder",
      params: [...latent, azimuth],
      exposure: exposure / WHITE,
      ground_albedo: albedo,
    };
    save(new Blob([JSON.stringify(content, null, 1)], { type: "application/json" }), "sky.json");
  };

  const button = (text: string, onclick: () => void) => el("button", { type: "button", onclick }, text);
  const showControls = ({ names, shares }: Latents) => {
    components = names.map((name) =>
      slider({
        label: name,
        min: -3, max: 3, step: 0.05, value: 0,
        words: (value) => `${value > 0 ? "+" : ""}${value.toFixed(2)}`,
        changed: wish,
      }),
    );
    controls.append(
      el("div", { class: "row" }, button("Random sky", () => set(normal)), button("Mean sky", () => set(() => 0))),
      el("fieldset", {}, el("legend", {}, "Place and exposure"), azimuth.element, albedo.element, brightness.element, turn.element),
      el("fieldset", {}, el("legend", {}, "The sky"),
        el("p", { class: "muted small" }, `The strongest first: the uppermost makes ${Math.round(100 * shares[0]!)} % of how skies differ.`),
        ...components.map((one) => one.element)),
      el(
        "fieldset",
        {},
        el("legend", {}, "Take it with you"),
        el("div", { class: "row" }, button("Map (.hdr)", saveMap), button("Recipe (.json)", saveLatent)),
        el("p", { class: "muted small" }, "The recipe (its latent) lights scenes with “skylight relight --latent sky.json”."),
      ),
    );
  };

  const resized = new ResizeObserver(fit);
  resized.observe(scene);
  turnByDragging(scene, turn, draw);

  const start = async () => {
    const [about, graph] = await Promise.all([getJson<Latents>("/api/sky.json"), getBytes("/api/sky.onnx")]);
    latents = about;
    albedo.set(Math.round((100 * about.ground_albedo.reduce((a, b) => a + b)) / 3) / 100);
    showControls(about);
    status.textContent = "Preparing the scene …";
    decoder.start(graph, life.receivers);
    wish();
  };
  start().catch((error: unknown) => {
    status.textContent = "";
    alert.show(error);
  });

  return () => {
    cancelAnimationFrame(asked);
    decoder.stop();
    pace.stop();
    resized.disconnect();
    view.dispose();
  };
};

/** Standard normal, by Box and Muller. */
function normal(): number {
  return Math.sqrt(-2 * Math.log(1 - Math.random())) * Math.cos(2 * Math.PI * Math.random());
}

/** Dragging the picture turns the camera; the slider is the way for everybody else. */
function turnByDragging(canvas: HTMLCanvasElement, turn: Slider, draw: () => void): void {
  canvas.addEventListener("pointerdown", (event) => canvas.setPointerCapture(event.pointerId));
  canvas.addEventListener("pointermove", (event) => {
    if (!canvas.hasPointerCapture(event.pointerId)) return;
    const to = turn.value - event.movementX * 0.4;
    turn.set(((Math.round(to) + 540) % 360) - 180);
    draw();
  });
}
