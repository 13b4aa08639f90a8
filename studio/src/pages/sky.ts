import type { Page } from "../page";

export const page: Page = (root) => {
  const heading = document.createElement("h1");
  heading.textContent = "Sky decoder";
  root.append(heading);
  return () => {};
};
