import { alertBox } from "../../shared/alert";
import { el } from "../../shared/dom";
import { chooser } from "../../shared/fields";
import { cornerPicker, type CornerPicker } from "./corner_picker";
import { lengthField } from "./length_field";
import { EYE_HEIGHT, type Person } from "./people";
import type { Stand } from "./placement";
import {
  groundUnder,
  planeAt,
  planeOfRectangle,
  showsFootOf,
  sideAtDepth,
  withSide,
  type Pinhole,
  type Pixel,
  type SeenRectangle,
} from "./plane";

export type StandName = "held" | "ground" | "rectangle";

export interface StandChoice {
  element: HTMLElement;
  /** Lies over the photo. */
  picker: CornerPicker;
  name: () => StandName;
  stand: () => Stand;
  /** The middle of the clicked rectangle in the photo, and how wide an object on it may be. */
  rectangle: () => { middle: Pixel; most: number } | null;
  /** All that was chosen, and the same chosen again; `changed` does not hear of it. */
  state: () => StandState;
  set: (to: StandState) => void;
}

/** What the object stands on, for histories. */
export interface StandState {
  name: StandName;
  eyeHeight: number;
  corners: readonly Pixel[] | null;
  side: number;
}

/**
 * What the object stands on. At first the ground under the first head where its foot is in the
 * picture, which is how far down eyes at 1.6 m over level ground put it; else it is held beside the
 * face. `changed` is told whether the plane is another one, not only at another height.
 */
export function standChoice(
  camera: Pinhole,
  { eyes }: Person,
  changed: (isOther: boolean) => void,
  said: (line: string) => void,
): StandChoice {
  const held: Stand = { kind: "held", depth: -eyes[2] };
  let name: StandName = "held";
  let eyeHeight = EYE_HEIGHT;
  let rectangle: { seen: SeenRectangle; corners: readonly Pixel[]; side: number } | null = null;
  const alert = alertBox();
  const told = el("p", { class: "muted small" });

  const ground = (): Stand => ({ kind: "plane", plane: groundUnder(eyes, eyeHeight) });
  const canShow = (height: number): boolean =>
    eyes[1] < height && showsFootOf(groundUnder(eyes, height), camera, eyes);

  const picker = cornerPicker({
    camera,
    say: said,
    picked: (corners) => {
      alert.clear();
      try {
        const seen = planeOfRectangle(camera, corners);
        rectangle = { seen, corners, side: sideAtDepth(seen, -eyes[2]) };
      } catch (error) {
        alert.show(error);
        return back();
      }
      side.set(rectangle.side);
      choose("rectangle");
    },
    left: () => back(),
  });
  const back = (): void => {
    said("");
    show();
  };
  const choose = (to: StandName): void => {
    name = to;
    said("");
    show();
    changed(true);
  };
  const choice = chooser(
    "It stands",
    [
      { value: "held", title: "On a rod beside the face" },
      { value: "ground", title: "On the ground" },
      { value: "rectangle", title: "On a table or floor: click its corners" },
    ],
    (to) => {
      alert.clear();
      picker.end();
      if (to === "rectangle" && !rectangle) picker.begin();
      else choose(to as StandName);
    },
  );
  const again = el("button", { type: "button", onclick: () => picker.begin() }, "Click other corners");
  const height = lengthField({
    label: "Eyes over the ground",
    least: 0.3,
    most: 3,
    value: eyeHeight,
    changed: (metres) => {
      alert.clear();
      try {
        groundUnder(eyes, metres);
      } catch (error) {
        return alert.show(error);
      }
      eyeHeight = metres;
      show();
      changed(false);
    },
  });
  const side = lengthField({
    label: "From the first corner to the second",
    least: 0.01,
    most: 100,
    value: 1,
    changed: (metres) => {
      rectangle!.side = metres;
      changed(false);
    },
  });
  const show = (): void => {
    choice.select.value = name;
    height.element.hidden = name !== "ground";
    side.element.hidden = again.hidden = name !== "rectangle";
    if (name === "held") told.textContent = canShow(EYE_HEIGHT) ? "" : "The ground under the feet is not in the picture.";
    else if (name === "ground")
      told.textContent = canShow(eyeHeight)
        ? "The camera is taken to be level; somebody who stands has eyes at about 160 cm, who sits at about 120."
        : "The ground under the feet is not in the picture: what stands there may not be seen.";
    else {
      const { tiltDeg, tiltErrorDeg, cornerDeg } = rectangle!.seen;
      told.textContent =
        `Tilted by ${tiltDeg.toFixed(0)}° (± ${tiltErrorDeg.toFixed(0)}°) from level; its sides meet at ${cornerDeg.toFixed(0)}°. ` +
        "The length at first puts its middle as far away as the face: type the true one if you know it.";
    }
  };
  if (canShow(EYE_HEIGHT)) name = "ground";
  show();

  const stand = (): Stand => {
    if (name === "held") return held;
    return name === "ground" ? ground() : { kind: "plane", plane: withSide(rectangle!.seen, rectangle!.side) };
  };
  return {
    element: el("div", { class: "stack" }, choice.element, told, height.element, side.element, again, alert.element),
    picker,
    name: () => name,
    stand,
    state: () => ({ name, eyeHeight, corners: rectangle?.corners ?? null, side: rectangle?.side ?? 1 }),
    set: (to) => {
      picker.end();
      alert.clear();
      said("");
      ({ name, eyeHeight } = to);
      rectangle = to.corners && { seen: planeOfRectangle(camera, to.corners), corners: to.corners, side: to.side };
      height.set(eyeHeight);
      side.set(to.side);
      show();
    },
    rectangle: () => {
      const at = stand();
      if (name !== "rectangle" || at.kind !== "plane") return null;
      const places = rectangle!.corners.map((corner) => planeAt(at.plane, camera, corner)!);
      const sides = [1, 2].map((i) => Math.hypot(...places[i]!.map((part, k) => part - places[i - 1]![k]!)));
      return { middle: crossing(rectangle!.corners), most: 0.7 * Math.min(...sides) };
    },
  };
}

/** Where the diagonals meet: the rectangle's middle, seen in perspective. */
function crossing([a, b, c, d]: readonly Pixel[]): Pixel {
  const [p, q] = [
    [c![0] - a![0], c![1] - a![1]],
    [d![0] - b![0], d![1] - b![1]],
  ] as const;
  const along = ((b![0] - a![0]) * q[1] - (b![1] - a![1]) * q[0]) / (p[0] * q[1] - p[1] * q[0]);
  return [a![0] + along * p[0], a![1] + along * p[1]];
}
