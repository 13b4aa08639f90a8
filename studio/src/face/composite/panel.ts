import { Vector3 } from "three";
import { alertBox } from "../../shared/alert";
import { el, freshId } from "../../shared/dom";
import type { Edit } from "../../shared/edit";
import { chooser, slider } from "../../shared/fields";
import { fileDrop } from "../../shared/file_drop";
import type { History } from "../../shared/history";
import type { RadianceMap } from "../../shared/radiance_map";
import { lengthField } from "./length_field";
import { FINISHES } from "./materials";
import { readModel } from "./model_file";
import { MODELS, ownModel, type Model } from "./models";
import type { Person } from "./people";
import { besideFace, besideFeet, type Placement } from "./placement";
import { pixelOf, type Pinhole, type Pixel } from "./plane";
import { standChoice } from "./stand_choice";
import { footAt, LARGEST, SMALLEST, steer } from "./steering";
import { CompositeView, type SeenPhoto } from "./view";

export interface CompositePanel {
  element: HTMLElement;
  /** Adds a light that the object can stand in, radiance in the photo's units and colours, and shows it. */
  addLight: (title: string, map: RadianceMap, edit: Edit) => void;
  /** Shows a light that was added. */
  show: (title: string) => void;
  /** Puts a model of one's own, .obj or .glb, in the object's place. */
  showModel: (file: File) => void;
  /** Has its changes noted in a history; `bring` shows the object whose change is taken back. */
  remember: (history: History, bring: () => void) => void;
  dispose: () => void;
}

const MOST_PIXELS_WIDE = 1024;
const OWN = "own";
/** How much larger things on the ground are than those in the hand or on a table. */
const ON_GROUND = 2.5;

