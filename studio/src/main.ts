import type { Page } from "./page";

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
for (const { name, title } of PAGES) {
  const link = document.createElement("a");
  link.href = `#/${name}`;
  link.textContent = title;
  links.append(link);
}

let leave: () => void = () => {};

async function show(): Promise<void> {
  const name = location.hash.replace(/^#\//, "");
  const chosen = PAGES.find((one) => one.name === name) ?? PAGES[0]!;
  const { page } = await chosen.load();
  leave();
  document.title = `${chosen.title} – skylight studio`;
  for (const link of links.querySelectorAll("a")) {
    if (link.hash === `#/${chosen.name}`) link.setAttribute("aria-current", "page");
    else link.removeAttribute("aria-current");
  }
  main.replaceChildren();
  leave = page(main);
}

addEventListener("hashchange", () => {
  if (location.hash.startsWith("#/")) void show().then(() => main.focus());
});
void show();
