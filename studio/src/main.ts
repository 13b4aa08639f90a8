import type { Page } from "./page";
import { el } from "./shared/dom";

interface Named {
  name: string;
  title: string;
  /** What it is for, where the laboratory lists it. */
  lab?: string;
  load: () => Promise<{ page: Page }>;
}

// Each page is a module of its own, loaded when it is first shown.
const PAGES: Named[] = [
  { name: "face", title: "Light from a face", load: () => import("./pages/face") },
  { name: "lab", title: "Lab", load: () => Promise.resolve({ page: lab }) },
  {
    name: "sky",
    title: "Make a sky",
    lab: "Skies to be made by hand, with the light that each sheds: clouds, sun, colour.",
    load: () => import("./pages/sky"),
  },
  {
    name: "codes",
    title: "Light in few pieces",
    lab: "A map of light taken apart into a few soft patches: sparse codes.",
    load: () => import("./pages/codes"),
  },
  {
    name: "voxel",
    title: "Voxel probe",
    lab: "A star of cubes to print; a photograph of it tells how light falls.",
    load: () => import("./pages/voxel"),
  },
  {
    name: "partitions",
    title: "Partitions probe",
    lab: "A shell to print whose faces each see one part of the surroundings.",
    load: () => import("./pages/partitions"),
  },
];
const IN_LAB = PAGES.filter((one) => one.lab);

const main = document.querySelector<HTMLElement>("#main")!;
const links = document.querySelector<HTMLElement>("#pages")!;
const inLab = document.querySelector<HTMLElement>("#lab")!;
const linkTo = ({ name, title }: Named): HTMLAnchorElement => el("a", { href: `#/${name}` }, title);
links.append(...PAGES.filter((one) => !one.lab).map(linkTo));
inLab.append(...IN_LAB.map(linkTo));

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
  inLab.hidden = !chosen.lab;
  const isOf = (link: HTMLAnchorElement, one: string): boolean => link.hash === `#/${one}`;
  for (const link of document.querySelectorAll<HTMLAnchorElement>(".bar nav a")) {
    link.removeAttribute("aria-current");
    if (isOf(link, chosen.name)) link.setAttribute("aria-current", "page");
    else if (chosen.lab && isOf(link, "lab")) link.setAttribute("aria-current", "true");
  }
  main.replaceChildren();
  leave = page(main);
}

/** What else there is beside light from faces. */
const lab: Page = (root) => {
  const cards = IN_LAB.map((one) =>
    el("section", { class: "card stack tight" }, el("h2", {}, linkTo(one)), el("p", { class: "muted" }, one.lab!)),
  );
  root.append(
    el("h1", {}, "Lab"),
    el("p", { class: "lead" }, "What is beside light from faces: the sky model by hand, maps in pieces, and probes to print."),
    el("div", { class: "columns" }, ...cards),
  );
  return () => {};
};

const unreachable: Page = (root) => {
  const line = "This page could not be loaded: see whether skylight studio still runs, then reload.";
  root.append(el("p", { class: "alert", role: "alert" }, line));
  return () => {};
};

addEventListener("hashchange", () => {
  if (location.hash.startsWith("#/"))
    void show().then(() => {
      main.focus({ preventScroll: true });
      scrollTo(0, 0); // with the bar
    });
});
// A file dropped beside its place would make the browser leave for it.
for (const kind of ["dragover", "drop"] as const)
  addEventListener(kind, (event) => event.preventDefault());
void show();