/** The photo with an object in it: the picture, and everything to move and change the object. */
export function compositePanel(photo: SeenPhoto): CompositePanel {
  const { camera, people } = photo;
  const [person] = people;
  const width = Math.min(camera.width, MOST_PIXELS_WIDE);
  const canvas = el("canvas", { width, height: Math.round((width * camera.height) / camera.width) });
  canvas.className = "picture composite";
  const status = el("p", { class: "muted small figure", "aria-live": "off" });
  const alert = alertBox();
  let view: CompositeView;
  try {
    if (!person) throw new Error("nobody to stand beside");
    view = new CompositeView(canvas, photo, (batches, all) => {
      canvas.dataset.share = String(batches / all);
      status.textContent =
        batches < all ? `Gathering light: ${Math.round((100 * batches) / all)} %` : "All light is in.";
    });
  } catch {
    const line =
      "This browser offers no WebGL 2 with float targets, so no object can be drawn into the photo; " +
      "the light and its files are not affected.";
    return { element: el("p", { class: "care" }, line), addLight: () => {}, show: () => {}, showModel: () => {}, remember: () => {}, dispose: () => {} };
  }

  const placement: Placement = { foot: [0, 0, -1], size: 0.1, turnDeg: 0 };
  const heads = [...people.flatMap((one) => headPixels(camera, one)), ...photo.faces.flatMap(boxPixels)];
  let name: string | null = MODELS[0]!.value; // null: the user's own
  let isMoved = false;
  let model: Model;
  let finish = OWN;
  let own: { model: Model; file: string } | null = null; // the user's, for as long as the page lives
  let noted = (): void => {};

  const said = el("p", { class: "visually-hidden", role: "status" });
  const asks = el("p", { class: "muted", role: "status" });
  const stands = standChoice(
    camera,
    person,
    (isOther) => {
      if (isOther) {
        isMoved = false;
        if (name) model = ownModel(name, stands.stand().kind); // balls lie or hang
        dress();
        first();
      } else {
        placement.foot = footAt(stands.stand(), camera, pixelOf(camera, placement.foot)) ?? placement.foot;
        if (!isMoved) first();
      }
      place();
    },
    (line) => {
      asks.textContent = line;
    },
  );

  const place = (): void => {
    size.set(placement.size);
    turn.set(Math.round(placement.turnDeg));
    canvas.dataset.placement = JSON.stringify(placement);
    view.place(placement, stands.stand());
    noted();
  };
  /** Where the object stands before it is moved. */
  const first = (): void => {
    const stand = stands.stand();
    const { usual } = model.extent;
    if (stand.kind === "held") Object.assign(placement, besideFace(camera, person.eyes, heads, model.extent));
    else if (stands.name() === "ground")
      Object.assign(placement, besideFeet(camera, person.eyes, stand.plane, ON_GROUND * usual));
    else {
      const { middle, most } = stands.rectangle()!;
      placement.foot = footAt(stand, camera, middle)!;
      placement.size = Math.min(usual, most / model.extent.width, LARGEST);
    }
  };
  const dress = (): void => {
    view.setModel(model, finish === OWN ? null : FINISHES[finish]!);
    size.setLabel(model.measure);
    undressed.disabled = !model.isDressed;
    finishes.select.value = finish;
  };

  const finishes = chooser(
    "Surface",
    [
      { value: OWN, title: "The model's own" },
      { value: "clay", title: "Clay" },
      { value: "matte", title: "Matte white" },
      { value: "chart", title: "Diffuse grey, 18 %" },
      { value: "glazed", title: "Red glaze" },
      { value: "silver", title: "Silver" },
      { value: "mirror", title: "Mirror" },
    ],
    (chosen) => {
      finish = chosen;
      dress();
      noted();
    },
  );
  const undressed = finishes.select.querySelector<HTMLOptionElement>(`[value=${OWN}]`)!;
  const setModel = (to: Model): void => {
    const isFirst = !model;
    model = to;
    if (model.isDressed && (name === null || name === MODELS[0]!.value)) finish = OWN;
    else if (finish === OWN) finish = "clay";
    dress();
    if (isFirst || !isMoved) first();
    else placement.size = Math.min(placement.size, LARGEST);
    place();
  };
  const models = chooser("Object", [...MODELS], (chosen) => {
    name = chosen;
    setModel(ownModel(chosen, stands.stand().kind));
  });
  const showModel = (file: File): void => {
    alert.clear();
    readModel(file).then((read) => {
      own = { model: read, file: file.name };
      name = null;
      offerOwn();
      setModel(read);
    }, alert.show);
  };
  const offerOwn = (): void => {
    models.select.querySelector("[value=file]")?.remove();
    models.select.append(el("option", { value: "file", disabled: true, selected: true }, own!.file));
  };
  const drop = fileDrop({
    prompt: "",
    button: "Your own model",
    accept: ".obj,.glb",
    hint: ".obj or .glb, or drop it here. It stays in this page.",
    small: true,
    chosen: showModel,
  });

  const size = lengthField({
    label: "Height of the object",
    least: SMALLEST,
    most: LARGEST,
    value: placement.size,
    changed: (metres) => {
      placement.size = metres;
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

  const help = freshId("help");
  canvas.tabIndex = 0;
  canvas.setAttribute("role", "application");
  canvas.setAttribute("aria-label", "Your photo with the object in it, movable");
  canvas.setAttribute("aria-describedby", help);
  steer(canvas, {
    view,
    camera,
    placement,
    stand: stands.stand,
    changed: () => {
      isMoved = true;
      place();
    },
    say: (line) => {
      said.textContent = line;
    },
  });

  const maps = new Map<string, [RadianceMap, Edit]>();
  let lit = "";
  const show = (title: string): void => {
    if (title !== lit) view.setLight(...maps.get((lit = title))!);
  };

  const save = el("button", { type: "button" }, "Save this picture");
  save.addEventListener("click", () =>
    canvas.toBlob((blob) => {
      if (!blob) return;
      const link = el("a", { href: URL.createObjectURL(blob), download: "composite.png" });
      link.click();
      setTimeout(() => URL.revokeObjectURL(link.href), 1000);
    }),
  );

  setModel(ownModel(MODELS[0]!.value, stands.stand().kind));
  const state = () => ({ name, file: name === null ? own!.file : "", finish, isMoved, placement, stand: stands.state() });
  const set = (to: ReturnType<typeof state>): void => {
    if (to.name === null && own?.file !== to.file) {
      alert.show(`${to.file} stayed in the page that it was opened in: open it again`);
      return;
    }
    stands.set(to.stand);
    ({ name, finish, isMoved } = to);
    if (name === null) offerOwn();
    else models.select.value = name;
    model = name === null ? own!.model : ownModel(name, stands.stand().kind);
    Object.assign(placement, to.placement);
    dress();
    place();
  };
  const controls = el(
    "div",
    { class: "stack" },
    models.element,
    finishes.element,
    drop.element,
    alert.element,
    stands.element,
    size.element,
    turn.element,
    save,
  );
  const keys =
    "Drag the object, or move it by the arrow keys; plus and minus change its size, the comma and the full stop turn it.";
  const stage = el("div", { class: "stage" }, canvas);
  stage.style.setProperty("--aspect", String(camera.width / camera.height));
  stage.append(stands.picker.element);
  const figure = el("figure", {}, stage, el("figcaption", { id: help }, keys), asks, status, said);
  return {
    element: el("div", { class: "beside" }, figure, controls),
    addLight: (title, map, edit) => {
      maps.set(title, [map, edit]);
      show(title);
    },
    show,
    showModel,
    remember: (history, bring) => {
      noted = history.watch("object", state, set, bring);
    },
    dispose: () => {
      drop.leave();
      view.dispose();
    },
  };
}

/** Where a head's vertices are in the photo. */
function headPixels(camera: Pinhole, { head }: Person): Pixel[] {
  const at = head.getAttribute("position");
  const places = Array.from({ length: at.count }, (_, i) => new Vector3().fromBufferAttribute(at, i));
  return places.filter(({ z }) => z < 0).map((place) => pixelOf(camera, place.toArray()));
}

/** Places all over a face's box. */
function boxPixels([x, y, width, height]: SeenPhoto["faces"][number]): Pixel[] {
  const parts = [0, 0.125, 0.25, 0.375, 0.5, 0.625, 0.75, 0.875, 1];
  return parts.flatMap((across) => parts.map((down): Pixel => [x + across * width, y + down * height]));
}
