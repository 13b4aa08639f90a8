import { about, ApiError, forgetPhoto, getBytes, previewUrl, uploadPhoto, type Photo } from "../api";
import { exampleRow } from "../face/example_row";
import "../face/face.css";
import type { Workspace } from "../face/workspace";
import type { Page } from "../page";
import { alertBox } from "../shared/alert";
import { el } from "../shared/dom";
import { fileDrop } from "../shared/file_drop";
import { beginSession, currentSession, endSession } from "../shared/session";

// Built once and kept while the tab lives: who comes back from another page finds it as it was.
let built: HTMLElement | null = null;

export const page: Page = (root) => {
  built ??= build();
  root.append(built);
  return () => {};
};

// what draws is large, and of no use before there is a photo
const drawing = () => import("../face/workspace");

function build(): HTMLElement {
  const alert = alertBox();
  const said = el("p", { class: "visually-hidden", role: "status" });
  const busy = el("p", { class: "muted", "aria-hidden": "true" }, "Looking for faces …");
  busy.hidden = true;
  const drop = fileDrop({
    prompt: "Drop a photo here, paste one, or",
    button: "Choose a photo",
    accept: "image/jpeg,image/png,image/tiff,image/webp,image/bmp,image/avif,.heic,.heif,.hif,.exr,.hdr",
    paste: true,
    chosen: (file) => void take(file),
  });
  const limits = el("p", { class: "muted small" });
  drop.element.append(limits);
  const tries = el("div", {});
  const dropPlace = el("div", {}, drop.element);
  const start = el(
    "div",
    { class: "stack start" },
    el(
      "div",
      {},
      el("h1", {}, "Light from a face"),
      el(
        "p",
        { class: "lead" },
        "A face in a photo tells where the light came from. Give one portrait, and get its light as an environment map, with an object of yours standing in it, and the portrait in other light.",
      ),
    ),
    dropPlace,
    tries,
  );
  const content = el("div", {}, start);
  let shown: Workspace | null = null;
  let asking: AbortController | null = null;

  const begin = (): void => {
    shown = null;
    drop.element.classList.remove("small");
    dropPlace.append(drop.element);
    content.replaceChildren(start);
  };
  const open = async (photo: Photo): Promise<void> => {
    const { workspace } = await drawing();
    drop.element.classList.add("small");
    shown = workspace(photo, drop.element, () => {
      begin();
      drop.element.querySelector("button")!.focus();
    });
    content.replaceChildren(shown.element);
  };
  const take = async (chosen: File | Promise<File>): Promise<void> => {
    asking?.abort();
    const mine = (asking = new AbortController());
    alert.clear();
    drop.element.setAttribute("aria-busy", "true");
    said.textContent = "Looking for faces";
    busy.hidden = false;
    try {
      const [photo] = await Promise.all([uploadPhoto(await chosen, mine.signal), drawing()]);
      if (mine.signal.aborted) return forgetPhoto(photo.photo); // another was chosen meanwhile
      const count = photo.faces.length;
      said.textContent = `${count} ${count === 1 ? "face" : "faces"} found`;
      shown?.close();
      beginSession(photo);
      await open(photo);
    } catch (error) {
      if (asking !== mine) return;
      said.textContent = "";
      alert.show(error);
    } finally {
      if (asking === mine) {
        busy.hidden = true;
        drop.element.removeAttribute("aria-busy");
      }
    }
  };
  about().then(({ limits: { upload_mb, megapixels } }) => {
    limits.textContent =
      `Up to ${upload_mb} MB and ${megapixels} megapixels. It stays on the machine that runs the studio, ` +
      "until you close it or the studio ends.";
  }, alert.show);
  exampleRow((file) => void take(file)).then((row) => tries.append(row), alert.show);
  const again = async ({ photo }: { photo: Photo }): Promise<void> => {
    try {
      await getBytes(previewUrl(photo.photo)); // which the studio may have forgotten
    } catch (error) {
      if (!(error instanceof ApiError && error.status === 404)) throw error;
      endSession();
      throw new Error(`the studio has ended since, or has forgotten ${photo.name}: give the photo again`);
    }
    await open(photo);
  };
  const before = currentSession();
  if (before) again(before).catch(alert.show);
  return el("div", { class: "face-page" }, said, busy, alert.element, content);
}
