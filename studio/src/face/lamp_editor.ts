import { lampsUrl, type LampFacts, type MeasuredLamp } from "../api";
import { alertBox } from "../shared/alert";
import { el } from "../shared/dom";
import type { History } from "../shared/history";
import { newest } from "../shared/newest";
import { loadRadianceMap, luminance, type RadianceMap } from "../shared/radiance_map";
import "../shared/tables.css";
import { lampHandles, type MovedLamp } from "./lamp_handles";

/**
 * An estimate's lamps to move and to switch: handles over `panorama`, a table, the faces in the
 * light as it is now. `shown` gets the edited map; `bring` shows the lamps whose change is taken back.
 */
export function lampEditor(
  job: string,
  found: MeasuredLamp[],
  { ambient_irradiance, diameters_deg }: LampFacts,
  panorama: HTMLElement,
  { shown, history, bring }: { shown: (map: RadianceMap) => void; history: History; bring: () => void },
): HTMLElement {
  const alert = alertBox();
  const said = el("p", { class: "visually-hidden", role: "status" });
  const asFound = (): MovedLamp[] =>
    found.map(({ azimuth_deg, zenith_deg }) => ({ azimuth_deg, zenith_deg, on: true }));
  const lamps = asFound();
  const ambient = { on: true };
  const face = el("img", {
    class: "picture lamp-face",
    alt: "The face as photographed, and beside it re-rendered under the lamps as they are now",
  });

  const relight = newest(async (url: (name: string) => string) => {
    try {
      const map = await loadRadianceMap(url("probe.exr"));
      face.src = url("face.png");
      await face.decode();
      shown(map);
      face.dataset.shows = face.src;
      alert.clear();
    } catch (error) {
      alert.show(error);
    }
  });
  const links = ["probe.exr", "probe.hdr"].map((name) => ({
    name,
    link: el("a", { download: `edited_${name}` }, `edited ${name}`),
  }));
  const angles = lamps.map(() => ({ azimuth: el("td", {}), zenith: el("td", {}) }));
  const show = (): void => {
    const url = (name: string): string => lampsUrl(job, name, lamps, ambient.on);
    for (const { name, link } of links) link.href = `${url(name)}&download=true`;
    angles.forEach(({ azimuth, zenith }, i) => {
      azimuth.textContent = `${lamps[i]!.azimuth_deg.toFixed(1)}°`;
      zenith.textContent = `${lamps[i]!.zenith_deg.toFixed(1)}°`;
    });
    relight(url);
  };
  const changed = (): void => {
    show();
    noted();
  };

  const handles = lampHandles(panorama, lamps, changed, (line) => {
    said.textContent = line;
  });
  const switches: { box: HTMLInputElement; what: { on: boolean } }[] = [];
  const onOff = (what: { on: boolean }, label: string): HTMLElement => {
    const box = el("input", { type: "checkbox", "aria-label": `${label} on`, checked: true });
    box.addEventListener("change", () => {
      what.on = box.checked;
      handles.place();
      changed();
    });
    switches.push({ box, what });
    return el("td", {}, box);
  };
  const level = luminance(...ambient_irradiance);
  const row = (
    what: { on: boolean },
    label: string,
    irradiance: [number, number, number],
    azimuth: HTMLElement,
    zenith: HTMLElement,
    diameter: string,
  ): HTMLElement =>
    el(
      "tr",
      {},
      onOff(what, label),
      el("th", { scope: "row" }, label),
      azimuth,
      zenith,
      ...irradiance.map((value) => el("td", {}, value.toPrecision(3))),
      el("td", {}, (luminance(...irradiance) / level).toPrecision(3)),
      el("td", {}, diameter),
    );
  const heads = ["On", "Light", "Azimuth", "Zenith", "Red", "Green", "Blue", "Times ambient", "Diameter"];
  const table = el(
    "div",
    { class: "scroller", tabindex: 0, role: "region", "aria-label": "Lamps" },
    el(
      "table",
      {},
      el("thead", {}, el("tr", {}, ...heads.map((head) => el("th", { scope: "col" }, head)))),
      el(
        "tbody",
        {},
        ...lamps.map((lamp, i) => {
          const { azimuth, zenith } = angles[i]!;
          const diameter = `${diameters_deg[i]!.toFixed(1)}°`;
          return row(lamp, `Lamp ${i + 1}`, found[i]!.irradiance, azimuth, zenith, diameter);
        }),
        row(ambient, "Ambient", ambient_irradiance, el("td", {}, "–"), el("td", {}, "–"), "–"),
      ),
    ),
  );
  const reset = el("button", { type: "button" }, "Reset to the estimate");
  const set = (to: MovedLamp[], isAmbient: boolean): void => {
    to.forEach((lamp, i) => Object.assign(lamps[i]!, lamp));
    ambient.on = isAmbient;
    for (const { box, what } of switches) box.checked = what.on;
    handles.place();
    show();
  };
  reset.addEventListener("click", () => {
    set(asFound(), true);
    noted();
  });
  show();
  const noted = history.watch(
    `lamps ${job}`,
    () => ({ lamps, ambient: ambient.on }),
    (to) => set(to.lamps, to.ambient),
    bring,
  );
  return el(
    "section",
    { class: "stack lamps", "aria-label": "Lamps to move and switch" },
    el("h2", {}, "Lamps"),
    el(
      "div",
      { class: "lamps-grid" },
      el("figure", {}, face, el("figcaption", {}, "As photographed, and under the lamps as they are now.")),
      el(
        "div",
        { class: "stack" },
        el(
          "p",
          { class: "muted small" },
          "Drag the numbers in the panorama, or move them by the arrow keys. Red, green and blue: the irradiance of a surface that faces the lamp, in the map's units; of the ambient light, the mean over all surfaces.",
        ),
        table,
        el(
          "div",
          { class: "row" },
          reset,
          el("ul", { class: "files", "aria-label": "Edited files" }, ...links.map(({ link }) => el("li", {}, link))),
        ),
        alert.element,
        said,
      ),
    ),
  );
}
