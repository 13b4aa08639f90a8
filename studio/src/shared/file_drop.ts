import { el } from "./dom";

/**
 * A place to drop, pick or paste a file. The button in it opens the file dialog, so the keyboard
 * reaches all of it. Where `paste` is true a picture on the clipboard counts too.
 */
export function fileDrop(options: {
  prompt: string;
  button: string;
  accept: string;
  hint?: string;
  small?: boolean;
  paste?: boolean;
  chosen: (file: File) => void;
}): { element: HTMLElement; leave: () => void } {
  const { prompt, button, accept, hint, chosen } = options;
  const input = el("input", { type: "file", accept, hidden: true, "aria-label": button });
  const pick = el("button", { type: "button", class: options.small ? "" : "primary", onclick: () => input.click() }, button);
  const element = el("div", { class: options.small ? "drop small" : "drop" });
  if (prompt) element.append(el("p", {}, prompt));
  element.append(pick, input);
  if (hint) element.append(el("p", { class: "muted small" }, hint));
  input.addEventListener("change", () => {
    const file = input.files?.[0];
    input.value = ""; // the same file may be chosen again
    if (file) chosen(file);
  });
  element.addEventListener("dragover", (event) => {
    event.preventDefault();
    element.classList.add("over");
  });
  element.addEventListener("dragleave", () => element.classList.remove("over"));
  element.addEventListener("drop", (event) => {
    event.preventDefault();
    element.classList.remove("over");
    const file = event.dataTransfer?.files[0];
    if (file) chosen(file);
  });
  const paste = (event: ClipboardEvent): void => {
    const file = event.clipboardData?.files[0];
    if (file && element.isConnected) chosen(file);
  };
  if (options.paste) document.addEventListener("paste", paste);
  return { element, leave: () => document.removeEventListener("paste", paste) };
}
