import type { Page } from "./page";
import { el } from "./shared/dom";

// Each page is a module of its own, loaded when it is first shown.
const PAGES: { name: string; title: string; load: () => Promise<{ page: Page }> }[] = [
  { name: "face", title: "Light from a face", load: () => import("./pages/face") },
  { name: "sky", title: "Sky decoder", load: () => import("./pages/sky") },
  { name: "codes", title: "Sparse codes", load: () => import("./pages/codes") },
  { name: "voxel", title: "Voxel probe", load: () => import("./pages/voxel") },
  { name: "partitions", title: "Partitions probe", load: () => import("./pages/partitions") },
];

const main = document.querySelector<HTMLElement>("#main")!;
const links = document.querySelector<HTMLElement>("#pages")!;
for (const { name, title } of PAGES) links.append(el("a", { href: `#/${name}` }, title));

let leave: () => void = () => {};
let asked = 0;

async function show(): Promise<void> {
  const name = location.hash.replace(/^#\//, "");
  const chosen = PAGES.find((one) => one.name === name) ?? PAGES[0]!;
  const mine = ++asked;
  const { page } = await chosen.load().catch(() => ({ page: unreachable }));
  if (mine !== asked) return; // the user went on while it loaded
  leave();
  document.title = `${chosen.title} – skylight studio`;
  for (const link of links.querySelectorAll("a")) {
    if (link.hash === `#/${chosen.name}`) link.setAttribute("aria-current", "page");
    else link.removeAttribute("aria-current");
  }
  main.replaceChildren();
  leave = page(main);
}

const unreachable: Page = (root) => {
  const line = "This page could not be loaded: see whether skylight studio still runs, then reload.";
  root.append(el("p", { class: "alert", role: "alert" }, line));
  return () => {};
};

addEventListener("hashchange", () => {
  if (location.hash.startsWith("#/")) void show().then(() => main.focus());
});
// A file dropped beside its place would make the browser leave for it.
for (const kind of ["dragover", "drop"] as const)
  addEventListener(kind, (event) => event.preventDefault());
void show();
