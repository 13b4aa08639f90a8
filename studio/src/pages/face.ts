import type { Page } from "../page";

export const page: Page = (root) => {
  const heading = document.createElement("h1");
  heading.textContent = "Light from a face";
  root.append(heading);
  return () => {};
};
