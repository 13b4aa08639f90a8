import { previewUrl, type Photo } from "../api";
import { el } from "../shared/dom";

export type Chosen = number | "all";

export interface FaceChooser {
  element: HTMLElement;
  image: HTMLImageElement;
  get chosen(): Chosen | null;
}

/** The photo with a box about each face; the boxes are toggle buttons, one of them is pressed. */
export function faceChooser(photo: Photo): FaceChooser {
  const image = el("img", {
    src: previewUrl(photo.photo),
    width: photo.width,
    height: photo.height,
    alt: `Your photo, ${photo.name}`,
  });
  let chosen: Chosen | null = photo.faces.length ? 1 : null;
  const count = photo.faces.length;
  const boxes = photo.faces.map(({ number, box: [x, y, width, height] }) => {
    const [words, shown] = count > 1 ? [`Face ${number} of ${count}`, String(number)] : ["The face", ""];
    const button = el("button", { type: "button", class: "face-box", "aria-label": words }, shown);
    button.style.left = `${(100 * x) / photo.width}%`;
    button.style.top = `${(100 * y) / photo.height}%`;
    button.style.width = `${(100 * width) / photo.width}%`;
    button.style.height = `${(100 * height) / photo.height}%`;
    button.addEventListener("click", () => choose(number));
    return { value: number as Chosen, button };
  });
  const all = el("button", { type: "button" }, `All ${count} faces under one light`);
  all.addEventListener("click", () => choose("all"));
  const buttons = [...boxes, { value: "all" as Chosen, button: all }];

  const show = (): void => {
    for (const { value, button } of buttons) {
      const isIn = value === chosen || (chosen === "all" && value !== "all");
      button.setAttribute("aria-pressed", String(value === chosen));
      button.classList.toggle("chosen", isIn);
    }
  };
  const choose = (to: Chosen): void => {
    chosen = to;
    show();
  };
  show();
  const frame = el(
    "div",
    { class: "photo", role: "group", "aria-label": "Faces in the photo" },
    image,
    ...boxes.map(({ button }) => button),
  );
  frame.style.setProperty("--aspect", String(photo.width / photo.height));
  const element = el("div", { class: "stack tight" }, frame);
  if (count > 1)
    element.append(
      el("div", { class: "row" }, all, el("span", { class: "muted small" }, "or choose a face in the picture")),
    );
  return {
    element,
    image,
    get chosen() {
      return chosen;
    },
  };
}
