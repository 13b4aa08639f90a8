import type { Object3D } from "three";
import type { EstimateResult, Photo } from "../../api";
import { alertBox } from "../../shared/alert";
import { el, freshId } from "../../shared/dom";
import { chooser, slider } from "../../shared/fields";
import { fileDrop } from "../../shared/file_drop";
import type { RadianceMap } from "../../shared/radiance_map";
import { FINISHES } from "./materials";
import { MODELS, ownModel, readModel } from "./models";
import { firstPlacement, steer, type Steered } from "./steering";
import { CompositeView, type Pinhole } from "./view";

export interface CompositePanel {
  element: HTMLElement;
  /** Adds a light that the object can stand in, and shows it. */
  addLight: (title: string, map: RadianceMap) => void;
  /** Puts a model of one's own, .obj or .glb, in the object's place. */
  showModel: (file: File) => void;
  dispose: () => void;
}

const MOST_PIXELS_WIDE = 1024;
const OWN = "own";

/** The photo with an object in it: the picture, and everything to move and change the object. */
export function compositePanel(
  photo: Pick<Photo, "width" | "height">,
  image: HTMLImageElement,
  result: EstimateResult,
): CompositePanel {
  const { camera, faces_at } = result;
  const width = Math.min(photo.width, MOST_PIXELS_WIDE);
  const canvas = el("canvas", { width, height: Math.round((width * photo.height) / photo.width) });
  canvas.className = "picture composite";
  const status = el("p", { class: "muted small figure", "aria-live": "off" });
  const alert = alertBox();
  let view: CompositeView;
  try {
    view = new CompositeView(canvas, image, camera as Pinhole, (batches, all) => {
      canvas.dataset.share = String(batches / all);
      status.textContent =
        batches < all ? `Gathering light: ${Math.round((100 * batches) / all)} %` : "All light is in.";
    });
  } catch {
    const line =
      "This browser offers no WebGL 2 with float targets, so no object can be drawn into the photo; " +
      "the light and its files are not affected.";
    return { element: el("p", { class: "care" }, line), addLight: () => {}, showModel: () => {}, dispose: () => {} };
  }

  const placement = firstPlacement(camera, faces_at[0]?.position);
  const place = (): void => view.place(placement);
  let model: Object3D = ownModel("teapot");
  let finish = "clay";
  const dress = (): void => view.setModel(model, finish === OWN ? null : FINISHES[finish]!);

  const finishes = chooser(
    "Surface",
    [
      { value: "clay", title: "Clay" },
      { value: "matte", title: "Matte white" },
      { value: "glazed", title: "Red glaze" },
      { value: "silver", title: "Silver" },
      { value: "mirror", title: "Mirror" },
      { value: OWN, title: "The model's own" },
    ],
    (chosen) => {
      finish = chosen;
      dress();
    },
  );
  const own = finishes.select.querySelector<HTMLOptionElement>(`[value=${OWN}]`)!;
  own.disabled = true;
  const setFinish = (to: string): void => {
    finish = finishes.select.value = to;
  };
  const models = chooser(
    "Object",
    Object.entries(MODELS).map(([value, { title }]) => ({ value, title })),
    (name) => {
      model = ownModel(name);
      own.disabled = true;
      if (finish === OWN) setFinish("clay");
      dress();
    },
  );
  const showModel = (file: File): void => {
    alert.clear();
    readModel(file).then((read) => {
      model = read;
      own.disabled = false;
      setFinish(OWN);
      models.select.querySelector("[value=file]")?.remove();
      models.select.append(el("option", { value: "file", disabled: true, selected: true }, file.name));
      dress();
    }, alert.show);
  };
  const drop = fileDrop({
    prompt: "",
    button: "Your own model",
    accept: ".obj,.glb",
    hint: ".obj or .glb, or drop it here. It stays in this page.",
    small: true,
    chosen: showModel,
  });

  const size = slider({
    label: "Height of the object",
    min: -2,
    max: 1,
    step: 0.01,
    value: Math.log10(placement.size),
    words: (power) => metres(10 ** power),
    changed: (power) => {
      placement.size = 10 ** power;
      place();
    },
  });
  const turn = slider({
    label: "Turn",
    min: -180,
    max: 180,
    step: 1,
    value: placement.turnDeg,
    words: (degrees) => `${degrees}°`,
    changed: (degrees) => {
      placement.turnDeg = degrees;
      place();
    },
  });
  const height = slider({
    label: "Camera over the ground",
    min: -1.5,
    max: 1,
    step: 0.01,
    value: Math.log10(placement.cameraHeight),
    words: (power) => metres(10 ** power),
    changed: (power) => {
      // the object's foot stays where it is in the picture
      const scale = 10 ** power / placement.cameraHeight;
      placement.cameraHeight *= scale;
      placement.x *= scale;
      placement.z *= scale;
      place();
    },
  });

  const said = el("p", { class: "visually-hidden", role: "status" });
  const steered: Steered = {
    view,
    camera,
    placement,
    changed: () => {
      place();
      size.set(Math.log10(placement.size));
      turn.set(Math.round(placement.turnDeg));
    },
    say: (line) => {
      said.textContent = line;
    },
  };
  const help = freshId("help");
  canvas.tabIndex = 0;
  canvas.setAttribute("role", "application");
  canvas.setAttribute("aria-label", "Your photo with the object in it, movable");
  canvas.setAttribute("aria-describedby", help);
  steer(canvas, steered);

  const maps = new Map<string, RadianceMap>();
  const lights = chooser("Lit by", [], (title) => view.setLight(maps.get(title)!));
  lights.element.hidden = true;

  const save = el("button", { type: "button" }, "Save this picture");
  save.addEventListener("click", () =>
    canvas.toBlob((blob) => {
      if (!blob) return;
      const link = el("a", { href: URL.createObjectURL(blob), download: "composite.png" });
      link.click();
      setTimeout(() => URL.revokeObjectURL(link.href), 1000);
    }),
  );

  dress();
  place();
  const controls = el(
    "div",
    { class: "stack" },
    lights.element,
    models.element,
    finishes.element,
    drop.element,
    alert.element,
    size.element,
    turn.element,
    height.element,
    save,
  );
  const keys =
    "Drag the object, or move it by the arrow keys; plus and minus change its height, the comma and the full stop turn it.";
  const figure = el(
    "figure",
    {},
    canvas,
    el("figcaption", { id: help }, keys),
    status,
    said,
  );
  return {
    element: el("div", { class: "beside" }, figure, controls),
    addLight: (title, map) => {
      if (!maps.has(title)) lights.select.append(el("option", { value: title }, title));
      maps.set(title, map);
      lights.select.value = title;
      lights.element.hidden = maps.size < 2;
      view.setLight(map);
    },
    showModel,
    dispose: () => {
      drop.leave();
      view.dispose();
    },
  };
}

function metres(length: number): string {
  return length < 0.995 ? `${(100 * length).toPrecision(2)} cm` : `${length.toPrecision(2)} m`;
}
