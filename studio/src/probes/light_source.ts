import { fileUrl, uploadMap } from "../api";
import { alertBox } from "../shared/alert";
import { el } from "../shared/dom";
import { chooser } from "../shared/fields";
import { fileDrop } from "../shared/file_drop";
import { decodeRadianceMap, loadRadianceMap, type RadianceMap } from "../shared/radiance_map";
import { foundLights } from "../shared/session";

/** A light that the user chose: how a request names it, and its map to look at. */
export interface GivenLight {
  title: string;
  request: { map: string } | { job: string };
  load: () => Promise<RadianceMap>;
}

export interface LightSource {
  element: HTMLElement;
  get chosen(): GivenLight | undefined;
}

/**
 * A choice among the lights that this tab has found and the maps uploaded here; the first choice is
 * `none` where a light is not needed. `changed` hears of every new choice.
 */
export function lightSource(options: { none?: string; changed: () => void }): LightSource {
  const { none, changed } = options;
  const alert = alertBox();
  const status = el("p", { role: "status", "aria-live": "polite", class: "muted small" });
  const lights: GivenLight[] = foundLights().map(({ job, title }) => ({
    title: `Found: ${title}`,
    request: { job },
    load: () => loadRadianceMap(fileUrl(job, "probe.hdr")),
  }));
  const { element: field, select } = chooser("Light", [], changed);
  const offer = (): void => {
    const first = none ?? (lights.length ? undefined : "No map yet: open one below");
    select.replaceChildren(
      ...(first === undefined ? [] : [el("option", { value: "" }, first)]),
      ...lights.map((light, i) => el("option", { value: i }, light.title)),
    );
    select.disabled = !lights.length;
  };
  const take = async (file: File): Promise<void> => {
    alert.clear();
    status.textContent = `Reading ${file.name} …`;
    try {
      const bytes = await file.arrayBuffer();
      const { map, name } = await uploadMap(file);
      lights.push({ title: name, request: { map }, load: async () => decodeRadianceMap(bytes, name) });
      offer();
      select.value = String(lights.length - 1);
      changed();
      status.textContent = `${name} is chosen.`;
    } catch (error) {
      status.textContent = "";
      alert.show(error);
    }
  };
  const drop = fileDrop({
    prompt: "",
    button: "Open a map …",
    accept: ".exr,.hdr",
    hint: "A lat-long map, .exr or .hdr; you can drop it here.",
    small: true,
    chosen: (file) => void take(file),
  });
  offer();
  return {
    element: el("div", { class: "stack tight" }, field, drop.element, status, alert.element),
    get chosen() {
      return select.value === "" ? undefined : lights[Number(select.value)];
    },
  };
}
